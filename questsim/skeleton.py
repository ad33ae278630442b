"""Names and parents of the 22-joint motion skeleton and of the 16-link avatar.

Everything that orders joints, links or degrees of freedom takes the order from here.
Axes everywhere: x forward, y left, z up.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

JOINTS: tuple[str, ...] = (
    "root",
    "left_hip", "left_knee", "left_ankle", "left_toe",
    "right_hip", "right_knee", "right_ankle", "right_toe",
    "spine1", "spine2", "spine3", "neck", "head",
    "left_clavicle", "left_shoulder", "left_elbow", "left_wrist",
    "right_clavicle", "right_shoulder", "right_elbow", "right_wrist",
)  # fmt: skip
"""The 22 joints of a ``Motion`` (SMPL-like topology, SparsePoser's order)."""

JOINT_PARENTS: tuple[int, ...] = (
    0, 0, 1, 2, 3, 0, 5, 6, 7, 0, 9, 10, 11, 12, 11, 14, 15, 16, 11, 18, 19, 20,
)  # fmt: skip
"""Parent of each joint; the root is its own parent."""


@lru_cache(maxsize=64)
def generations(parents: tuple[int, ...]) -> tuple[tuple[list[int], list[int]], ...]:
    """Joints of equal depth, with their parents, from the children of the roots downwards.

    Forward kinematics over whole generations is faster than joint by joint.

    Args:
        parents: index of each joint's parent, which comes before it; a root's is -1 or its own.
    """
    depth: list[int] = []
    for joint, parent in enumerate(parents):
        depth.append(0 if parent in (-1, joint) else depth[parent] + 1)
    levels = [[j for j, d in enumerate(depth) if d == level] for level in range(1, max(depth) + 1)]
    return tuple((joints, [parents[j] for j in joints]) for joints in levels)


LINKS: tuple[str, ...] = (
    "pelvis",
    "left_thigh", "left_shin", "left_foot",
    "right_thigh", "right_shin", "right_foot",
    "spine", "chest", "head",
    "left_upper_arm", "left_forearm", "left_hand",
    "right_upper_arm", "right_forearm", "right_hand",
)  # fmt: skip
"""The 16 links of the avatar, in the order of the MJCF bodies after the world."""

LINK_PARENTS: tuple[int, ...] = (0, 0, 1, 2, 0, 4, 5, 0, 7, 8, 8, 10, 11, 8, 13, 14)
"""Parent of each link; the pelvis is its own parent."""

LINK_JOINTS: tuple[str, ...] = (
    "root",
    "left_hip", "left_knee", "left_ankle",
    "right_hip", "right_knee", "right_ankle",
    "spine1", "spine2", "neck",
    "left_shoulder", "left_elbow", "left_wrist",
    "right_shoulder", "right_elbow", "right_wrist",
)  # fmt: skip
"""The motion joint at which each link begins (the pelvis begins midway between the hips)."""


def _leg(side: str) -> tuple[str, ...]:
    return tuple(f"{side}_{d}" for d in ("hip_y", "hip_x", "hip_z", "knee_y", "ankle_y", "ankle_x"))


def _arm(side: str) -> tuple[str, ...]:
    return tuple(
        f"{side}_{d}"
        for d in ("shoulder_x", "shoulder_y", "shoulder_z", "elbow_y", "wrist_z", "wrist_x")
    )


DOFS: tuple[str, ...] = (
    *_leg("left"),
    *_leg("right"),
    "spine_y", "spine_x", "spine_z",
    "chest_y", "chest_x", "chest_z",
    "neck_y", "neck_x", "neck_z",
    *_arm("left"),
    *_arm("right"),
)  # fmt: skip
"""The 33 hinges, in the order of ``qpos[7:]``, ``qvel[6:]``, ``ctrl`` and every action.

The last letter is the positive axis of rotation, in the parent link's frame; the hinges of a
joint turn in the order given. The shoulder's x and y are turned 45 degrees about z:
``humanoid.xml`` says why.
"""

FEET: tuple[str, str] = ("left_foot", "right_foot")
"""The order of arrays with one entry per foot."""

NUM_JOINTS, NUM_LINKS, NUM_DOFS = len(JOINTS), len(LINKS), len(DOFS)
FOOT_LINKS: tuple[int, int] = (LINKS.index("left_foot"), LINKS.index("right_foot"))


def _mirror(names: tuple[str, ...]) -> np.ndarray:
    swap = {"left": "right", "right": "left"}
    mirrored = []
    for name in names:
        side, _, rest = name.partition("_")
        mirrored.append(names.index(f"{swap[side]}_{rest}") if side in swap else names.index(name))
    return np.array(mirrored)


MIRROR_JOINTS: np.ndarray = _mirror(JOINTS)
MIRROR_DOFS: np.ndarray = _mirror(DOFS)
MIRROR_DOF_SIGNS: np.ndarray = np.array([1.0 if d.endswith("_y") else -1.0 for d in DOFS])
"""A reflection at the x-z plane keeps rotations about y and negates those about x and z."""
