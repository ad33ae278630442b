"""From a ``Motion`` on 22 joints to a ``Clip`` of the avatar; ``retarget_back`` is the way back.

The trunk, the head and the feet take the orientations of the motion. The root's path is scaled
by the ratio of leg lengths; each leg then reaches the motion's sole, each arm the motion's wrist
relative to the chest (so that a raised collarbone, which the avatar lacks, still raises the
hand), by two-bone inverse kinematics in the plane of the motion's knee or elbow. Feet that float
or lean while they stand are planted first (``stance``). The hinge angles that follow are kept
within the body's ranges.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M, MAX_HEIGHT_M, MIN_HEIGHT_M, build_body
from questsim.errors import InputError
from questsim.motion.checks import stature
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import (
    clip_from_qpos,
    link_poses,
    sole_points,
    sole_positions,
)
from questsim.motion.limbs import (
    FLOOR_PERCENTILE,
    SIDES,
    ankle_rise,
    fill_arm,
    fill_leg,
    fill_trunk,
    hips_of,
    joint_index,
    leg_m,
    leg_ratio,
    root_path,
)
from questsim.motion.motion import Motion
from questsim.motion.stance import lowest_point, measure_soles, plant, sink_for_reach
from questsim.skeleton import (
    FOOT_LINKS,
    LINK_JOINTS,
    MIRROR_DOF_SIGNS,
    MIRROR_DOFS,
    NUM_DOFS,
)


def to_clip(motion: Motion) -> Clip:
    """Retarget a motion to the avatar of the same stature, at 36 Hz, feet on the floor.

    Raises:
        InputError: the stature is outside the range of bodies.
    """
    height = round(stature(motion), 3)
    if not MIN_HEIGHT_M <= height <= MAX_HEIGHT_M:
        raise InputError(
            f"the skeleton is {height:.3g} m tall, the avatar {MIN_HEIGHT_M}-{MAX_HEIGHT_M} m",
            motion.source or motion.name,
            "declare --units",
        )
    motion = motion.resampled(FPS)
    position, quat = motion.forward_kinematics()
    angles = np.zeros((len(motion), NUM_DOFS))
    root = root_path(motion, position, height)
    links = fill_trunk(quat, angles)
    ankles = _sole_targets(motion, position, quat, height, root)
    feet = quat[:, [joint_index(f"{side}_ankle") for side in SIDES]]
    ankles, feet = _place_on_floor(root, quat, ankles, feet, height)
    for side in SIDES:
        fill_arm(side, motion, position, quat, links, height, angles)
    qpos = _feet_above_floor(root, quat, ankles, feet, height, angles)
    return clip_from_qpos(
        motion.name,
        qpos,
        height,
        source=motion.source,
        source_sha256=motion.source_sha256,
        licence=motion.licence,
        kind=motion.kind,
        style=motion.style,
    )


def _feet_above_floor(
    root: np.ndarray,
    quat: np.ndarray,
    ankles: np.ndarray,
    feet: np.ndarray,
    height: float,
    angles: np.ndarray,
) -> np.ndarray:
    """Solve the legs, twice: what the ankle's hinges lack may press a sole into the floor."""
    limits = build_body().model.jnt_range[1:]
    links = list(FOOT_LINKS)
    for attempt in (1, 2):
        for index, side in enumerate(SIDES):
            fill_leg(side, root, quat, ankles[:, index], feet[:, index], height, angles)
        qpos = np.concatenate(
            [root, quat[:, 0], np.clip(angles, limits[:, 0], limits[:, 1])], axis=-1
        )
        if attempt == 1:
            link_position, link_quat = link_poses(qpos, height)
            soles = sole_positions(link_position[:, links], link_quat[:, links], height)
            ankles[..., 2] += np.maximum(-soles[..., 2].min(axis=-1), 0.0)
    return qpos


def mirror_clip(clip: Clip) -> Clip:
    """The clip seen in a mirror at the x-z plane; the name gains ``"-mirrored"``."""
    qpos = clip.qpos.copy()
    qpos[:, 1] *= -1.0
    qpos[:, 3:7] *= [1.0, -1.0, 1.0, -1.0]
    qpos[:, 7:] = clip.qpos[:, 7:][:, MIRROR_DOFS] * MIRROR_DOF_SIGNS
    swapped = clip.kind
    for a, b in (("left", "right"), ("right", "left")):
        if a in clip.kind:
            swapped = clip.kind.replace(a, b)
            break
    mirrored = clip_from_qpos(f"{clip.name}-mirrored", qpos, clip.height_m)
    return replace(
        mirrored,
        source=clip.source,
        source_sha256=clip.source_sha256,
        licence=clip.licence,
        kind=swapped,
        style=clip.style,
    )


def _sole_targets(
    motion: Motion, position: np.ndarray, quat: np.ndarray, height: float, root: np.ndarray
) -> np.ndarray:
    """World positions ``(T, 2, 3)`` where the ankles go, keeping the soles' paths.

    The ankle of a motion may stand higher above its sole than the avatar's: what is kept is the
    point of the sole below the ankle, so that a flat foot is flat and a lifted one as high. The
    root sinks by as much as the avatar's ankles are lower.
    """
    ratio = leg_ratio(motion, height)
    ankles = [joint_index(f"{side}_ankle") for side in SIDES]
    motion_rise = ankle_rise(motion, position)
    avatar_rise = -sole_points()[..., 2].mean() * height / DEFAULT_HEIGHT_M
    up = rot.quat_rotate(quat[:, ankles], np.array([0.0, 0.0, 1.0]))
    soles = position[:, ankles] - motion_rise * up
    targets = soles * ratio + avatar_rise * up
    root[:, 2] += avatar_rise - ratio * motion_rise
    return targets


def _place_on_floor(
    root: np.ndarray, quat: np.ndarray, ankles: np.ndarray, feet: np.ndarray, height: float
) -> tuple[np.ndarray, np.ndarray]:
    """Put the soles on z = 0, none below; the root ``(T, 3)`` is moved in place.

    Returns:
        ankle targets ``(T, 2, 3)`` and the orientations of the feet ``(T, 2, 4)``.
    """
    lowest = lowest_point(ankles, feet, height)
    floor = float(np.percentile(lowest.min(axis=1), FLOOR_PERCENTILE))
    root[:, 2] -= floor
    on_floor = ankles - [0.0, 0.0, floor]
    soles = measure_soles(on_floor, feet, height)
    if soles.flat:
        ankles, feet, rise, stands = plant(soles, on_floor, feet, height)
        root[:, 2] += rise
        root[:, 2] -= sink_for_reach(hips_of(root, quat, height), ankles, stands, leg_m(height))
    else:
        ankles[..., 2] += np.maximum(-floor, -lowest)
    return ankles, feet


def retargeting_error(motion: Motion, clip: Clip) -> dict[str, float]:
    """Mean distance in cm, by joint, of the avatar's links from the motion's joints.

    Both relative to the midpoint of the hips, the motion scaled to the avatar's leg length:
    what is left are other proportions and what the avatar's hinges cannot do.
    """
    position, _ = motion.resampled(FPS).forward_kinematics()
    hips = position[:, [joint_index("left_hip"), joint_index("right_hip")]].mean(
        axis=1, keepdims=True
    )
    expected = (position - hips) * leg_ratio(motion, clip.height_m)
    got = clip.link_position - clip.link_position[:, :1]
    errors = {}
    for link, name in enumerate(LINK_JOINTS[1:], start=1):
        distance = np.linalg.norm(got[:, link] - expected[:, joint_index(name)], axis=-1)
        errors[name] = float(distance.mean() * 100.0)
    return errors
