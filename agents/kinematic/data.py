"""Training data of the kinematic systems: windows of recordings on bodies of varied proportions."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from agents.run_folder import amounts
from questsim import differentiable as diff
from questsim.errors import InputError
from questsim.joint_sensors import SENSOR_FPS
from questsim.motion.clip import source_kind
from questsim.motion.motion import Motion
from questsim.proportions import leg_length, random_scales, scaled_offsets
from questsim.skeleton import MIRROR_JOINTS

UNCHANGED = 0.25
"""Share of windows with the performer's own proportions."""


@dataclass(frozen=True)
class Windows:
    """A batch of motion; all arrays are float32.

    Attributes:
        local: ``(B, T, 22, 3, 3)`` rotations in the parent's frame.
        world: ``(B, T, 22, 3, 3)`` orientations.
        position: ``(B, T, 22, 3)`` joints in metres.
        offsets: ``(B, 22, 3)``.
    """

    local: Tensor
    world: Tensor
    position: Tensor
    offsets: Tensor

    def __len__(self) -> int:
        return len(self.offsets)

    @property
    def frames(self) -> int:
        """``T``."""
        return self.local.shape[1]


class MotionBank:
    """All frames of the recordings at 60 fps, to draw windows from.

    Args:
        motions: recordings of any frame rate.
        length: frames per window; shorter motions are left out.
        held: recordings that are only in the fixed windows on which checkpoints are compared.
        kind_power: windows of a kind of motion are drawn in proportion to this power of its
            frames: 1 draws all frames equally often, 0 all kinds.

    Raises:
        InputError: no motion is long enough.
    """

    def __init__(
        self,
        motions: Sequence[Motion],
        length: int,
        held: Sequence[Motion] = (),
        kind_power: float = 1.0,
    ) -> None:
        alike = [replace(motion, weight=1.0) for motion in held]  # weights are for learning
        self.validation: MotionBank = MotionBank(alike, length) if held else self
        kept = [m for m in (motion.resampled(SENSOR_FPS) for motion in motions) if len(m) >= length]
        if not kept:
            raise InputError(
                f"no motion has {length} frames at {SENSOR_FPS:g} fps", "--motions", "name others"
            )
        self.length = length
        self.root = np.concatenate([m.root_position for m in kept]).astype(np.float32)
        self.rotations = np.concatenate([m.rotations for m in kept]).astype(np.float32)
        self.offsets = np.stack([m.offsets for m in kept])
        frames = np.array([len(m) for m in kept])
        self.first = np.cumsum(frames) - frames
        self.starts = frames - length + 1
        weight = self.starts * _by_kind([m.kind for m in kept], self.starts, kind_power)
        weight *= [m.weight for m in kept]
        self.probability = weight / weight.sum()

    @property
    def template(self) -> np.ndarray:
        """Mean ``(22, 3)`` of the performers' offsets."""
        return self.offsets.mean(axis=0)

    def windows(self, stride: int) -> int:
        """Number of windows in one pass: one every ``stride`` frames, or with 0 one per motion."""
        return int(np.ceil(self.starts / stride).sum()) if stride else len(self.starts)

    def draw(self, count: int, rng: np.random.Generator, vary: bool = True) -> Windows:
        """A batch of windows at random times and headings; every second one is mirrored.

        Args:
            count: number of windows.
            rng: source of all random numbers.
            vary: whether most bodies get random proportions; otherwise all are as recorded.
        """
        clip = rng.choice(len(self.first), size=count, p=self.probability)
        start = self.first[clip] + (rng.random(count) * self.starts[clip]).astype(np.int64)
        rows = start[:, None] + np.arange(self.length)
        offsets = self.offsets[clip]
        root, rotations = self.root[rows].astype(float), self.rotations[rows]
        if vary:
            scales = random_scales(rng, count)
            scales[rng.random(count) < UNCHANGED] = 1.0
            resized = scaled_offsets(offsets, scales)
            root = root * (leg_length(resized) / leg_length(offsets))[:, None, None]
            offsets = resized
        mirrored = rng.random(count) < 0.5
        rotations, root, offsets = _mirror(rotations, root, offsets, mirrored)
        return _windows(rotations, root, offsets, rng.uniform(-np.pi, np.pi, count))

    def fixed(self, count: int) -> Windows:
        """A fixed set of windows from all recordings, to compare checkpoints."""
        return self.draw(count, np.random.default_rng(20_260))


def _by_kind(kinds: Sequence[str], starts: np.ndarray, power: float) -> np.ndarray:
    """Factor on each recording's chance, so that a kind's is its number of starts to ``power``.

    Variations count as their source's kind.
    """
    _, kind = np.unique([source_kind(kind) for kind in kinds], return_inverse=True)
    return np.bincount(kind, weights=starts)[kind] ** (power - 1.0)


def _mirror(
    rotations: np.ndarray, root: np.ndarray, offsets: np.ndarray, which: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mirror the windows of ``which`` at the x-z plane; see ``Motion.mirrored``."""
    turned = rotations[:, :, MIRROR_JOINTS] * np.array([1, -1, 1, -1], np.float32)
    flip = np.array([1.0, -1.0, 1.0])
    return (
        np.where(which[:, None, None, None], turned, rotations),
        np.where(which[:, None, None], root * flip, root),
        np.where(which[:, None, None], offsets[:, MIRROR_JOINTS] * flip, offsets),
    )


def _windows(
    rotations: np.ndarray, root: np.ndarray, offsets: np.ndarray, yaw: np.ndarray
) -> Windows:
    quat = diff.unit_quat(torch.as_tensor(rotations))
    local = diff.quat_to_matrix(quat)
    angle = torch.as_tensor(yaw, dtype=torch.float32)
    turn = diff.yaw_matrix(angle.cos(), angle.sin())[:, None]
    local = torch.cat([(turn @ local[:, :, 0])[:, :, None], local[:, :, 1:]], dim=2)
    path = torch.as_tensor(root - root[:, :1] * [1.0, 1.0, 0.0], dtype=torch.float32)
    path = (turn @ path[..., None]).squeeze(-1)
    bones = torch.as_tensor(offsets, dtype=torch.float32)
    position, world = diff.forward_kinematics(local, path, bones[:, None])
    return Windows(local, world, position, bones)


def motions_record(spec: str, motions: Sequence[Motion]) -> dict[str, Any]:
    """Record of the training data, like ``run_folder.data_record`` for clips."""
    digest = hashlib.sha256()
    for motion in sorted(motions, key=lambda motion: motion.name):
        weight = "" if motion.weight == 1.0 else f" {motion.weight:g}"
        digest.update(f"{motion.name} {motion.source_sha256} {motion.fps:g}{weight}".encode())
        for array in (motion.root_position, motion.rotations, motion.offsets):
            digest.update(array.astype("<f4").tobytes())
    return amounts(spec, motions) | {"sha256": digest.hexdigest()}
