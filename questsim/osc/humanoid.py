"""The avatar as Unity's humanoid: bone names, and poses local to the parent."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from questsim import rotations as rot
from questsim.avatar_pose import AvatarPose
from questsim.devices import from_ours
from questsim.motion.limbs import ARM_REST
from questsim.skeleton import LINK_PARENTS, LINKS

BONES: dict[str, str] = {
    "pelvis": "Hips",
    "left_thigh": "LeftUpperLeg", "left_shin": "LeftLowerLeg", "left_foot": "LeftFoot",
    "right_thigh": "RightUpperLeg", "right_shin": "RightLowerLeg", "right_foot": "RightFoot",
    "spine": "Spine", "chest": "Chest", "head": "Neck",
    "left_upper_arm": "LeftUpperArm", "left_forearm": "LeftLowerArm", "left_hand": "LeftHand",
    "right_upper_arm": "RightUpperArm", "right_forearm": "RightLowerArm",
    "right_hand": "RightHand",
}  # fmt: skip
"""Unity's ``HumanBodyBones`` of each link. The avatar's head turns at the neck: it is ``Neck``."""


class BonePose(NamedTuple):
    """A bone in its parent, in Unity's axes.

    Attributes:
        name: of ``HumanBodyBones``.
        position: ``(3,)`` metres, left-handed, y up, z forward.
        quat: ``(4,)`` xyzw; the identity in a T-pose.
    """

    name: str
    position: np.ndarray
    quat: np.ndarray


def t_pose_quats(link_quat: np.ndarray) -> np.ndarray:
    """Link orientations ``(16, 4)`` as turns from the T-pose: arms along y instead of hanging."""
    quat = np.array(link_quat, float)
    for side, rest in ARM_REST.items():
        for part in ("upper_arm", "forearm", "hand"):
            link = LINKS.index(f"{side}_{part}")
            quat[link] = rot.quat_multiply(quat[link], rot.quat_conjugate(rest))
    return quat


def unity_bones(pose: AvatarPose) -> list[BonePose]:
    """All sixteen bones, parents first; the hips in the world, which is their parent's frame."""
    world = t_pose_quats(pose.link_quat)
    bones = []
    for link, name in enumerate(LINKS):
        if link == 0:
            position, quat = pose.link_position[0], world[0]
        else:
            back = rot.quat_conjugate(world[LINK_PARENTS[link]])
            between = pose.link_position[link] - pose.link_position[LINK_PARENTS[link]]
            position = rot.quat_rotate(back, between)
            quat = rot.quat_multiply(back, world[link])
        bones.append(BonePose(BONES[name], *from_ours(position, quat, "unity")))
    return bones
