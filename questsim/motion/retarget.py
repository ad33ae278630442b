"""Retargets a ``Motion`` on 22 joints to a ``Clip``; ``retarget_back`` is the other direction.

The trunk, the head and the feet take the orientations of the motion. The root's path is scaled
by the ratio of leg lengths; each leg then reaches the motion's sole, each arm the motion's wrist
relative to the chest (so that a raised collarbone, which the avatar lacks, still raises the
hand), by two-bone inverse kinematics in the plane of the motion's knee or elbow. Stance feet
that float or tilt are planted first (``stance``). The resulting hinge angles are clipped to the
body's ranges; where a foot would then sink, the pelvis turns back (``crouch``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from questsim.body import MAX_HEIGHT_M, MIN_HEIGHT_M, build_body
from questsim.body_proportions import Proportions
from questsim.errors import InputError
from questsim.motion.checks import stature
from questsim.motion.clip import FPS, Clip
from questsim.motion.crouch import beyond_range, pelvis_turn, turned_back
from questsim.motion.footing import ANKLES, Footing, footing_of, leg_targets
from questsim.motion.kinematics import clip_from_qpos, link_poses, sole_positions
from questsim.motion.limbs import (
    ankle_rise,
    fill_arms,
    fill_legs,
    fill_trunk,
    hips_of,
    joint_index,
    leg_m,
    leg_ratio,
)
from questsim.motion.motion import Motion
from questsim.motion.own_body import own_body
from questsim.motion.stance import lowest_point, plant, sink_for_reach, smoothed
from questsim.skeleton import (
    FOOT_LINKS,
    LINK_JOINTS,
    MIRROR_DOF_SIGNS,
    MIRROR_DOFS,
    NUM_DOFS,
)


def to_clip(
    motion: Motion, footing: Footing | None = None, *, own_proportions: bool = False
) -> Clip:
    """Retarget a motion to the avatar of the same stature, at 36 Hz, feet on the floor.

    Args:
        motion: the motion to retarget.
        footing: of another recording of the same person; the motion then keeps that floor, even
            if feet float or sink. By default it is measured from the motion, and no foot sinks.
        own_proportions: give the avatar the person's own proportions, not only the stature.

    Raises:
        InputError: the stature, or with ``own_proportions`` a part of the body, is outside the
            range of bodies.
    """
    height = round(stature(motion), 3)
    if not MIN_HEIGHT_M <= height <= MAX_HEIGHT_M:
        raise InputError(
            f"the skeleton is {height:.3g} m tall, the avatar {MIN_HEIGHT_M}-{MAX_HEIGHT_M} m",
            motion.source or motion.name,
            "declare --units",
        )
    body = own_body(motion, height) if own_proportions else None
    motion = motion.resampled(FPS)
    position, quat = motion.forward_kinematics()
    angles = np.zeros((len(motion), NUM_DOFS))
    links = fill_trunk(quat, angles)
    fill_arms(motion, position, quat, links, height, angles, body)
    rise = footing.rise_m if footing else ankle_rise(motion, position)
    root, ankles = leg_targets(motion, position, quat, height, rise, body)
    feet = quat[:, ANKLES]
    used = footing or footing_of(ankles, feet, height, rise)
    ankles, feet, bears = _place_on_floor(used, root, quat, ankles, feet, height, body)
    lowest = lowest_point(ankles, feet, height)
    if footing is None:
        ankles[..., 2] += np.maximum(0.0, -lowest)
    allowed = np.minimum(lowest, 0.0) if footing else np.zeros_like(lowest)
    qpos = solve_legs(root, quat, ankles.copy(), feet, allowed, bears, height, angles, body)
    if beyond_range(angles).any():
        soles = sole_positions(*link_poses(qpos, height, FOOT_LINKS, body), height)
        turn = smoothed(pelvis_turn(angles, allowed - soles[..., 2].min(axis=-1)))
        if turn.any():
            quat = turned_back(quat, turn)
            fill_trunk(quat, angles)
            qpos = solve_legs(root, quat, ankles, feet, allowed, bears, height, angles, body)
    return clip_from_qpos(
        motion.name,
        qpos,
        height,
        body,
        source=motion.source,
        source_sha256=motion.source_sha256,
        licence=motion.licence,
        kind=motion.kind,
        style=motion.style,
        weight=motion.weight,
    )


def _place_on_floor(
    footing: Footing,
    root: np.ndarray,
    quat: np.ndarray,
    ankles: np.ndarray,
    feet: np.ndarray,
    height: float,
    body: Proportions | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Put the floor at z = 0 and stance feet on it; the root ``(T, 3)`` is moved in place.

    Returns:
        ankle targets ``(T, 2, 3)``, orientations of the feet ``(T, 2, 4)`` and how far each foot
        is planted ``(T, 2)``, 0 to 1.
    """
    root[:, 2] -= footing.floor_m
    ankles = ankles - [0.0, 0.0, footing.floor_m]
    if not footing.soles.flat:
        return ankles, feet, np.zeros(ankles.shape[:2])
    ankles, feet, rise, stands = plant(footing.soles, ankles, feet, height)
    root[:, 2] += rise
    hips = hips_of(root, quat, height, body)
    root[:, 2] -= sink_for_reach(hips, ankles, stands, leg_m(height, body))
    return ankles, feet, smoothed(stands.astype(float))


