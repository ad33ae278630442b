"""BVH files of the 22 joints and of the avatar, in centimetres, y up, facing +z.

pymotion writes the file. The 22 joints bear the names that MotionBuilder and Mixamo use, so that
programs with a humanoid of their own find them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pymotion.io.bvh import BVH

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M
from questsim.exporting.axes import local_quats, y_up, y_up_quat
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import link_offsets
from questsim.motion.motion import Motion
from questsim.skeleton import JOINT_PARENTS, LINK_PARENTS, LINKS

CM = 100.0
ORDER = "zyx"
"""Of each joint's angles."""


def _sided(*names: str) -> tuple[str, ...]:
    return tuple(f"{side}{name}" for side in ("Left", "Right") for name in names)


_LEGS = _sided("UpLeg", "Leg", "Foot", "ToeBase")
_ARMS = _sided("Shoulder", "Arm", "ForeArm", "Hand")
JOINT_NAMES: tuple[str, ...] = (
    "Hips", *_LEGS, "Spine", "Spine1", "Spine2", "Neck", "Head", *_ARMS,
)  # fmt: skip
"""In the file, in the order of ``skeleton.JOINTS``."""
# Ends of the last joints in the 1.75 m body's joints, metres, our axes.
_HEAD_END, _TOE_END, _HAND_END = (0.0, 0.0, 0.19), (0.07, 0.0, 0.0), 0.17


def write_joint_bvh(path: Path, motion: Motion) -> None:
    """Write the 22 joints of a motion; its zero pose is a T-pose."""
    ends = {
        JOINT_NAMES.index("Head"): _HEAD_END,
        JOINT_NAMES.index("LeftToeBase"): _TOE_END,
        JOINT_NAMES.index("RightToeBase"): _TOE_END,
        JOINT_NAMES.index("LeftHand"): (0.0, _HAND_END, 0.0),
        JOINT_NAMES.index("RightHand"): (0.0, -_HAND_END, 0.0),
    }
    _write(
        path, JOINT_NAMES, JOINT_PARENTS, motion.offsets, motion.root_position,
        motion.rotations, motion.fps, ends,
    )  # fmt: skip


def write_avatar_bvh(path: Path, clip: Clip) -> None:
    """Write the avatar's 16 links, named as in ``skeleton.LINKS``; in the zero pose arms hang."""
    ratio = clip.height_m / DEFAULT_HEIGHT_M
    ends = {
        LINKS.index(name): tuple(ratio * np.array(end))
        for name, end in {
            "head": (0.0, 0.0, 0.3),
            "left_foot": (0.2, 0.0, -0.046), "right_foot": (0.2, 0.0, -0.046),
            "left_hand": (0.0, 0.0, -_HAND_END), "right_hand": (0.0, 0.0, -_HAND_END),
        }.items()
    }  # fmt: skip
    _write(
        path, LINKS, LINK_PARENTS, link_offsets(clip.proportions) * ratio, clip.link_position[:, 0],
        local_quats(clip.link_quat, LINK_PARENTS), FPS, ends,
    )  # fmt: skip


def _write(
    path: Path,
    names: tuple[str, ...],
    parents: tuple[int, ...],
    offsets: np.ndarray,
    root: np.ndarray,
    rotations: np.ndarray,
    fps: float,
    ends: dict[int, tuple[float, ...]],
) -> None:
    frames, count = rotations.shape[:2]
    turns = rot.as_rotation(y_up_quat(rotations))
    angles = turns.as_euler(ORDER.upper(), degrees=True).reshape(frames, count, 3)
    positions = np.tile(CM * y_up(offsets), (frames, 1, 1))
    positions[:, 0] = CM * y_up(root)
    bvh = BVH()
    bvh.data = {
        "names": np.array(names),
        "offsets": CM * y_up(offsets),
        "end_sites": CM * y_up(np.array(list(ends.values()))),
        "end_sites_parents": np.array(list(ends)),
        "parents": np.array(parents),
        "rot_order": np.tile(list(ORDER), (count, 1)),
        "positions": positions,
        # Without jumps by whole turns, as programs interpolate between frames.
        "rotations": np.unwrap(angles, axis=0, period=360.0),
        "frame_time": 1.0 / fps,
        "channels": np.array([6] + [3] * (count - 1)),
    }
    bvh.save(str(path))
