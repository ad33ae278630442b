"""How far figures over clips can be trusted: bootstrap intervals, and paired comparisons."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from questsim.errors import InputError

LEVEL = 0.95
RESAMPLES = 5000
FEWEST = 11
"""An interval of fewer clips says nothing that the clips do not."""
FEWEST_SEEDS = 3
"""Fewest seeds that get an interval."""
PAIRED = ("mpjpe_cm", "mpjre_deg", "root_cm", "sip_deg", "jitter_km_s3", "mhpe_cm")
"""Figures that two evaluations are compared by, beside success."""


def interval(
    values: Sequence[float] | np.ndarray,
    weights: Sequence[float] | np.ndarray | None = None,
    seed: int = 0,
) -> tuple[float, float] | None:
    """95 % interval of a mean over clips: percentile bootstrap (Efron & Tibshirani 1993, ch. 13).

    Clips are drawn with replacement, 5,000 times. They are taken as independent, which
    takes of one performer are only in part.

    Args:
        values: ``(C,)``, one a clip.
        weights: ``(C,)``, as frames of each clip; by default all weigh the same.
        seed: of the draws.

    Returns:
        Lower and upper end, or None for fewer than 11 clips.
    """
    value = np.asarray(values, float)
    if len(value) < FEWEST:
        return None
    weight = np.ones(len(value)) if weights is None else np.asarray(weights, float)

    def mean(v: np.ndarray, w: np.ndarray, axis: int = -1) -> np.ndarray:
        return (v * w).sum(axis) / w.sum(axis)

    if np.ptp(value) == 0:
        return float(value[0]), float(value[0])
    found = stats.bootstrap(
        (value, weight),
        mean,
        n_resamples=RESAMPLES,
        paired=True,
        vectorized=True,
        confidence_level=LEVEL,
        method="percentile",
        rng=np.random.default_rng(seed),
        batch=500,
    ).confidence_interval
    return float(found.low), float(found.high)


@dataclass(frozen=True)
class OverSeeds:
    """The aggregate of one figure over the seeds of a training.

    Attributes:
        mean: interquartile mean: of the middle half of the seeds.
        interval: its 95 % interval, or None for fewer than 3 seeds.
    """

    mean: float
    interval: tuple[float, float] | None


def over_seeds(values: Sequence[float] | np.ndarray, seed: int = 0) -> OverSeeds:
    """Interquartile mean with a bootstrap interval (Agarwal et al. 2021, section 4.3).

    Args:
        values: ``(S,)``, one a seed.
        seed: of the bootstrap.
    """
    value = np.asarray(values, float)
    ends = None
    if len(value) >= FEWEST_SEEDS:
        ends = _bootstrap((value,), _interquartile_mean, seed)
    return OverSeeds(float(_interquartile_mean(value)), ends)


def probability_of_improvement(
    before: Sequence[float] | np.ndarray, after: Sequence[float] | np.ndarray, seed: int = 0
) -> OverSeeds:
    """Probability that a seed of ``after`` is better than one of ``before``; ties count half.

    This is the Mann-Whitney U statistic over the number of pairs, with a bootstrap interval
    (Agarwal et al. 2021, section 4.3).

    Args:
        before, after: ``(S,)`` and ``(T,)``, larger is better.
        seed: of the bootstrap.
    """
    x, y = np.asarray(before, float), np.asarray(after, float)
    ends = None
    if min(len(x), len(y)) >= FEWEST_SEEDS:
        ends = _bootstrap((x, y), _share_better, seed)
    return OverSeeds(float(_share_better(x, y)), ends)


def _interquartile_mean(values: np.ndarray, axis: int = -1) -> np.ndarray:
    return stats.trim_mean(values, 0.25, axis=axis)


def _share_better(x: np.ndarray, y: np.ndarray, axis: int = -1) -> np.ndarray:
    assert axis == -1
    one, other = x[..., :, None], y[..., None, :]
    return ((other > one) + 0.5 * (other == one)).mean(axis=(-2, -1))


def _bootstrap(samples: tuple[np.ndarray, ...], of: Any, seed: int) -> tuple[float, float]:
    found = stats.bootstrap(
        samples,
        of,
        n_resamples=RESAMPLES,
        vectorized=True,
        confidence_level=LEVEL,
        method="percentile",
        rng=np.random.default_rng(seed),
    ).confidence_interval
    return float(found.low), float(found.high)


@dataclass(frozen=True)
class Paired:
    """Two evaluations of the same clips, B against A.

    Attributes:
        clips: names of the clips of both.
        completed: ``(2, C)`` bool of A and B.
        gained, lost: clips that only B, or only A, completed.
        p_success: chance of a split of the changed clips at least as uneven, if both were alike
            (exact McNemar test).
        differences: by figure, B - A: mean over clips that both completed, its interval, and how
            many clips those are.
    """

    clips: tuple[str, ...]
    completed: np.ndarray
    gained: tuple[str, ...]
    lost: tuple[str, ...]
    p_success: float
    differences: dict[str, tuple[float, tuple[float, float] | None, int]]

    @property
    def success(self) -> tuple[float, float]:
        """Share of clips that A and B completed."""
        shares = self.completed.mean(axis=1)
        return float(shares[0]), float(shares[1])

    @property
    def success_interval(self) -> tuple[float, float] | None:
        """Of the difference in success, B - A."""
        return interval(self.completed[1].astype(float) - self.completed[0])


def paired(a: Path, b: Path) -> Paired:
    """Compare two evaluations clip by clip.

    Args:
        a, b: folders that ``evaluate.py --out`` wrote, or their ``clips.csv``.

    Raises:
        InputError: one is no evaluation, or they have no clip in common.
    """
    one, other = read_clips(a), read_clips(b)
    names = [name for name in one if name in other]
    if not names:
        raise InputError(f"has no clip in common with {a}", b, "evaluate both on the same motions")
    done = np.array([[rows[n]["completed"] == "1" for n in names] for rows in (one, other)])
    gained = tuple(n for n, x, y in zip(names, *done, strict=True) if y and not x)
    lost = tuple(n for n, x, y in zip(names, *done, strict=True) if x and not y)
    changed = len(gained) + len(lost)
    p = float(stats.binomtest(len(gained), changed).pvalue) if changed else 1.0
    differences = {}
    for figure in PAIRED:
        both = [
            (float(one[n][figure]), float(other[n][figure]))
            for n, fine in zip(names, np.all(done, axis=0).tolist(), strict=True)
            if fine and one[n].get(figure) and other[n].get(figure)
        ]
        if both:
            change = np.diff(np.array(both), axis=1)[:, 0]
            differences[figure] = float(change.mean()), interval(change), len(change)
    return Paired(tuple(names), done, gained, lost, p, differences)


def read_clips(where: Path) -> dict[str, dict[str, str]]:
    """The rows of an evaluation's ``clips.csv`` by clip.

    Raises:
        InputError: the file is missing, or is not such a report.
    """
    file = where / "clips.csv" if where.is_dir() else where
    fix = "name a folder that evaluate.py --out wrote"
    if not file.is_file():
        raise InputError("has no clips.csv", where, fix)
    try:
        with file.open(encoding="utf-8", newline="") as text:
            rows = list(csv.DictReader(text))
    except (UnicodeDecodeError, csv.Error):
        rows = []
    if not rows or not {"name", "completed", *PAIRED} <= rows[0].keys():
        raise InputError("is not the clip list of an evaluation", file, fix)
    return {row["name"]: row for row in rows}
