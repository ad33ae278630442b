"""Random numbers of episodes: a stream while training, fixed by the clip's name in evaluations."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np


class EpisodeRandom:
    """Even random numbers in [0, 1) for what happens in episodes.

    Args:
        names: of the clips.
        seed: same seed, same numbers.
        stream: one for each use, so that no use changes another's numbers.
        fixed: numbers depend on seed, clip and turn alone, whatever the batch and its past.
    """

    def __init__(self, names: Sequence[str], seed: int, stream: int, fixed: bool) -> None:
        self._keys = [zlib.crc32(name.encode()) for name in names]
        self._own_seed, self._stream, self._fixed = seed, stream, fixed
        self.seed(seed)

    def seed(self, seed: int) -> None:
        """Begin the stream anew."""
        self._rng = np.random.default_rng([seed, self._stream])

    def draw(self, clips: np.ndarray, width: int, turn: np.ndarray | None = None) -> np.ndarray:
        """Numbers ``(m, width)``.

        Args:
            clips: ``(m,)`` the clip that each episode plays.
            width: how many each.
            turn: ``(m,)`` how many draws the episode has had before; zero if None.
        """
        if not self._fixed:
            return self._rng.random((len(clips), width))
        turn = np.zeros(len(clips), np.int64) if turn is None else turn
        keys = [
            [self._own_seed, self._stream, self._keys[clip], int(t)]
            for clip, t in zip(clips, turn, strict=True)
        ]
        return np.array([np.random.default_rng(key).random(width) for key in keys])

    def get_state(self) -> Any:
        """Where the stream stands."""
        return self._rng.bit_generator.state

    def set_state(self, state: Any) -> None:
        """Go on where ``get_state`` stood."""
        self._rng.bit_generator.state = state


def within(numbers: np.ndarray, low_high: tuple[float, float]) -> np.ndarray:
    """Numbers in [0, 1) spread over a range."""
    low, high = low_high
    return low + (high - low) * numbers
