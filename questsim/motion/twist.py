"""Takes the twist of the joints from their places, if the file's own twist is arbitrary.

Pose estimators and other programs that make rotations from positions point each bone at the next
joint and leave its turn about itself to chance. The joints are in the right places, but the hinge
axis of a thigh does not lie across the bend of its knee, or the hips across the pelvis.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from questsim import rotations as rot
from questsim.skeleton import JOINT_PARENTS, JOINTS

ARBITRARY = "the joints' own twist is arbitrary: it is taken from their places"
MIN_BEND = 0.25
"""Sine of a knee's bend from which it shows the hinge axis."""
MIN_FRAMES = 3
OFF_AXIS = (np.radians(50.0), np.radians(150.0))
"""Median angle between a thigh's own hinge axis and its knee's, or the pelvis's left and the line
of the hips. It is 0 in files of a known skeleton and up to 25 degrees in others. A knee that bends
backwards, at 180, is no matter of twist."""
STRAIGHT_WEIGHT = 0.1
"""Weight of the pelvis's left against the bend, so that a straight knee has a hinge axis too."""
LEFT, UP = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
TRUNK = ("root", "spine1", "spine2", "spine3", "neck", "head")

Places = Mapping[int, np.ndarray]


def untwist(placed: Places, turned: np.ndarray) -> bool:
    """Turns trunk, legs, feet, neck and head by their places, if their own twist is arbitrary.

    Args:
        placed: positions ``(T, 3)`` of the joints that the file has.
        turned: ``(T, 22, 4)`` orientations in the world, changed in place.

    Returns:
        whether it did.
    """
    bends = {side: _bend(placed, side) for side in ("left", "right")}
    hips, shoulders = (_across(placed, joint) for joint in ("hip", "shoulder"))
    trunk_off = _off_axis(turned[:, 0], hips)
    if not trunk_off and not any(
        _off_hinge(turned[:, _at(f"{side}_hip")], bend) for side, bend in bends.items()
    ):
        return False
    if trunk_off:
        _place_trunk(placed, turned, hips, shoulders)
    else:
        for joint in {"neck", "head"} & {JOINTS[joint] for joint in placed}:
            up = rot.quat_rotate(turned[:, _at(joint)], UP)
            if joint == "neck":
                up = placed[_at("head")] - placed[_at("neck")]
            turned[:, _at(joint)] = _rolled(turned[:, _at(joint)], up, shoulders)
    for side, bend in bends.items():
        hinge = bend + STRAIGHT_WEIGHT * hips
        for joint, end in (("hip", "knee"), ("knee", "ankle"), ("ankle", "toe")):
            row, below = _at(f"{side}_{joint}"), _at(f"{side}_{end}")
            if below in placed:
                bone = placed[below] - placed[row]
                turned[:, row] = _rolled(turned[:, row], bone, hinge)
    for joint in range(1, len(JOINTS)):
        if joint not in placed:
            turned[:, joint] = turned[:, JOINT_PARENTS[joint]]
    return True


def _place_trunk(
    placed: Places, turned: np.ndarray, hips: np.ndarray, shoulders: np.ndarray
) -> None:
    """Orientations of trunk, neck and head from the lines of hips, shoulders and neck."""
    along = _middle(placed, "shoulder") - _middle(placed, "hip")
    left = {"root": hips, "spine1": hips + shoulders}
    for joint in TRUNK:
        turned[:, _at(joint)] = _frame(left.get(joint, shoulders), along)
    if _at("neck") in placed:
        chest = turned[:, _at("spine3")]
        up = _straight(chest, placed[_at("head")] - placed[_at("neck")])
        turned[:, _at("neck")] = turned[:, _at("head")] = _frame(shoulders, up)


def _at(joint: str) -> int:
    return JOINTS.index(joint)


def _across(placed: Places, joint: str) -> np.ndarray:
    """Unit vectors ``(T, 3)`` from the right joint to the left one."""
    return rot.unit(placed[_at(f"left_{joint}")] - placed[_at(f"right_{joint}")])


def _middle(placed: Places, joint: str) -> np.ndarray:
    return (placed[_at(f"left_{joint}")] + placed[_at(f"right_{joint}")]) / 2.0


def _bend(placed: Places, side: str) -> np.ndarray:
    """Hinge axis ``(T, 3)`` of a knee in the world, as long as the sine of its bend."""
    hip, knee, ankle = (placed[_at(f"{side}_{joint}")] for joint in ("hip", "knee", "ankle"))
    return np.cross(rot.unit(knee - hip), rot.unit(ankle - knee))


def _off_hinge(thigh: np.ndarray, bend: np.ndarray) -> bool:
    bent = np.linalg.norm(bend, axis=-1) > MIN_BEND
    return bent.sum() >= MIN_FRAMES and _off_axis(thigh[bent], bend[bent])


def _off_axis(quat: np.ndarray, left: np.ndarray) -> bool:
    """Whether a joint's own left is far from that of the body."""
    cosine = np.sum(rot.quat_rotate(quat, LEFT) * rot.unit(left), axis=-1)
    angle = float(np.median(np.arccos(np.clip(cosine, -1.0, 1.0))))
    return OFF_AXIS[0] < angle < OFF_AXIS[1]


def _frame(left: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Orientations ``(T, 4)`` with an exact left and an approximate up direction."""
    y = rot.unit(left)
    z = rot.unit(up - np.sum(up * y, axis=-1, keepdims=True) * y)
    return rot.matrix_to_quat(np.stack([np.cross(y, z), y, z], axis=-1))


def _straight(chest: np.ndarray, bone: np.ndarray) -> np.ndarray:
    """Directions ``(T, 3)`` of a neck, turned in the chest so that their median is upright."""
    own = rot.quat_rotate(rot.quat_conjugate(chest), rot.unit(bone))
    lean = rot.unit(np.median(own, axis=0))
    half = np.append(1.0 + lean[2], np.cross(lean, [0.0, 0.0, 1.0]))
    return rot.quat_rotate(chest, rot.quat_rotate(half / np.linalg.norm(half), own))


def _rolled(quat: np.ndarray, bone: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Orientations ``(T, 4)`` turned about ``bone`` so that their y axis is next to ``left``."""
    axis = rot.unit(bone)

    def across(vector: np.ndarray) -> np.ndarray:
        return rot.unit(vector - np.sum(vector * axis, axis=-1, keepdims=True) * axis)

    own, wanted = across(rot.quat_rotate(quat, LEFT)), across(left)
    sine = np.sum(np.cross(own, wanted) * axis, axis=-1)
    half = np.arctan2(sine, np.sum(own * wanted, axis=-1)) / 2.0
    turn = np.concatenate([np.cos(half)[:, None], np.sin(half)[:, None] * axis], axis=-1)
    return rot.quat_multiply(turn, quat)
