"""From a ``Motion`` on 22 joints to a ``Clip`` of the avatar; ``retarget_back`` is the way back.

The trunk, the head and the feet take the orientations of the motion. The root's path is scaled
by the ratio of leg lengths; each leg then reaches the motion's sole, each arm the motion's wrist
relative to the chest (so that a raised collarbone, which the avatar lacks, still raises the
hand), by two-bone inverse kinematics in the plane of the motion's knee or elbow. The hinge
angles that follow are kept within the body's ranges.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M, MAX_HEIGHT_M, MIN_HEIGHT_M, build_body
from questsim.errors import InputError
from questsim.motion.checks import stature
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import (
    clip_from_qpos,
    link_offsets,
    link_poses,
    sole_points,
    sole_positions,
)
from questsim.motion.motion import Motion
from questsim.skeleton import (
    DOFS,
    FOOT_LINKS,
    JOINT_PARENTS,
    JOINTS,
    LINK_JOINTS,
    LINKS,
    MIRROR_DOF_SIGNS,
    MIRROR_DOFS,
    NUM_DOFS,
)

SIDES = ("left", "right")
FULL_STRETCH = 0.999
"""A limb reaches at most this share of its length: beyond it the knee would snap."""
FLOOR_PERCENTILE = 10.0
"""The floor lies where the lower foot is lowest; a percentile is robust to single dips."""
# In the motion's T-pose the arms point sideways, in the avatar's zero pose they hang.
ARM_REST = {
    "left": rot.as_quat(Rotation.from_euler("x", 90, degrees=True)),
    "right": rot.as_quat(Rotation.from_euler("x", -90, degrees=True)),
}
# The shoulders' first two hinges are turned about z by these angles (humanoid.xml).
SHOULDER_TURN = {"left": -np.pi / 4, "right": np.pi / 4}


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
    root = _root_path(motion, position, height)
    links = _trunk(quat, angles)
    ankles = _sole_targets(motion, position, quat, height, root)
    feet = quat[:, [_joint(f"{side}_ankle") for side in SIDES]]
    root[:, 2] -= _place_on_floor(ankles, feet, height)
    for side in SIDES:
        _arm(side, motion, position, quat, links, height, angles)
    qpos = _feet_above_floor(root, quat, ankles, height, angles)
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
    root: np.ndarray, quat: np.ndarray, ankles: np.ndarray, height: float, angles: np.ndarray
) -> np.ndarray:
    """Solve the legs, twice: what the ankle's hinges lack may press a sole into the floor."""
    limits = build_body().model.jnt_range[1:]
    feet = list(FOOT_LINKS)
    for attempt in (1, 2):
        for index, side in enumerate(SIDES):
            _leg(side, root, quat, ankles[:, index], height, angles)
        qpos = np.concatenate(
            [root, quat[:, 0], np.clip(angles, limits[:, 0], limits[:, 1])], axis=-1
        )
        if attempt == 1:
            link_position, link_quat = link_poses(qpos, height)
            soles = sole_positions(link_position[:, feet], link_quat[:, feet], height)
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


def _joint(name: str) -> int:
    return JOINTS.index(name)


def _dofs(*names: str) -> list[int]:
    return [DOFS.index(name) for name in names]


def _link_offset(link: str, height: float) -> np.ndarray:
    return link_offsets()[LINKS.index(link)] * (height / DEFAULT_HEIGHT_M)


def _length(link: str, height: float) -> float:
    """Metres from the parent's origin to the link's."""
    return float(np.linalg.norm(_link_offset(link, height)))


def _leg_ratio(motion: Motion, height: float) -> float:
    """Avatar's over the motion's length of thigh and shin."""
    motion_leg = sum(
        np.linalg.norm(motion.offsets[_joint(f"{side}_{part}")])
        for side in SIDES
        for part in ("knee", "ankle")
    )
    avatar_leg = sum(
        np.linalg.norm(_link_offset(f"{side}_{part}", height))
        for side in SIDES
        for part in ("shin", "foot")
    )
    return float(avatar_leg / motion_leg)


def _root_path(motion: Motion, position: np.ndarray, height: float) -> np.ndarray:
    """``(T, 3)`` path of the pelvis (midway between the hips) before floor placement."""
    hips = position[:, [_joint("left_hip"), _joint("right_hip")]].mean(axis=1)
    return hips * _leg_ratio(motion, height)


def _euler(relative: np.ndarray, order: str) -> np.ndarray:
    """Intrinsic angles ``(T, 3)`` in radians, without jumps by full turns."""
    return np.unwrap(rot.as_rotation(relative).as_euler(order), axis=0)


def _relative(parent: np.ndarray, child: np.ndarray) -> np.ndarray:
    return rot.quat_multiply(rot.quat_conjugate(parent), child)


