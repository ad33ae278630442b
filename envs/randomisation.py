"""Random differences between the simulations of a batch, for robust policies."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from envs.episode_random import Seeds, Streams, within
from envs.pushes import check_range
from questsim.skeleton import NUM_LINKS

NEVER = np.iinfo(np.int64).max


@dataclass(frozen=True)
class Randomisation:
    """Ranges of the random values; each simulation of a batch draws once.

    Attributes:
        friction: factor on the friction of avatar and floor.
        mass: factor on mass and inertia of all links.
        latency_frames: latency of the devices in whole frames.
        dropout: probability per frame that a dropout of a device begins.
        dropout_frames: duration of a dropout; the device then repeats its last pose.

    Raises:
        InputError: an invalid range.
    """

    friction: tuple[float, float] = (1.0, 1.0)
    mass: tuple[float, float] = (1.0, 1.0)
    latency_frames: tuple[int, int] = (0, 0)
    dropout: tuple[float, float] = (0.0, 0.0)
    dropout_frames: tuple[int, int] = (4, 18)

    def __post_init__(self) -> None:
        for name, least, most in (
            ("friction", 0.05, 5.0),
            ("mass", 0.5, 2.0),
            ("latency_frames", 0, 36),
            ("dropout", 0.0, 1.0),
            ("dropout_frames", 1, 360),
        ):
            check_range(name, getattr(self, name), least, most, "randomisation")

    @property
    def of_bodies(self) -> bool:
        """Whether simulations need models of their own."""
        return self.friction != (1.0, 1.0) or self.mass != (1.0, 1.0)


def varied_models(
    models: list[mujoco.MjModel], options: Randomisation, seed: int
) -> list[mujoco.MjModel]:
    """Copies of a batch's models with friction and masses drawn for each."""
    numbers = np.random.default_rng([seed, 10]).random((len(models), 2))
    friction = within(numbers[:, 0], options.friction)
    mass = within(numbers[:, 1], options.mass)
    varied = []
    for model, slide, weight in zip(models, friction, mass, strict=True):
        own = mujoco.MjModel.__copy__(model)
        own.geom_friction[:, 0] *= slide
        own.body_mass[1 : 1 + NUM_LINKS] *= weight
        own.body_inertia[1 : 1 + NUM_LINKS] *= weight
        mujoco.mj_setConst(own, mujoco.MjData(own))
        varied.append(own)
    return varied


class SignalFaults:
    """Latency and dropout of the devices of each simulation.

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
        low, high = self._options.latency_frames
        self.late = np.minimum((low + (high - low + 1) * numbers[:, 0]).astype(np.int64), high)
        self.dropout = within(numbers[:, 1], self._options.dropout)
        self.newest = np.full((n, devices), NEVER)
        self._until = np.zeros((n, devices), np.int64)

    def begin(self, ids: np.ndarray) -> None:
        """End the dropouts of simulations ``ids``."""
        self.newest[ids], self._until[ids] = NEVER, 0

    def advance(self, newest: np.ndarray) -> None:
        """Advance one frame; ``newest`` ``(n,)`` is the newest row without dropouts."""
        if not self.dropout.any():
            return
        self._until = np.maximum(self._until - 1, 0)
        self.newest[self._until == 0] = NEVER
        n, devices = self.newest.shape
        numbers = self._streams.draw(self._all, 2 * devices).reshape(n, 2, devices)
        falls = (numbers[:, 0] < self.dropout[:, None]) & (self._until == 0)
        low, high = self._options.dropout_frames
        frames = (low + (high - low + 1) * numbers[:, 1]).astype(np.int64)
        self._until = np.where(falls, np.minimum(frames, high), self._until)
        shown = np.broadcast_to(newest[:, None] - 1, self.newest.shape)
        self.newest[falls] = shown[falls]

    def seed(self, seeds: Seeds) -> None:
        """Seed the random streams of dropouts; latencies and probabilities stay."""
        self._streams.seed(seeds)

    def get_state(self) -> dict[str, object]:
        """State that determines later signals."""
        return {
            "rng": self._streams.get_state(),
            "newest": self.newest.copy(),
            "until": self._until.copy(),
        }

    def set_state(self, state: dict) -> None:
        """Restore the result of ``get_state``."""
        self._streams.set_state(state["rng"])
        self.newest[:], self._until[:] = state["newest"], state["until"]
