"""Sums of a clip's samples, from which the rows and figures of a comparison are computed.

A comparison has tens of millions of samples. Their sums are small enough to be stored clip by clip,
and enough for means, standard deviations, intervals and curves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

CURVE_OF = "mpjpe_cm"
"""Figure whose course over time and distribution over frames are stored."""
CURVE_BIN_S, CURVE_BINS = 0.1, 60
"""Bins of the time since the start of a clip; the last one has all later frames, too."""
SPREAD_BIN_CM, SPREAD_BINS = 0.1, 300
"""Bins of the distribution; the last one has all greater errors, too."""
JOINTS_OF = "joint_cm"
"""Name of the samples by joint, ``(F, 22)``."""


@dataclass(frozen=True)
class Summary:
    """Sums of the samples of one clip.

    Attributes:
        figures: count, sum and sum of squares by figure.
        joints: sum of each joint's error in cm over ``frames``.
        frames: number of frames of ``joints``.
        curve: sum and count by time since the start, ``CURVE_BINS`` pairs.
        spread: bin and count of the errors that occur.
    """

    figures: dict[str, list[float]]
    joints: list[float] = field(default_factory=list)
    frames: int = 0
    curve: list[list[float]] = field(default_factory=list)
    spread: list[list[int]] = field(default_factory=list)

    def mean(self, name: str) -> float | None:
        """The clip's mean of a figure; None without samples."""
        count, total, _ = self.figures.get(name, [0, 0.0, 0.0])
        return total / count if count else None

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


def sums_of(samples: Mapping[str, np.ndarray], fps: float) -> Summary:
    """The sums of a clip's samples, as ``pose_metrics.pose_samples`` gives them.

    Args:
        samples: by figure; those of ``JOINTS_OF`` have a column for each joint.
        fps: frames a second of the samples.
    """
    plain = {name: values for name, values in samples.items() if name != JOINTS_OF}
    figures = {
        name: [len(values), float(values.sum()), float((values * values).sum())]
        for name, values in plain.items()
        if len(values)
    }
    joints, error = samples.get(JOINTS_OF), samples.get(CURVE_OF)
    if joints is None or error is None or not len(error):
        return Summary(figures)
    late = np.minimum((np.arange(len(error)) / fps / CURVE_BIN_S).astype(int), CURVE_BINS - 1)
    size = np.minimum((error / SPREAD_BIN_CM).astype(int), SPREAD_BINS - 1)
    sums, counts = (np.bincount(late, w, CURVE_BINS) for w in (error, np.ones(len(error))))
    spread = np.bincount(size, minlength=SPREAD_BINS)
    return Summary(
        figures,
        joints.sum(axis=0).tolist(),
        len(joints),
        np.stack([sums, counts], axis=1).tolist(),
        [[int(i), int(spread[i])] for i in np.flatnonzero(spread)],
    )
