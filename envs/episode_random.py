"""Random numbers of episodes: one stream per simulation in training, per clip in evaluation."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

Seeds = int | Sequence[int | None]
"""A seed of the whole batch, or one for each simulation, where None leaves its stream alone."""

_STEP = np.uint64(0x9E3779B97F4A7C15)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


class Streams:
    """An independent random stream for each simulation.

    SplitMix64 (Steele, Lea and Flood, OOPSLA 2014): two numbers of state per stream, and any set
    of streams is drawn in one call. Streams begin at random places of its cycle.

    Args:
        count: number of streams.
        seed: same seed, same numbers; stream ``i`` does not depend on ``count``.
        purpose: streams of different purposes are independent for the same seed.
    """

    def __init__(self, count: int, seed: int, purpose: int) -> None:
        self._purpose = purpose
        self._start = np.zeros(count, np.uint64)
        self._drawn = np.zeros(count, np.uint64)
        self.seed(seed)

    def seed(self, seeds: Seeds) -> None:
        """Seed the streams; ``seed(s)`` and ``seed([s])`` give stream 0 the same numbers."""
        if isinstance(seeds, int | np.integer):
            self._start[:] = self._starts(int(seeds), len(self._start))
            self._drawn[:] = 0
            return
        for i, seed in enumerate(seeds):
            if seed is not None:
                self._start[i], self._drawn[i] = self._starts(seed, 1)[0], 0

    def _starts(self, seed: int, count: int) -> np.ndarray:
        return np.random.SeedSequence([seed, self._purpose]).generate_state(count, np.uint64)

    def draw(self, ids: np.ndarray, width: int) -> np.ndarray:
        """The next numbers in [0, 1) ``(m, width)`` of streams ``ids`` ``(m,)``, each once."""
        steps = self._drawn[ids, None] + np.arange(1, width + 1, dtype=np.uint64)
        self._drawn[ids] += np.uint64(width)
        bits = self._start[ids, None] + steps * _STEP
        bits = (bits ^ (bits >> np.uint64(30))) * _FIRST
        bits = (bits ^ (bits >> np.uint64(27))) * _SECOND
        bits ^= bits >> np.uint64(31)
        return (bits >> np.uint64(11)) * 2.0**-53

    def get_state(self) -> dict[str, np.ndarray]:
        """State that determines all later numbers."""
        return {"start": self._start.copy(), "drawn": self._drawn.copy()}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore the result of ``get_state``."""
        self._start[:], self._drawn[:] = state["start"], state["drawn"]


class EpisodeRandom:
    """Uniform random numbers in [0, 1) for the events of episodes.

    Args:
        names: names of the clips.
        count: number of simulations.
        seed: same seed, same numbers.
        purpose: one for each use, so that the uses are independent.
        fixed: numbers depend on seed, clip and turn only, not on the batch or earlier episodes.
    """

    def __init__(
        self, names: Sequence[str], count: int, seed: int, purpose: int, fixed: bool
    ) -> None:
        self._keys = [zlib.crc32(name.encode()) for name in names]
        self._own_seed, self._purpose, self._fixed = seed, purpose, fixed
        self._streams = Streams(count, seed, purpose)

    def seed(self, seeds: Seeds) -> None:
        """Restart the streams."""
        self._streams.seed(seeds)

    def draw(
        self, ids: np.ndarray, clips: np.ndarray, width: int, turn: np.ndarray | None = None
    ) -> np.ndarray:
        """Draw numbers ``(m, width)``.

        Args:
            ids: ``(m,)`` simulations, each once.
            clips: ``(m,)`` the clip that each episode plays.
            width: numbers per simulation.
            turn: ``(m,)`` number of earlier draws in the episode; zero if None.
        """
        if not self._fixed:
            return self._streams.draw(ids, width)
        turn = np.zeros(len(clips), np.int64) if turn is None else turn
        keys = [
            [self._own_seed, self._purpose, self._keys[clip], int(t)]
            for clip, t in zip(clips, turn, strict=True)
        ]
        return np.array([np.random.default_rng(key).random(width) for key in keys])

    def get_state(self) -> Any:
        """Where the streams stand."""
        return self._streams.get_state()

    def set_state(self, state: Any) -> None:
        """Go on where ``get_state`` stood."""
        self._streams.set_state(state)


class Drawing:
    """Base of what draws events of episodes and has no other state.

    Attributes:
        _random: its random numbers.
    """

    _random: EpisodeRandom

    def seed(self, seeds: Seeds) -> None:
        """Seed the random streams."""
        self._random.seed(seeds)

    def get_state(self) -> Any:
        """State that determines later events."""
        return self._random.get_state()

    def set_state(self, state: Any) -> None:
        """Restore the result of ``get_state``."""
        self._random.set_state(state)


def within(numbers: np.ndarray, low_high: tuple[float, float]) -> np.ndarray:
    """Map numbers in [0, 1) to a range."""
    low, high = low_high
    return low + (high - low) * numbers
