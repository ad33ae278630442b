"""Faults of the devices of each simulation: latency, dropouts, noise, mounts and recentring."""

from __future__ import annotations

from typing import Any

import numpy as np

from envs.episode_random import EpisodeRandom, Seeds, Streams, within
from envs.kernel_arguments import PoseFaults
from envs.randomisation import Randomisation
from questsim import rotations as rot
from questsim.motion.clip import FPS

NEVER = np.iinfo(np.int64).max
_BITS = 2.0**53
_PER_DEVICE = 6
"""Random numbers of a device's mount: two directions and two sizes."""


class SignalFaults:
    """Latency, latency jitter and dropouts of the devices of each simulation.

    Args:
        options: ranges; None for perfect devices.
        n, devices: number of simulations, and of devices in each.
        seed: random seed.

    Attributes:
        late: ``(n,)`` latency in frames.
        newest: ``(n, devices)`` the newest row of the reference that a device has delivered.
    """

    def __init__(self, options: Randomisation | None, n: int, devices: int, seed: int) -> None:
        self._options = options or Randomisation()
        numbers = np.random.default_rng([seed, 11]).random((n, 2))
        self._streams, self._all = Streams(n, seed, 11), np.arange(n)
        self.late = _whole(numbers[:, 0], self._options.latency_frames)
        self.dropout = within(numbers[:, 1], self._options.dropout)
        self.newest = np.full((n, devices), NEVER)
        self._until = np.zeros((n, devices), np.int64)
        jitter = np.random.default_rng([seed, 12]).random(n)
        self._jitter = _whole(jitter, self._options.latency_jitter_frames)
        self._jitter_streams = Streams(n, seed, 12)
        self._arrived = np.zeros((n, devices), np.int64)

    def begin(self, ids: np.ndarray, newest: np.ndarray) -> None:
        """Begin episodes ``ids``; ``newest`` ``(m,)`` is the newest row at their start."""
        self.newest[ids], self._until[ids] = NEVER, 0
        self._arrived[ids] = newest[:, None]

    def advance(self, newest: np.ndarray) -> None:
        """Advance one frame; ``newest`` ``(n,)`` is the newest row without dropouts and jitter."""
        last = np.broadcast_to(newest[:, None] - 1, self.newest.shape)
        if self._jitter.any():
            last = self._arrived.copy()
            numbers = self._jitter_streams.draw(self._all, self.newest.shape[1])
            extra = (numbers * (self._jitter[:, None] + 1)).astype(np.int64)
            # What has arrived once stays, even if the next frame is later.
            np.maximum(last, newest[:, None] - extra, out=self._arrived)
        if self.dropout.any():
            self._drop_out(last)
        if self._jitter.any():
            reporting = self._until == 0
            self.newest[reporting] = self._arrived[reporting]

    def _drop_out(self, last: np.ndarray) -> None:
        """Begin and end dropouts; ``last`` ``(n, devices)`` is the row shown one frame ago."""
        self._until = np.maximum(self._until - 1, 0)
        self.newest[self._until == 0] = NEVER
        n, devices = self.newest.shape
        numbers = self._streams.draw(self._all, 2 * devices).reshape(n, 2, devices)
        falls = (numbers[:, 0] < self.dropout[:, None]) & (self._until == 0)
        low, high = self._options.dropout_frames
        frames = (low + (high - low + 1) * numbers[:, 1]).astype(np.int64)
        self._until = np.where(falls, np.minimum(frames, high), self._until)
        self.newest[falls] = last[falls]

    def seed(self, seeds: Seeds) -> None:
        """Seed the random streams of dropouts and jitter; latencies and probabilities stay."""
        self._streams.seed(seeds)
        self._jitter_streams.seed(seeds)

    def get_state(self) -> dict[str, object]:
        """State that determines later signals."""
        return {
            "rng": self._streams.get_state(),
            "jitter": self._jitter_streams.get_state(),
            "newest": self.newest.copy(),
            "until": self._until.copy(),
            "arrived": self._arrived.copy(),
        }

    def set_state(self, state: dict) -> None:
        """Restore the result of ``get_state``."""
        self._streams.set_state(state["rng"])
        self.newest[:], self._until[:] = state["newest"], state["until"]
        self._jitter_streams.set_state(state["jitter"])
        self._arrived[:] = state["arrived"]


