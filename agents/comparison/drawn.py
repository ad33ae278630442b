"""Figures of a comparison that need more than its rows: curves, joints, distributions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from agents.comparison.conditions import condition_of
from agents.comparison.plots import KINDS, kind_of, scenario_text
from agents.comparison.report import RECORDING, Row
from agents.comparison.summary import (
    CURVE_BIN_S,
    CURVE_BINS,
    SPREAD_BIN_CM,
    SPREAD_BINS,
    Summary,
)
from agents.kinematic.scenario import SIX_TRACKERS
from agents.resolve import base_of
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
_WITHOUT = ", no predictor"
"""End of the names of scenarios without temporal predictor."""
_SINCE = "Time since the start of the clip (s)"
SMOOTH_BINS = 3
"""Bins of time over which the error over time is averaged."""


def compared(scored: Sequence[Scored]) -> list[Scored]:
    """One row of each agent: the first one with six trackers, or simply the first; no noise."""
    found: dict[str, Scored] = {}
    for row, clips in scored:
        if row.agent == RECORDING or row.scenario.endswith(", no physics"):
            continue
        if ", noise: " in row.scenario:
            continue
        six = SIX_TRACKERS[0].name
        before = found.get(row.agent)
        if before is None or _scenario(row) == six != _scenario(before[0]):
            found[row.agent] = (row, clips)
    return list(found.values())


def first_starts(rows: Sequence[Row]) -> list[Row]:
    """The rows without noise; where an agent has several starts, only the first one."""
    found: dict[tuple[str, str], Row] = {}
    for row in rows:
        if ", noise: " not in row.scenario:
            found.setdefault((row.agent, _scenario(row)), row)
    return list(found.values())


def _scenario(row: Row) -> str:
    return condition_of(row.scenario)[0]


def _label(row: Row) -> str:
    return f"{Path(row.agent).name}, {scenario_text(row)}"


def _panels(
    figure: Figure, chosen: Sequence[Scored], below: str
) -> Iterator[tuple[Axes, list[_Line]]]:
    """Two panels with one scale: kinematic systems, and everything that is simulated.

    A system with physics has the colour of the system; ``below`` is the label of the x axis.
    """
    first = next(iter(KINDS))
    parts = [[r for r in chosen if (kind_of(r[0]) == first) is plain] for plain in (True, False)]
    names = list(dict.fromkeys(base_of(row.agent) or row.agent for row, _ in chosen))
    axes = figure.subplots(2, 1, sharex=True, sharey=True)
    for axis, title, part in zip(axes, ("Kinematic", "Simulated"), parts, strict=True):
        colours = [names.index(base_of(row.agent) or row.agent) for row, _ in part]
        axis.set_title(title)
        yield axis, [_Line(*each, f"C{c}") for each, c in zip(part, colours, strict=True)]
        if axis.lines:
            axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=7)
    axes[-1].set_xlabel(below)
    axes[-1].set_ylim(bottom=0.0)


class _Line(NamedTuple):
    row: Row
    clips: list[Summary]
    colour: str

    @property
    def style(self) -> dict[str, Any]:
        """Colour, dashes of policies, and label."""
        policy = kind_of(self.row) == "policy"
        return {"color": self.colour, "ls": ":" if policy else "-", "label": _label(self.row)}


def _over_time(clips: Sequence[Summary]) -> tuple[np.ndarray, np.ndarray] | None:
    """Times in s and mean joint errors in cm, over windows of ``SMOOTH_BINS``.

    Windows with less than a third of the clips are left out: there one clip decides.
    """
    curves = [np.array(clip.curve)[: CURVE_BINS - 1] for clip in clips if clip.curve]
    if not curves:
        return None
    window = np.ones(SMOOTH_BINS)
    there = np.sum([curve[:, 1] > 0 for curve in curves], axis=0)
    sums, counts = (np.convolve(a, window, "same") for a in np.sum(curves, axis=0).T)
    enough = 3 * there >= len(curves)
    return (np.flatnonzero(enough) + 0.5) * CURVE_BIN_S, sums[enough] / counts[enough]


def error_over_time(scored: Sequence[Scored], path: Path) -> None:
    """Mean joint error by time since the start of the clip."""
    with figure_file(path, 8.0, 6.5) as figure:
        for axis, lines in _panels(figure, compared(scored), _SINCE):
            for line in lines:
                if (curve := _over_time(line.clips)) is not None:
                    axis.plot(*curve, **line.style)
            axis.set_ylabel("MPJPE (cm)")


def predictor_pairs(scored: Sequence[Scored], fewer: Sequence[int]) -> list[tuple[Scored, Scored]]:
    """Rows without temporal predictor, each with the row of the same scenario with it.

    Args:
        scored: all rows.
        fewer: places, among all clips, of the clips that some rows are limited to. Where one row
            of a pair has all clips and the other only these, both get these.
    """
    rows = {(row.agent, row.scenario): (row, clips) for row, clips in scored}
    pairs = []
    for (agent, scenario), (row, clips) in rows.items():
        if (agent, scenario + _WITHOUT) in rows:
            without, its = rows[agent, scenario + _WITHOUT]
            if len(clips) > len(its):
                clips = [clips[place] for place in fewer]
            pairs.append(((without, its), (row, clips)))
    return pairs


def predictor_over_time(pairs: Sequence[tuple[Scored, Scored]], path: Path) -> None:
    """Mean joint error by time with and without temporal predictor (DragPoser, figure 6)."""
    with figure_file(path, 8.0, 3.5) as figure:
        axis = figure.subplots()
        for number, pair in enumerate(pairs):
            for (row, clips), style in zip(pair, ("--", "-"), strict=True):
                if (curve := _over_time(clips)) is not None:
                    axis.plot(*curve, color=f"C{number}", ls=style, label=_label(row))
        axis.set_xlabel(_SINCE)
        axis.set_ylabel("MPJPE (cm)")
        axis.set_ylim(bottom=0.0)
        axis.legend(fontsize=8)


def error_distribution(scored: Sequence[Scored], path: Path) -> None:
    """Share of frames whose mean joint error is at most a given one."""
    edges = (np.arange(SPREAD_BINS - 1) + 1) * SPREAD_BIN_CM
    below = "MPJPE of a frame, at most (cm)"
    with figure_file(path, 8.0, 6.5) as figure:
        for axis, lines in _panels(figure, compared(scored), below):
            for line in lines:
                counts = np.zeros(SPREAD_BINS)
                for clip in line.clips:
                    for at, count in clip.spread:
                        counts[at] += count
                if counts.sum():
                    axis.plot(edges, 100.0 * counts.cumsum()[:-1] / counts.sum(), **line.style)
            axis.set_ylabel("Frames (%)")
            axis.set_xlim(0.0, 12.0)
            axis.set_ylim(0.0, 100.0)


def skating_and_accuracy(scored: Sequence[Scored], path: Path) -> None:
    """Skating against joint error: a dot for each agent.

    A line leads from each system to the same with physics, which is scored on the avatar's frames.
    """
    with figure_file(path, 8.0, 5.0) as figure:
        axis, places = figure.subplots(), {}
        for row, _ in compared(scored):
            x, y = row.pooled.get("mpjpe_cm"), row.pooled.get("foot_skate_cm_s")
            if x is not None and y is not None:
                places[row.agent] = (x, y, row)
        for x, y, row in places.values():
            kind = kind_of(row)
            axis.scatter(x, y, color=KINDS[kind], zorder=3)
            plain = places.get(base_of(row.agent) or "")
            if plain is not None:
                axis.plot([plain[0], x], [plain[1], y], color="0.8", linewidth=0.8, zorder=1)
        _name_dots(axis, [(x, y, _label(row)) for x, y, row in places.values()])
        axis.set_xlabel("MPJPE (cm)")
        axis.set_ylabel("Foot skate (cm/s)")
        axis.set_xlim(left=0.0)
        axis.set_ylim(bottom=0.0)
        kinds = list(dict.fromkeys(kind_of(row) for _, _, row in places.values()))
        dots = [Line2D([], [], ls="", marker="o", color=KINDS[kind], label=kind) for kind in kinds]
        if dots:
            figure.legend(handles=dots, loc="outside upper right", ncols=len(dots), fontsize=8)


def _name_dots(axis: Axes, dots: Sequence[tuple[float, float, str]]) -> None:
    """Numbers at the dots and their names at the right, so that no names overlap."""
    places = np.array([dot[:2] for dot in dots]).reshape(-1, 2)
    beside = free_corners(places / np.maximum(places.max(axis=0, initial=1e-9), 1e-9))
    lines = []
    for number, ((x, y, name), (right, up)) in enumerate(zip(dots, beside, strict=True), start=1):
        axis.annotate(
            str(number), (x, y), (4 * right, 4 * up), textcoords="offset points", fontsize=7,
            ha="left" if right > 0 else "right", va="bottom" if up > 0 else "top",
        )  # fmt: skip
        lines.append(f"{number:>2}  {name}: {x:.1f} cm, {y:.1f} cm/s")
    axis.annotate("\n".join(lines), (1.02, 1.0), xycoords="axes fraction", va="top", fontsize=7)


def free_corners(places: np.ndarray) -> list[tuple[int, int]]:
    """For each dot, the side on which its number is farthest from other dots and their numbers.

    Args:
        places: ``(N, 2)`` of the dots, as shares of the axes.

    Returns:
        Signs of x and y from each dot; to the right and above it unless another side is freer.
    """
    corners = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)])
    taken, found = list(places), []
    for number, place in enumerate(places):
        others = np.array([*taken[:number], *taken[number + 1 :]]).reshape(-1, 2)
        numbers = place + 0.025 * corners
        room = np.linalg.norm(numbers[:, None] - others, axis=-1).min(axis=1, initial=0.06)
        best = int(room.argmax())
        taken.append(numbers[best])
        found.append((int(corners[best, 0]), int(corners[best, 1])))
    return found


def error_by_joint(scored: Sequence[Scored], path: Path) -> None:
    """Mean error of each joint on a standing body, a body for each agent, one scale for all."""
    found = []
    for row, clips in compared(scored):
        frames = sum(clip.frames for clip in clips)
        if frames:
            sums = np.sum([clip.joints for clip in clips if clip.frames], axis=0)
            found.append((row, sums / frames))
    if not found:
        found = [(Row("nothing", "", 0, {}, {}, None), np.zeros(len(JOINTS)))]
    lines = -(-len(found) // 6)
    columns = -(-len(found) // lines)
    most = max(float(np.percentile(errors, 90)) for _, errors in found) or 1.0
    with figure_file(path, 2.0 * columns + 0.8, 3.4 * lines) as figure:
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
    # Away from the body, so that the number lies on no other joint.
    outwards = 1.0 if places[worst, 0] >= 0 else -1.0
    radius = 0.5 * float(np.sqrt(30 + 25 * errors[worst]))
    axis.annotate(
        f"{errors[worst]:.1f}", places[worst], xytext=(outwards * (radius + 2), -3),
        textcoords="offset points", fontsize=7, ha="left" if outwards > 0 else "right",
    )  # fmt: skip
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


PREDICTOR = "predictor.png"
DRAWN: dict[str, Callable[[Sequence[Scored], Path], None]] = {
    "over_time.png": error_over_time,
    "distribution.png": error_distribution,
    "skating.png": skating_and_accuracy,
    "joints.png": error_by_joint,
}
"""Figures by file name."""