def _trunk(quat: np.ndarray, angles: np.ndarray) -> dict[str, np.ndarray]:
    """Fill the trunk's and neck's angles; return orientations ``(T, 4)`` of its links."""
    links = {
        "pelvis": quat[:, _joint("root")],
        "spine": quat[:, _joint("spine1")],
        "chest": quat[:, _joint("spine3")],
        "head": quat[:, _joint("head")],
    }
    names = list(links)
    for parent, child in pairwise(names):
        hinge = "neck" if child == "head" else child
        dofs = _dofs(f"{hinge}_y", f"{hinge}_x", f"{hinge}_z")
        angles[:, dofs] = _euler(_relative(links[parent], links[child]), "YXZ")
    return links


def _sole_targets(
    motion: Motion, position: np.ndarray, quat: np.ndarray, height: float, root: np.ndarray
) -> np.ndarray:
    """World positions ``(T, 2, 3)`` where the ankles go, keeping the soles' paths.

    The ankle of a motion may stand higher above its sole than the avatar's: what is kept is the
    point of the sole below the ankle, so that a flat foot is flat and a lifted one as high. The
    root sinks by as much as the avatar's ankles are lower.
    """
    ratio = _leg_ratio(motion, height)
    ankles = [_joint(f"{side}_ankle") for side in SIDES]
    motion_rise = _ankle_rise(motion, position)
    avatar_rise = -sole_points()[..., 2].mean() * height / DEFAULT_HEIGHT_M
    up = rot.quat_rotate(quat[:, ankles], np.array([0.0, 0.0, 1.0]))
    soles = position[:, ankles] - motion_rise * up
    targets = soles * ratio + avatar_rise * up
    root[:, 2] += avatar_rise - ratio * motion_rise
    return targets


def _ankle_rise(motion: Motion, position: np.ndarray) -> float:
    """Metres from sole to ankle of the motion's flat foot.

    The toe joint's drop below the ankle in the rest pose, and the toe's own height, which no
    skeleton tells: the lowest it comes to the floor of the file, within reason.
    """
    toes = [_joint(f"{side}_toe") for side in SIDES]
    drop = -motion.offsets[toes, 2].mean()
    toe_height = np.percentile(position[:, toes, 2].min(axis=1), FLOOR_PERCENTILE)
    return float(max(drop, 0.0) + np.clip(toe_height, 0.01, 0.05))


def _place_on_floor(ankles: np.ndarray, feet: np.ndarray, height: float) -> float:
    """Shift ankle targets ``(T, 2, 3)`` in place so that soles touch z = 0 and none is below.

    Returns:
        the height in metres of the floor before, for the root to be lowered by.
    """
    lowest = sole_positions(ankles, feet, height)[..., 2].min(axis=-1)
    floor = float(np.percentile(lowest.min(axis=1), FLOOR_PERCENTILE))
    ankles[..., 2] += np.maximum(-floor, -lowest)
    return floor


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), 1e-9)


