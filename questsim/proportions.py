"""Body proportions: measure and change the lengths of a skeleton's bone groups."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from questsim.errors import InputError
from questsim.motion.checks import stature_of
from questsim.motion.motion import Motion
from questsim.skeleton import JOINTS, NUM_JOINTS

BONES: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("hip width", ("left_hip", "right_hip")),
    ("left thigh", ("left_knee",)),
    ("right thigh", ("right_knee",)),
    ("left shin", ("left_ankle",)),
    ("right shin", ("right_ankle",)),
    ("feet", ("left_toe", "right_toe")),
    ("lower trunk", ("spine1", "spine2")),
    ("upper trunk", ("spine3",)),
    ("neck", ("neck",)),
    ("head", ("head",)),
    ("collarbones", ("left_clavicle", "right_clavicle")),
    ("shoulder width", ("left_shoulder", "right_shoulder")),
    ("left upper arm", ("left_elbow",)),
    ("right upper arm", ("right_elbow",)),
    ("left forearm", ("left_wrist",)),
    ("right forearm", ("right_wrist",)),
)
"""The 16 measurements that stand in for a shape space, and the joints whose offsets they scale."""

NUM_BONES = len(BONES)
_LIMBS = ("thigh", "upper arm", "shin", "forearm")

SPREAD = {"legs": 0.08, "arms": 0.08, "trunk": 0.06, "hip": 0.10, "shoulder": 0.08, "side": 0.005}
"""Standard deviations of the logarithm of lengths in ``random_scales``: groups apart, and sides."""


def bone_of_joint() -> np.ndarray:
    """``(22,)`` which of ``BONES`` scales each joint's offset; -1 for the root."""
    out = np.full(NUM_JOINTS, -1)
    for bone, (_, joints) in enumerate(BONES):
        for joint in joints:
            out[JOINTS.index(joint)] = bone
    return out


def bone_lengths(offsets: np.ndarray) -> np.ndarray:
    """Lengths in metres ``(..., 16)`` of the ``BONES`` of offsets ``(..., 22, 3)``, sides added."""
    length = np.linalg.norm(np.asarray(offsets, float), axis=-1)
    return np.stack(
        [length[..., [JOINTS.index(j) for j in joints]].sum(-1) for _, joints in BONES], axis=-1
    )


def scaled_offsets(offsets: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Offsets ``(..., 22, 3)`` with every bone's length times its scale ``(..., 16)``."""
    by_joint = np.concatenate([scales, np.ones((*scales.shape[:-1], 1))], axis=-1)
    return offsets * by_joint[..., bone_of_joint(), None]


def random_scales(rng: np.random.Generator, count: int) -> np.ndarray:
    """Proportions of ``count`` people ``(count, 16)``: arms, legs, trunk and widths independent.

    The two sides of a person differ a little, as people's do.
    """
    groups = {name: rng.normal(0.0, std, count) for name, std in SPREAD.items() if name != "side"}
    log = np.zeros((count, NUM_BONES))
    for bone, (name, _) in enumerate(BONES):
        if any(name.endswith(limb) for limb in _LIMBS):
            group = "arms" if "arm" in name else "legs"
            log[:, bone] = groups[group] + rng.normal(0.0, SPREAD["side"], count)
        elif name == "feet":
            log[:, bone] = groups["legs"]
        elif name in ("shoulder width", "collarbones"):
            log[:, bone] = groups["shoulder"]
        else:
            log[:, bone] = groups["hip" if name == "hip width" else "trunk"]
    return np.exp(np.clip(log, -0.25, 0.25))


def measurements(offsets: np.ndarray) -> np.ndarray:
    """Stature and limb lengths in metres ``(..., 9)`` of offsets ``(..., 22, 3)``.

    Stature, then left and right of thigh, upper arm, shin and forearm: what a tape measures.
    """
    offsets = np.asarray(offsets, float)
    lengths = bone_lengths(offsets)
    names = [name for name, _ in BONES]
    limbs = [names.index(f"{side} {limb}") for limb in _LIMBS for side in ("left", "right")]
    flat = offsets.reshape(-1, NUM_JOINTS, 3)
    heights = np.array([stature_of(one) for one in flat]).reshape(*offsets.shape[:-2], 1)
    return np.concatenate([heights, lengths[..., limbs]], axis=-1)


def leg_length(offsets: np.ndarray) -> np.ndarray:
    """Metres ``(...)`` from hip to ankle, mean of both sides, of offsets ``(..., 22, 3)``."""
    lengths = bone_lengths(offsets)
    return lengths[..., 1:5].sum(-1) / 2.0


def resized(motion: Motion, scales: np.ndarray) -> Motion:
    """Apply a motion's joint angles to other proportions, with the feet on the same floor.

    The root's path scales with the legs. It is raised or lowered so that the height of the lower
    ankle scales as well.

    Args:
        motion: any.
        scales: ``(16,)`` lengths of ``BONES`` as multiples of this person's.

    Raises:
        InputError: scales that are not 16 positive numbers.
    """
    scales = np.asarray(scales, float)
    if scales.shape != (NUM_BONES,) or not (scales > 0).all() or not np.isfinite(scales).all():
        raise InputError(f"scales are not {NUM_BONES} positive numbers", motion.name)
    offsets = scaled_offsets(motion.offsets, scales)
    ratio = float(leg_length(offsets) / leg_length(motion.offsets))
    moved = replace(motion, offsets=offsets, root_position=motion.root_position * ratio)
    ankles = [JOINTS.index(name) for name in ("left_ankle", "right_ankle")]
    before = motion.forward_kinematics()[0][:, ankles, 2].min()
    after = moved.forward_kinematics()[0][:, ankles, 2].min()
    root = moved.root_position + np.array([0.0, 0.0, before * ratio - after])
    return replace(moved, root_position=root)
