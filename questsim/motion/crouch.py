"""People who crouch or kneel, bent further forward than the avatar's hips flex.

A hip at the end of its range cannot lift its thigh any further, and the foot would sink through
the floor. The pelvis then turns back and the spine bends instead: hips, chest, arms and head stay
where they are.
"""

from __future__ import annotations

import numpy as np

from questsim import rotations as rot
from questsim.body import build_body
from questsim.motion.limbs import dofs_of_sides, joint_index

SUNK_M = 0.02
"""Only a sole deeper than this in the floor turns the pelvis: other clips stay as they are."""
MAX_TURN = np.radians(60.0)


def beyond_range(angles: np.ndarray) -> np.ndarray:
    """By how much each hip would flex beyond its range, in radians ``(T, 2)``; mostly 0.

    Args:
        angles: ``(T, 33)``, not yet clipped to the ranges.
    """
    hips = dofs_of_sides("hip_y").ravel()
    beyond = build_body().model.jnt_range[1:][hips, 0] - angles[:, hips]
    return np.clip(beyond, 0.0, MAX_TURN)


def pelvis_turn(angles: np.ndarray, sunk: np.ndarray) -> np.ndarray:
    """By how much the pelvis turns back, in radians ``(T,)``; 0 in nearly all clips.

    Args:
        angles: ``(T, 33)``, not yet clipped to the ranges.
        sunk: ``(T, 2)`` metres of each sole below its floor.
    """
    return np.where(sunk > SUNK_M, beyond_range(angles), 0.0).max(axis=1)


def turned_back(quat: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Orientations ``(T, 22, 4)`` with the pelvis turned back, and the spine by half as much."""
    out = quat.copy()
    for joint, share in (("root", 1.0), ("spine1", 0.5)):
        half = -0.5 * share * turn
        about_y = np.stack([np.cos(half), 0.0 * half, np.sin(half), 0.0 * half], axis=-1)
        out[:, joint_index(joint)] = rot.quat_multiply(quat[:, joint_index(joint)], about_y)
    return out
