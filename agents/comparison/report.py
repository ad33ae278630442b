"""The table of a comparison: its rows and the files they are written to."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from agents.comparison.summary import CURVE_BIN_S, CURVE_OF, Summary
from agents.kinematic.entry import HEADS_ALIGNED, ROOTS_ALIGNED
from questsim.files import whole_file
from questsim.statistics import interval

SCHEMA, SCHEMA_VERSION = "questsim-comparison", 3
WEIGHTINGS = ("equal", "pooled")
COURSE_BINS = round(5.0 / CURVE_BIN_S)
"""Bins of ``Row.course_cm``."""
RECORDING = "recording"
"""Name of the row for the motions themselves."""


@dataclass(frozen=True)
class Costs:
    """What one streamed frame costs, all on one thread; None if not measured.

    Attributes:
        parameters: number of network parameters, including the tracker's.
        ms: milliseconds per frame.
        mmac: millions of multiply-accumulates per frame.
        stream_kib: KiB of state that a stream keeps between frames.
    """

    parameters: int = 0
    ms: float | None = None
    mmac: float | None = None
    stream_kib: float | None = None


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        agent, scenario: names of the agent and of its scenario.
        parameters, ms, mmac, stream_kib: see ``Costs``.
        equal: means of the clips' means; pooled: means over all frames, so long clips weigh more.
        std: standard deviations over all frames.
        clips: number of clips.
        worst, worst_cm: the clip with the greatest mean joint error (MPJPE), and that error.
        low, high: 95 % bootstrap interval of ``pooled`` over clips; none for fewer than 11 clips.
        course_cm: mean MPJPE of each tenth of a second since the start, up to five seconds.
        fewer: ``pooled`` over the clips that other rows are limited to; empty if it has no more.
    """

    agent: str
    scenario: str
    parameters: int
    equal: dict[str, float | None]
    pooled: dict[str, float | None]
    ms: float | None
    mmac: float | None = None
    stream_kib: float | None = None
    std: dict[str, float] = field(default_factory=dict)
    low: dict[str, float] = field(default_factory=dict)
    high: dict[str, float] = field(default_factory=dict)
    clips: int = 0
    worst: str = ""
    worst_cm: float | None = None
    course_cm: list[float] = field(default_factory=list)
    fewer: dict[str, float | None] = field(default_factory=dict)

    def figures(self, weighting: str) -> dict[str, float | None]:
        """The figures under a weighting in ``WEIGHTINGS``."""
        return self.equal if weighting == "equal" else self.pooled


def row_of(
    agent: str,
    scenario: str,
    scored: Sequence[Summary],
    costs: Costs,
    clips: Sequence[str] | None = None,
    fewer: Sequence[Summary] = (),
) -> Row:
    """A row with the means of the clips' sums.

    Args:
        agent, scenario: names of the agent and of its scenario.
        scored: one per clip; a mean uses only clips that have its figure.
        costs: of a frame.
        clips: names of the clips, to name the worst.
        fewer: the summaries of the clips that other rows are limited to, if it has more.
    """
    errors = [summary.mean(CURVE_OF) or 0.0 for summary in scored]
    worst = max(zip(errors, clips or [""], strict=False), default=(0.0, ""))
    row = Row(
        agent, scenario, costs.parameters, {}, {}, costs.ms, costs.mmac, costs.stream_kib,
        clips=len(scored), worst=worst[1], worst_cm=worst[0], course_cm=_course(scored),
        fewer={name: float(total / count) for name, (count, total, _) in _sums(fewer).items()},
    )  # fmt: skip
    for name in dict.fromkeys(name for summary in scored for name in summary.figures):
        sums = np.array([s.figures[name] for s in scored if name in s.figures])
        count, total, squares = sums.T
        means, mean = total / count, total.sum() / count.sum()
        row.equal[name], row.pooled[name] = float(means.mean()), float(mean)
        row.std[name] = float(np.sqrt(max(squares.sum() / count.sum() - mean**2, 0.0)))
        ends = interval(means, count)
        if ends is not None:
            row.low[name], row.high[name] = ends
    return row


def _sums(scored: Sequence[Summary]) -> dict[str, np.ndarray]:
    """Count, sum and sum of squares of each figure over all clips."""
    found: dict[str, np.ndarray] = {}
    for summary in scored:
        for name, sums in summary.figures.items():
            found[name] = found.get(name, np.zeros(3)) + sums
    return found


def _course(scored: Sequence[Summary]) -> list[float]:
    curves = [summary.curve[:COURSE_BINS] for summary in scored if summary.curve]
    if not curves:
        return []
    sums, counts = np.sum(curves, axis=0).T
    return [round(float(a / n), 4) for a, n in zip(sums, counts, strict=True) if n]


LABELS: dict[str, str] = {
    "mpjre_deg": "MPJRE (deg)", "mpjpe_cm": "MPJPE (cm)", "mpjve_cm_s": "MPJVE (cm/s)",
    "jitter_100_m_s3": "jitter (100 m/s³)", "h_pe_cm": "H-PE (cm)", "u_pe_cm": "U-PE (cm)",
    "l_pe_cm": "L-PE (cm)", "r_pe_cm": "R-PE (cm)", "pos_cm": "pos (cm)", "rot_deg": "rot (deg)",
    "rot_local_deg": "rot local (deg)", "root_cm": "root (cm)",
    "vel_cm_s": "vel (cm/s)", "ee_cm": "EE (cm)", "world_cm": "world (cm)",
    "foot_skate_cm_s": "skate (cm/s)", "floating_cm": "floating (cm)",
    "penetration_cm": "penetration (cm)", "root_force_bw": "root force (body weights)",
    "success_percent": "success (%)", "parameters": "parameters", "mmac": "MMAC a frame",
    "stream_kib": "KiB a stream", "ms": "ms a frame",
}  # fmt: skip
"""Labels of figures in tables."""