def _frame(down: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Quaternions ``(T, 4)`` of links that hang along ``down`` with their y axis near ``left``."""
    z = -_unit(down)
    y = _unit(left - np.sum(left * z, axis=-1, keepdims=True) * z)
    return rot.matrix_to_quat(np.stack([np.cross(y, z), y, z], axis=-1))


def _two_bones(
    reach: np.ndarray, axis: np.ndarray, upper: float, lower: float, bend: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bend a two-bone limb so that it ends at ``reach`` ``(T, 3)`` from its beginning.

    Args:
        reach: from hip or shoulder to ankle or wrist, metres.
        axis: ``(T, 3)`` the hinge's axis in the world, roughly.
        upper, lower: lengths of the bones in metres.
        bend: sign of the hinge's rotation about its axis: +1 knee, -1 elbow.

    Returns:
        orientations ``(T, 4)`` of the upper and the lower link, and the hinge angle ``(T,)``.
    """
    distance = np.linalg.norm(reach, axis=-1)
    distance = np.clip(distance, abs(upper - lower) + 1e-3, FULL_STRETCH * (upper + lower))
    at_start = (upper**2 + distance**2 - lower**2) / (2 * upper * distance)
    at_hinge = (upper**2 + lower**2 - distance**2) / (2 * upper * lower)
    angle = bend * (np.pi - np.arccos(np.clip(at_hinge, -1.0, 1.0)))
    lead = -bend * np.arccos(np.clip(at_start, -1.0, 1.0))
    straight = _frame(reach, axis)
    upper_quat = rot.quat_multiply(straight, _about_y(lead))
    return upper_quat, rot.quat_multiply(upper_quat, _about_y(angle)), angle


def _about_y(angle: np.ndarray) -> np.ndarray:
    zero = np.zeros_like(angle)
    return np.stack([np.cos(angle / 2), zero, np.sin(angle / 2), zero], axis=-1)


def _leg(
    side: str,
    root: np.ndarray,
    quat: np.ndarray,
    ankle: np.ndarray,
    height: float,
    angles: np.ndarray,
) -> None:
    """Fill the six angles of a leg whose ankle goes to ``ankle`` ``(T, 3)``."""
    pelvis = quat[:, _joint("root")]
    hip = root + rot.quat_rotate(pelvis, _link_offset(f"{side}_thigh", height))
    knee_axis = rot.quat_rotate(quat[:, _joint(f"{side}_hip")], np.array([0.0, 1.0, 0.0]))
    thigh_length = _length(f"{side}_shin", height)
    shin_length = _length(f"{side}_foot", height)
    thigh, shin, knee = _two_bones(ankle - hip, knee_axis, thigh_length, shin_length, bend=1.0)
    angles[:, _dofs(f"{side}_hip_y", f"{side}_hip_x", f"{side}_hip_z")] = _euler(
        _relative(pelvis, thigh), "YXZ"
    )
    angles[:, _dofs(f"{side}_knee_y")] = knee[:, None]
    foot = _relative(shin, quat[:, _joint(f"{side}_ankle")])
    angles[:, _dofs(f"{side}_ankle_y", f"{side}_ankle_x")] = _euler(foot, "YXZ")[:, :2]


def _arm(
    side: str,
    motion: Motion,
    position: np.ndarray,
    quat: np.ndarray,
    links: dict[str, np.ndarray],
    height: float,
    angles: np.ndarray,
) -> None:
    """Fill the six angles of an arm; positions are relative, so the root does not matter."""
    upper_length = _length(f"{side}_forearm", height)
    lower_length = _length(f"{side}_hand", height)
    shoulder = _link_offset(f"{side}_upper_arm", height)
    span, centre = _arm_rest(motion)
    ratio = (abs(shoulder[1]) + upper_length + lower_length) / span
    spine = _joint("spine3")
    middle = position[:, spine] + rot.quat_rotate(quat[:, spine], centre)
    wrist = (position[:, _joint(f"{side}_wrist")] - middle) * ratio
    lateral = rot.quat_rotate(links["chest"], shoulder * np.array([0.0, 1.0, 0.0]))
    reach = wrist - lateral

    upper = position[:, _joint(f"{side}_elbow")] - position[:, _joint(f"{side}_shoulder")]
    rest = ARM_REST[side]
    own = rot.quat_multiply(quat[:, _joint(f"{side}_shoulder")], rest)
    own_axis = rot.quat_rotate(own, np.array([0.0, 1.0, 0.0]))
    # The bent arm shows its plane; towards a straight one the upper arm's own axis takes over.
    axis = np.cross(_unit(reach), _unit(upper)) + STRAIGHT_ARM_WEIGHT * own_axis
    arm, forearm, elbow = _two_bones(reach, axis, upper_length, lower_length, bend=-1.0)

    turn = rot.yaw_quat(np.array(SHOULDER_TURN[side]))
    relative = rot.quat_multiply(_relative(turn, _relative(links["chest"], arm)), turn)
    dofs = _dofs(f"{side}_shoulder_x", f"{side}_shoulder_y", f"{side}_shoulder_z")
    angles[:, dofs] = _within_turn(_euler(relative, "XYZ"), dofs)
    angles[:, _dofs(f"{side}_elbow_y")] = elbow[:, None]
    hand = rot.quat_multiply(quat[:, _joint(f"{side}_wrist")], rest)
    dofs = _dofs(f"{side}_wrist_z", f"{side}_wrist_x")
    angles[:, dofs] = _within_turn(_euler(_relative(forearm, hand), "ZXY")[:, :2], dofs)


STRAIGHT_ARM_WEIGHT = 0.1
"""Weight of the upper arm's own hinge axis against the sine of its angle to the wrist's line."""


def _arm_rest(motion: Motion) -> tuple[float, np.ndarray]:
    """Half the arm span, and the midpoint of the shoulders from spine3, in the rest pose."""

    def from_spine(name: str) -> np.ndarray:
        joint, place = _joint(name), np.zeros(3)
        while joint != _joint("spine3"):
            place = place + motion.offsets[joint]
            joint = JOINT_PARENTS[joint]
        return place

    centre = (from_spine("left_shoulder") + from_spine("right_shoulder")) / 2.0
    span = (from_spine("left_wrist")[1] - from_spine("right_wrist")[1]) / 2.0
    return float(span), centre


def _within_turn(values: np.ndarray, dofs: list[int]) -> np.ndarray:
    """Whole turns added to angles ``(T, len(dofs))`` so that they lie about their ranges."""
    limits = build_body().model.jnt_range[1:][dofs]
    middle = limits.mean(axis=1)
    turns = np.round((np.median(values, axis=0) - middle) / (2 * np.pi))
    return values - 2 * np.pi * turns


def retargeting_error(motion: Motion, clip: Clip) -> dict[str, float]:
    """Mean distance in cm, by joint, of the avatar's links from the motion's joints.

    Both relative to the midpoint of the hips, the motion scaled to the avatar's leg length:
    what is left are other proportions and what the avatar's hinges cannot do.
    """
    position, _ = motion.resampled(FPS).forward_kinematics()
    hips = position[:, [_joint("left_hip"), _joint("right_hip")]].mean(axis=1, keepdims=True)
    expected = (position - hips) * _leg_ratio(motion, clip.height_m)
    got = clip.link_position - clip.link_position[:, :1]
    errors = {}
    for link, name in enumerate(LINK_JOINTS[1:], start=1):
        distance = np.linalg.norm(got[:, link] - expected[:, _joint(name)], axis=-1)
        errors[name] = float(distance.mean() * 100.0)
    return errors
