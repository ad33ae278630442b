"""Figures of a comparison that need more than its rows: curves, joints, distributions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from agents.comparison.plots import KINDS, kind_of
from agents.comparison.report import RECORDING, Row
from agents.comparison.summary import (
    CURVE_BIN_S,
    CURVE_BINS,
    SPREAD_BIN_CM,
    SPREAD_BINS,
    Summary,
)
from questsim.plots import figure_file
from questsim.skeleton import JOINT_PARENTS, JOINTS

Scored = tuple[Row, list[Summary]]
"""A row and the sums of its clips."""

_STANDING: dict[str, tuple[float, float]] = {
    "root": (0.0, 0.95), "spine1": (0.0, 1.06), "spine2": (0.0, 1.18), "spine3": (0.0, 1.30),
    "neck": (0.0, 1.47), "head": (0.0, 1.58), "hip": (0.10, 0.91), "knee": (0.12, 0.49),
    "ankle": (0.13, 0.09), "toe": (0.19, 0.02), "clavicle": (0.05, 1.40), "shoulder": (0.18, 1.40),
    "elbow": (0.33, 1.15), "wrist": (0.44, 0.90),
}  # fmt: skip
"""Where joints are drawn: the left side in metres, seen from the front."""


def _compared(scored: Sequence[Scored]) -> list[Scored]:
    """One row of each agent: its first one, with physics the first one with physics."""
    found: dict[str, Scored] = {}
    for row, clips in scored:
        if row.agent == RECORDING or row.scenario.endswith("no physics"):
            continue
        found.setdefault(row.agent, (row, clips))
    return list(found.values())


_LINES = dict(zip(KINDS, ("-", "--", ":"), strict=True))
"""Line styles by kind of row."""


def _label(row: Row) -> str:
    return f"{Path(row.agent).name}, {row.scenario}"


def error_over_time(scored: Sequence[Scored], path: Path) -> None:
    """Mean joint error by time since the start of the clip."""
    with figure_file(path, 8.0, 4.5) as figure:
        axis = figure.subplots()
        for row, clips in _compared(scored):
            curves = [clip.curve for clip in clips if clip.curve]
            if not curves:
                continue
            sums, counts = np.sum(curves, axis=0)[: CURVE_BINS - 1].T
            with np.errstate(invalid="ignore"):
                times, style = np.arange(len(sums)) * CURVE_BIN_S, _LINES[kind_of(row)]
                axis.plot(times, sums / counts, style, label=_label(row))
        axis.set_xlabel("Time since the start of the clip (s)")
        axis.set_ylabel("MPJPE (cm)")
        axis.set_ylim(bottom=0.0)
        figure.legend(loc="outside right upper", fontsize=7)


def error_distribution(scored: Sequence[Scored], path: Path) -> None:
    """Share of frames whose mean joint error is at most a given one."""
    with figure_file(path, 8.0, 4.5) as figure:
        axis = figure.subplots()
        edges = (np.arange(SPREAD_BINS - 1) + 1) * SPREAD_BIN_CM
        for row, clips in _compared(scored):
            counts = np.zeros(SPREAD_BINS)
            for clip in clips:
                for at, count in clip.spread:
                    counts[at] += count
            if counts.sum():
                share = counts.cumsum()[:-1] / counts.sum()
                axis.plot(edges, 100.0 * share, _LINES[kind_of(row)], label=_label(row))
        axis.set_xlabel("MPJPE of a frame, at most (cm)")
        axis.set_ylabel("Frames (%)")
        axis.set_xlim(0.0, 12.0)
        axis.set_ylim(0.0, 100.0)
        figure.legend(loc="outside right upper", fontsize=7)


def skating_and_accuracy(scored: Sequence[Scored], path: Path) -> None:
    """Skating against joint error: one dot for each agent."""
    with figure_file(path, 7.0, 4.8) as figure:
        axis, seen, found = figure.subplots(), set(), []
        for row, _ in _compared(scored):
            x, y = row.pooled.get("mpjpe_cm"), row.pooled.get("foot_skate_cm_s")
            if x is None or y is None:
                continue
            kind = kind_of(row)
            axis.scatter(x, y, color=KINDS[kind], label=None if kind in seen else kind, zorder=3)
            found.append((y, x, _label(row)))
            seen.add(kind)
        # Labels in a column at the right, in the order of their dots, so that none overlap.
        lowest = -np.inf
        most = max((y for y, _, _ in found), default=1.0)
        right = 1.08 * max((x for _, x, _ in found), default=1.0)
        for y, x, label in sorted(found):
            lowest = max(y, lowest + 0.045 * most)
            axis.annotate(
                label, (x, y), (right, lowest), va="center", fontsize=7, annotation_clip=False,
                arrowprops={"arrowstyle": "-", "color": "0.8", "linewidth": 0.6},
            )  # fmt: skip
        axis.set_xlabel("MPJPE (cm)")
        axis.set_ylabel("Foot skate (cm/s)")
        axis.set_xlim(left=0.0)
        axis.set_ylim(bottom=0.0)
        axis.set_xlim(right=1.45 * right / 1.08)
        if seen:
            figure.legend(loc="outside upper right", ncols=len(seen), fontsize=8)


def error_by_joint(scored: Sequence[Scored], path: Path) -> None:
    """Mean error of each joint on a standing body, a body for each agent, one scale for all."""
    found = []
    for row, clips in _compared(scored):
        frames = sum(clip.frames for clip in clips)
        if frames:
            sums = np.sum([clip.joints for clip in clips if clip.frames], axis=0)
            found.append((row, sums / frames))
    if not found:
        found = [(Row("nothing", "", 0, {}, {}, None), np.zeros(len(JOINTS)))]
    columns = min(len(found), 5)
    lines = -(-len(found) // columns)
    most = max(float(np.percentile(errors, 90)) for _, errors in found) or 1.0
    with figure_file(path, 2.2 * columns + 0.8, 3.4 * lines) as figure:
        axes = figure.subplots(lines, columns, squeeze=False)
        dots = None
        for axis in axes.flat:
            axis.axis("off")
        for axis, (row, errors) in zip(axes.flat, found, strict=False):
            dots = _body(axis, errors, most)
            axis.set_title(_label(row).replace(", ", "\n", 1), fontsize=8)
        if dots is not None:
            figure.colorbar(dots, ax=axes, shrink=0.6, label="Error (cm), heads on each other")


def _body(axis: Axes, errors: np.ndarray, most: float):
    places = np.array([_place(name) for name in JOINTS])
    for joint, parent in enumerate(JOINT_PARENTS):
        axis.plot(*places[[joint, parent]].T, color="0.75", linewidth=2, zorder=1)
    dots = axis.scatter(
        *places.T, c=errors, s=30 + 25 * errors, cmap="plasma", vmin=0.0, vmax=most, zorder=2
    )
    worst = int(errors.argmax())
    axis.annotate(f"{errors[worst]:.1f}", places[worst], xytext=(7, -3),
                  textcoords="offset points", fontsize=7)  # fmt: skip
    axis.set_xlim(-0.65, 0.65)
    axis.set_ylim(-0.1, 1.75)
    axis.set_aspect("equal")
    return dots


def _place(joint: str) -> tuple[float, float]:
    side, _, part = joint.partition("_")
    if not part:
        return _STANDING[joint]
    x, y = _STANDING[part]
    return (x if side == "left" else -x), y


DRAWN: dict[str, Callable[[Sequence[Scored], Path], None]] = {
    "over_time.png": error_over_time,
    "distribution.png": error_distribution,
    "skating.png": skating_and_accuracy,
    "joints.png": error_by_joint,
}
"""Figures by file name."""