def solve_legs(
    root: np.ndarray,
    quat: np.ndarray,
    ankles: np.ndarray,
    feet: np.ndarray,
    allowed: np.ndarray,
    bears: np.ndarray,
    height: float,
    angles: np.ndarray,
    body: Proportions | None,
) -> np.ndarray:
    """Solve the legs twice: the ankle's missing degrees of freedom may push a sole into the floor.

    The ankle has no yaw either. Planted soles are placed where they would be with it, so that they
    skate no more than the motion's.

    Args:
        root, quat, ankles, feet: targets of the pelvis and the feet, ``(T, ...)``.
        allowed: ``(T, 2)`` minimum height of each sole.
        bears: ``(T, 2)`` how far each foot is planted.
        height: the avatar's stature.
        angles: ``(T, 33)``; those of the legs are filled.
        body: the avatar's proportions.

    Returns:
        ``(T, 40)`` poses within the ranges of the hinges.
    """
    limits = build_body().model.jnt_range[1:]
    wanted = sole_positions(ankles, feet, height).mean(axis=-2)
    for attempt in (1, 2):
        fill_legs(root, quat, ankles, feet, height, angles, body)
        qpos = np.concatenate(
            [root, quat[:, 0], np.clip(angles, limits[:, 0], limits[:, 1])], axis=-1
        )
        if attempt == 1:
            soles = sole_positions(*link_poses(qpos, height, FOOT_LINKS, body), height)
            ankles[..., 2] += np.maximum(allowed - soles[..., 2].min(axis=-1), 0.0)
            ankles[..., :2] += bears[..., None] * (wanted - soles.mean(axis=-2))[..., :2]
    return qpos


def mirror_clip(clip: Clip) -> Clip:
    """The clip mirrored at the x-z plane, with ``"-mirrored"`` added to its name."""
    qpos = clip.qpos.copy()
    qpos[:, 1] *= -1.0
    qpos[:, 3:7] *= [1.0, -1.0, 1.0, -1.0]
    qpos[:, 7:] = clip.qpos[:, 7:][:, MIRROR_DOFS] * MIRROR_DOF_SIGNS
    swapped = clip.kind
    for a, b in (("left", "right"), ("right", "left")):
        if a in clip.kind:
            swapped = clip.kind.replace(a, b)
            break
    mirrored = clip_from_qpos(f"{clip.name}-mirrored", qpos, clip.height_m, clip.proportions)
    return replace(
        mirrored,
        source=clip.source,
        source_sha256=clip.source_sha256,
        licence=clip.licence,
        kind=swapped,
        style=clip.style,
        weight=clip.weight,
    )


def retargeting_error(motion: Motion, clip: Clip) -> dict[str, float]:
    """Mean distance in cm, by joint, of the avatar's links from the motion's joints.

    Both are relative to the midpoint of the hips, and the motion is scaled to the avatar's leg
    length. The rest comes from other proportions and from the limits of the avatar's hinges.
    """
    position, _ = motion.resampled(FPS).forward_kinematics()
    hips = position[:, [joint_index("left_hip"), joint_index("right_hip")]].mean(
        axis=1, keepdims=True
    )
    expected = (position - hips) * leg_ratio(motion, clip.height_m, clip.proportions)
    got = clip.link_position - clip.link_position[:, :1]
    errors = {}
    for link, name in enumerate(LINK_JOINTS[1:], start=1):
        distance = np.linalg.norm(got[:, link] - expected[:, joint_index(name)], axis=-1)
        errors[name] = float(distance.mean() * 100.0)
    return errors