class DeviceFaults:
    """Noise, mounting errors and recentring: drawn in every episode.

    Args:
        options: ranges; None for perfect devices.
        random: numbers to draw from.
        n, devices: number of simulations, and of devices in each.
        seed: seed of the noise levels, drawn once per simulation.

    Attributes:
        poses: for the kernel of observations; empty arrays if poses have no errors.
        before: ``(n, 4)`` place before the jump of this episode.
        jump: ``(n,)`` frames since the start of the episode at which the user jumps.
        jumped: ``(n,)`` bool, whether the user has jumped.
    """

    def __init__(
        self, options: Randomisation | None, random: EpisodeRandom, n: int, devices: int, seed: int
    ) -> None:
        self._options, self._random, self._devices = options or Randomisation(), random, devices
        levels = np.random.default_rng([seed, 13]).random((n, 2))
        std = [
            within(levels[:, 0], self._options.noise_m),
            within(levels[:, 1], self._options.noise_rad),
        ]
        used = n if self._options.of_poses else 0
        self.poses = PoseFaults(
            key=np.zeros(used, np.uint64),
            std=np.stack(std, axis=-1)[:used],
            mount_offset=np.zeros((used, devices, 3)),
            mount_quat=np.zeros((used, devices, 4)),
        )
        self.before, self.jump = np.zeros((n, 4)), np.full(n, NEVER)
        self.jumped = np.zeros(n, bool)
        self._by = np.zeros((n, 3))

    def begin(self, ids: np.ndarray, clips: np.ndarray) -> None:
        """Draw noise, mounts and jump of the episodes that ``ids`` begin with ``clips``."""
        options, poses = self._options, self.poses
        if not (options.of_poses or options.recentres) or len(ids) == 0:
            return
        numbers = self._random.draw(ids, clips, 5 + _PER_DEVICE * self._devices)
        if options.of_poses:
            poses.key[ids] = (numbers[:, 0] * _BITS).astype(np.uint64)
            mounts = numbers[:, 5:].reshape(len(ids), self._devices, _PER_DEVICE)
            offset = within(mounts[..., 2], options.mount_m)[..., None] * _on_sphere(mounts)
            turn = within(mounts[..., 5], options.mount_rad)[..., None] * _on_sphere(
                mounts[..., 3:]
            )
            poses.mount_offset[ids] = offset
            poses.mount_quat[ids] = rot.as_quat(
                rot.from_rotvec(turn.reshape(-1, 3)), turn.shape[:-1]
            )
        if options.recentres:
            self.jumped[ids], seconds = False, within(numbers[:, 1], options.recentre_s)
            self.jump[ids] = np.maximum(np.round(seconds * FPS), 1).astype(np.int64)
            angle = 2.0 * np.pi * numbers[:, 2]
            shift = within(numbers[:, 3], options.recentre_m)
            side, size = np.where(numbers[:, 4] < 0.5, -1.0, 1.0), np.abs(2.0 * numbers[:, 4] - 1.0)
            self._by[ids, 0], self._by[ids, 1] = shift * np.cos(angle), shift * np.sin(angle)
            self._by[ids, 2] = side * within(size, options.recentre_rad)

    def recentre(self, frames: np.ndarray, place: np.ndarray, root: np.ndarray) -> np.ndarray:
        """Move the places of users that jump in this frame, and return their simulations.

        Args:
            frames: ``(n,)`` since the start of each episode.
            place: ``(n, 4)`` of the clips, changed in place.
            root: ``(n, 2)`` horizontal position of the users, about which they turn.
        """
        ids = np.flatnonzero(frames == self.jump)
        if len(ids) == 0:
            return ids
        self.before[ids], self.jumped[ids] = place[ids], True
        by, centre = self._by[ids], root[ids]
        cos, sin = np.cos(by[:, 2]), np.sin(by[:, 2])
        x, y = (place[ids, :2] - centre).T
        place[ids, 0] = cos * x - sin * y + centre[:, 0] + by[:, 0]
        place[ids, 1] = sin * x + cos * y + centre[:, 1] + by[:, 1]
        c, s = place[ids, 2], place[ids, 3]
        place[ids, 2], place[ids, 3] = cos * c - sin * s, sin * c + cos * s
        return ids

    def seed(self, seeds: Seeds) -> None:
        """Seed the random streams; the noise levels stay."""
        self._random.seed(seeds)

    def _arrays(self) -> dict[str, np.ndarray]:
        return {
            "before": self.before,
            "jump": self.jump,
            "jumped": self.jumped,
            "by": self._by,
            "key": self.poses.key,
            "mount_offset": self.poses.mount_offset,
            "mount_quat": self.poses.mount_quat,
        }

    def get_state(self) -> dict[str, Any]:
        """State that determines later signals."""
        arrays = {name: array.copy() for name, array in self._arrays().items()}
        return {"rng": self._random.get_state(), **arrays}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore the result of ``get_state``."""
        self._random.set_state(state["rng"])
        for name, array in self._arrays().items():
            array[:] = state[name]


def _whole(numbers: np.ndarray, low_high: tuple[int, int]) -> np.ndarray:
    """Map numbers in [0, 1) to whole numbers of a range, both ends included."""
    low, high = low_high
    return np.minimum((low + (high - low + 1) * numbers).astype(np.int64), high)


def _on_sphere(numbers: np.ndarray) -> np.ndarray:
    """Unit vectors ``(..., 3)``, spread evenly, for two numbers in [0, 1) each."""
    up, angle = 2.0 * numbers[..., 0] - 1.0, 2.0 * np.pi * numbers[..., 1]
    level = np.sqrt(np.maximum(1.0 - up * up, 0.0))
    return np.stack([level * np.cos(angle), level * np.sin(angle), up], axis=-1)