TABLES: dict[str, tuple[str, ...]] = {
    "Heads moved onto each other (HMD-Poser, LGSIK-Poser)": HEADS_ALIGNED,
    "Roots moved onto each other (SparsePoser, DragPoser)": ROOTS_ALIGNED,
    "Plausibility": (
        "success_percent", "world_cm", "foot_skate_cm_s", "floating_cm", "penetration_cm",
        "root_force_bw",
    ),
}  # fmt: skip
COSTS: tuple[str, ...] = ("parameters", "mmac", "stream_kib", "ms")


def _columns(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(name for row in rows for name in row.pooled))


def table(
    rows: Sequence[Row], names: Sequence[str], weighting: str = "pooled", *, ends: bool = False
) -> str:
    """A Markdown table of some figures.

    Args:
        rows: one line each.
        names: keys of ``LABELS``.
        weighting: ``equal`` or ``pooled``; ``spread`` for the mean over all frames with standard
            deviation and interval.
        ends: add the 95 % intervals of the means over all frames.
    """
    counted = len({row.clips for row in rows}) > 1
    clips = ["clips"] if counted else []
    head = ["agent", "scenario", *clips, *(LABELS[name] for name in names)]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for row in rows:
        figures = {**row.figures(weighting), **{name: getattr(row, name) for name in COSTS}}
        cells = [_cell(figures.get(name)) for name in names]
        if weighting == "spread":
            cells = [_spread(row, name) for name in names]
        elif ends and weighting == "pooled":
            cells = [c + _interval(row, n) for c, n in zip(cells, names, strict=True)]
        clips = [str(row.clips)] if counted else []
        lines.append(f"| {' | '.join([row.agent, row.scenario, *clips, *cells])} |")
    return "\n".join(lines)


def _cell(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:,}" if isinstance(value, int) else f"{value:.2f}"


def _spread(row: Row, name: str) -> str:
    """``mean ± deviation (low to high)``, as far as there are any."""
    text = _cell(row.pooled.get(name))
    if name in row.std:
        text += f" ± {row.std[name]:.2f}"
    return text + _interval(row, name)


def _interval(row: Row, name: str) -> str:
    return f" ({row.low[name]:.2f} to {row.high[name]:.2f})" if name in row.low else ""


def worst_clips(rows: Sequence[Row]) -> str:
    """A Markdown table of the clip with the greatest mean joint error of each row."""
    lines = ["| agent | scenario | clip | MPJPE (cm) |", "|" + "---|" * 4]
    for row in rows:
        if row.worst and row.agent != RECORDING:
            cells = [row.agent, row.scenario, row.worst, _cell(row.worst_cm)]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def tables(rows: Sequence[Row]) -> str:
    """All tables as Markdown: means over all frames, then the same with clips weighted equally."""
    parts = ["95 % intervals over clips are in brackets, if there are more than ten clips.", ""]
    for title, names in TABLES.items():
        parts += [f"## {title}", "", table(rows, names, ends=True), ""]
    parts += ["## Costs", "", table(rows, COSTS), ""]
    parts += ["## Worst clips", "", worst_clips(rows), ""]
    parts += ["# Standard deviations over frames, 95 % intervals over clips", ""]
    for title, names in TABLES.items():
        parts += [f"## {title}, with deviations", "", table(rows, names, "spread"), ""]
    parts += ["# Means of the clips' means (equal-weighted)", ""]
    for title, names in TABLES.items():
        parts += [f"## {title}, clips alike", "", table(rows, names, "equal"), ""]
    return "\n".join(parts)


def write(rows: Sequence[Row], context: dict[str, Any], out: Path) -> None:
    """Write the table as Markdown, CSV and JSON.

    Raises:
        InputError: the folder cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    report = {
        "schema": SCHEMA,
        "version": SCHEMA_VERSION,
        "context": context,
        "rows": [vars(row) for row in rows],
    }
    with whole_file(out / "comparison.json") as path:
        path.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    with whole_file(out / "comparison.csv") as path, path.open("w", newline="") as file:
        names = _columns(rows)
        writer = csv.writer(file)
        writer.writerow(["agent", "scenario", "clips", "weighting", *names, *COSTS])
        for row in rows:
            costs = [getattr(row, name) for name in COSTS]
            for weighting in WEIGHTINGS:
                values = [row.figures(weighting).get(name) for name in names]
                writer.writerow([row.agent, row.scenario, row.clips, weighting, *values, *costs])
    data = context["data"]
    text = (
        f"# Comparison\n\n{data['clips']} clips of `{data['motions']}`, 60 frames a second. Means "
        f"over all frames (length-weighted), but where it says clips.\n\n{tables(rows)}"
    )
    with whole_file(out / "comparison.md") as path:
        path.write_text(text, encoding="utf-8")
