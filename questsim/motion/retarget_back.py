"""Converts a ``Clip`` of the avatar to a ``Motion`` on 22 joints, e.g. a synthetic clip."""

from __future__ import annotations

import numpy as np

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M
from questsim.body_proportions import Proportions
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import link_offsets
from questsim.motion.limbs import ARM_REST, SIDES
from questsim.motion.motion import Motion
from questsim.skeleton import JOINT_PARENTS, JOINTS, LINK_JOINTS, LINKS, NUM_JOINTS

# Offsets of joints that are not at a link's origin, in their parents, for the 1.75 m body. The
# avatar has no collarbones: the offset from chest to shoulder is split between the two joints.
_OFFSETS = {
    "left_toe": (0.13, 0.0, -0.05), "right_toe": (0.13, 0.0, -0.05),
    "spine3": (0.0, 0.0, 0.12), "neck": (0.0, 0.0, 0.13), "head": (0.01, 0.0, 0.09),
    "left_clavicle": (0.0, 0.03, 0.085), "right_clavicle": (0.0, -0.03, 0.085),
    "left_shoulder": (0.0, 0.15, 0.0), "right_shoulder": (0.0, -0.15, 0.0),
}  # fmt: skip


def to_motion(clip: Clip) -> Motion:
    """The clip as a ``Motion``; joints that the avatar lacks stay at rest.

    The root is midway between the hips. Collarbones, third spine joint, head joint and toes do
    not move relative to their parents.
    """
    ratio = clip.height_m / DEFAULT_HEIGHT_M
    offsets = np.zeros((NUM_JOINTS, 3))
    for link, name in enumerate(LINK_JOINTS):
        offsets[JOINTS.index(name)] = link_offsets(clip.proportions)[link]
    for name, place in _OFFSETS.items():
        offsets[JOINTS.index(name)] = place
    if clip.proportions is not None:
        _in_proportion(offsets, clip.proportions)
    world = joint_orientations(clip)
    for side in SIDES:
        for name in ("elbow", "wrist"):
            joint = JOINTS.index(f"{side}_{name}")
            offsets[joint] = rot.quat_rotate(ARM_REST[side], offsets[joint])
    rotations = world.copy()
    for joint in range(1, NUM_JOINTS):
        rotations[:, joint] = rot.quat_multiply(
            rot.quat_conjugate(world[:, JOINT_PARENTS[joint]]), world[:, joint]
        )
    return Motion(
        name=clip.name,
        fps=FPS,
        root_position=clip.qpos[:, :3].copy(),
        rotations=rotations,
        offsets=offsets * ratio,
        source=clip.source,
        source_sha256=clip.source_sha256,
        licence=clip.licence,
        kind=clip.kind,
        style=clip.style,
        weight=clip.weight,
    )


def _in_proportion(offsets: np.ndarray, proportions: Proportions) -> None:
    """Move the joints of the chest that are not links, in place: its height and width differ."""
    places, chest = proportions.array(), JOINTS.index("spine3")
    offsets[chest, 2] *= proportions.stretch()[LINKS.index("chest"), 2]
    offsets[JOINTS.index("neck")] = places[LINKS.index("head")] - offsets[chest]
    for side in SIDES:
        arm, width = places[LINKS.index(f"{side}_upper_arm")], proportions.parts()["shoulders"]
        shoulder = JOINTS.index(f"{side}_shoulder")
        offsets[shoulder] *= width
        offsets[JOINTS.index(f"{side}_clavicle")] = arm - offsets[chest] - offsets[shoulder]


def joint_orientations(clip: Clip) -> np.ndarray:
    """World orientations ``(T, 22, 4)`` of a motion's joints, from the clip's links."""
    world = np.empty((len(clip), NUM_JOINTS, 4))
    known = dict(zip(LINK_JOINTS, range(len(LINKS)), strict=True))
    for joint, name in enumerate(JOINTS):
        if name in known:
            world[:, joint] = clip.link_quat[:, known[name]]
        else:
            world[:, joint] = world[:, JOINT_PARENTS[joint]]
    for side in SIDES:
        back = rot.quat_conjugate(ARM_REST[side])
        for part in ("shoulder", "elbow", "wrist"):
            joint = JOINTS.index(f"{side}_{part}")
            world[:, joint] = rot.quat_multiply(world[:, joint], back)
    return world
