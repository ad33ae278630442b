"""Sampling of episode starts: uniform over frames, or more often where the policy falls."""

from __future__ import annotations

import numpy as np

from envs.reference import Reference
from questsim.motion.clip import source_kind

BIN_FRAMES = 36
"""Width of the bins of moments within a clip: one second."""
HORIZON_FRAMES = 72
"""A fall within this many frames counts against the moment the episode began."""
SMOOTHING = 0.2
WEIGHT_RANGE = (0.3, 3.0)
"""Bounds of the sampling weights, as multiples of the mean: no clip vanishes or dominates."""


class Sampler:
    """Draws (clip, first frame) pairs; failure rates of clips and of their moments are learned.

    A clip's weight multiplies how often it is drawn.

    Args:
        reference: the clips.
        weighted: whether falls raise the probability of a clip and a moment.
        by_kind: whether kinds of motion are drawn in proportion to the square root of their frames.
            Then 20 clips of one kind still appear beside 400 of another. Variations count as their
            source's kind.
        tail: number of frames at a clip's end in which no episode begins.
        of_clip: ``(C,)`` group of each clip, if only the clips of a group are drawn.
    """

    def __init__(
        self,
        reference: Reference,
        weighted: bool,
        by_kind: bool = False,
        tail: int = 2,
        of_clip: np.ndarray | None = None,
    ) -> None:
        self._start = reference.start
        self._starts_in_clip = np.maximum(reference.end - reference.start - tail, 1)
        bins = -(-self._starts_in_clip // BIN_FRAMES)
        self._first_bin = np.concatenate([[0], np.cumsum(bins)])
        self._clip_of_bin = np.repeat(np.arange(len(bins)), bins)
        offset = np.arange(self._first_bin[-1]) - self._first_bin[self._clip_of_bin]
        self._bin_start = offset * BIN_FRAMES
        left = self._starts_in_clip[self._clip_of_bin] - self._bin_start
        self._bin_frames = np.minimum(left, BIN_FRAMES)
        self._weighted = weighted
        self._amount = self._bin_frames.astype(float)
        if by_kind:
            kinds = [source_kind(kind) for kind in reference.kinds]
            _, kind = np.unique(kinds, return_inverse=True)
            kind_of_bin = kind[self._clip_of_bin]
            self._amount /= np.sqrt(np.bincount(kind_of_bin, self._amount))[kind_of_bin]
        self._amount *= reference.weights[self._clip_of_bin]
        self.clip_failure = np.full(len(bins), 0.5)
        self.bin_failure = np.full(len(self._clip_of_bin), 0.5)
        self._cumulative: np.ndarray | None = None
        self._of_bin = None if of_clip is None else of_clip[self._clip_of_bin]
        self.log: list[tuple[np.ndarray, ...]] | None = None
        """Where a list is put here, it gets the arguments of every ``record``."""

    def draw(
        self, numbers: np.ndarray, groups: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Clips and first frames in them, int64 ``(m,)`` each, for numbers ``(m, 2)`` in [0, 1).

        Args:
            numbers: uniform random numbers.
            groups: ``(m,)`` draw only clips of these groups.
        """
        if groups is not None and self._of_bin is not None:
            pick = self._pick_of(groups, numbers[:, 0])
        else:
            if self._cumulative is None:
                weights = self.weights()
                self._cumulative = np.cumsum(weights / weights.sum())
            pick = np.searchsorted(self._cumulative, numbers[:, 0], side="right")
            pick = np.minimum(pick, len(self._cumulative) - 1)
        within = (numbers[:, 1] * self._bin_frames[pick]).astype(np.int64)
        return self._clip_of_bin[pick], self._bin_start[pick] + within

    def _pick_of(self, groups: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Bins ``(m,)`` of the groups ``(m,)``."""
        weights, pick = self.weights(), np.zeros(len(groups), np.int64)
        for group in np.unique(groups):
            bins = np.flatnonzero(self._of_bin == group)
            cumulative = np.cumsum(weights[bins] / weights[bins].sum())
            mine = groups == group
            at = np.searchsorted(cumulative, numbers[mine], side="right")
            pick[mine] = bins[np.minimum(at, len(bins) - 1)]
        return pick

    def weights(self) -> np.ndarray:
        """Unnormalised weight of each bin: frames times failure rates of clip and moment."""
        if not self._weighted:
            return self._amount
        clip = _bounded(self.clip_failure)
        return self._amount * clip[self._clip_of_bin] * _bounded(self.bin_failure)

    def record(
        self, clips: np.ndarray, first: np.ndarray, length: np.ndarray, fell: np.ndarray
    ) -> None:
        """Update from ended episodes: clip, first frame in it, frames played, whether it fell."""
        if not self._weighted or len(clips) == 0:
            return
        if self.log is not None:
            self.log.append((clips, first, length, fell))
        soon = fell & (length <= HORIZON_FRAMES)
        bins = self._first_bin[clips] + np.minimum(first, self._starts_in_clip[clips] - 1) // (
            BIN_FRAMES
        )
        for clip, bin_, fall, fall_soon in zip(clips, bins, fell, soon, strict=True):
            self.clip_failure[clip] += SMOOTHING * (fall - self.clip_failure[clip])
            self.bin_failure[bin_] += SMOOTHING * (fall_soon - self.bin_failure[bin_])
        self._cumulative = None

    def forget(self) -> None:
        """Reset the failure rates: all clips and moments are equally hard."""
        self.clip_failure[:], self.bin_failure[:] = 0.5, 0.5
        self._cumulative = None

    def get_state(self) -> dict[str, np.ndarray]:
        """Learned failure rates, to resume from."""
        return {"clip_failure": self.clip_failure.copy(), "bin_failure": self.bin_failure.copy()}

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Restore the rates of ``get_state``."""
        self.clip_failure[:] = state["clip_failure"]
        self.bin_failure[:] = state["bin_failure"]
        self._cumulative = None


def _bounded(failure: np.ndarray) -> np.ndarray:
    mean = max(float(failure.mean()), 1e-6)
    return np.clip(failure / mean, *WEIGHT_RANGE)
