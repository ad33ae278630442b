"""The two plots of a comparison: accuracy and physical plausibility of its rows."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.patches import Patch

from agents.comparison.report import RECORDING, Row
from agents.resolve import base_of
from questsim.plots import BLUE, GREEN, GREY, ORANGE, figure_file

KINDS: dict[str, str] = {"kinematic": GREY, "with physics behind it": ORANGE, "policy": BLUE}
"""Colours by kind of row."""

Pair = tuple[str, tuple[tuple[str, str, str], ...]]
_ACCURACY: tuple[Pair, ...] = (
    ("All joints (cm)", (("mpjpe_cm", "MPJPE", BLUE), ("pos_cm", "pos", GREEN))),
    ("Hands and ends (cm)", (("h_pe_cm", "H-PE", BLUE), ("ee_cm", "EE", GREEN))),
)
_PLAUSIBILITY: tuple[tuple[str, str], ...] = (
    ("foot_skate_cm_s", "Foot skate (cm/s)"),
    ("floating_cm", "Floating (cm)"),
    ("penetration_cm", "Floor penetration (cm)"),
    ("root_force_bw", "Root force (body weights)"),
)
_LONGEST_NAME = 26


def kind_of(row: Row) -> str:
    """The kind of a row, one of ``KINDS``; only simulated rows have a success figure."""
    if row.pooled.get("success_percent") is None:
        return "kinematic"
    return "with physics behind it" if base_of(row.agent) is not None else "policy"


def scenario_text(row: Row) -> str:
    """Its scenario for figures, where a bare number does not say that it counts trackers."""
    return re.sub(r"^(\d+)(?=,|$)", r"\1 trackers", row.scenario)


def plot_accuracy(rows: Sequence[Row], path: Path) -> None:
    """Errors of all joints and of hands and ends over all frames, a pair of bars per row."""
    rows = [row for row in rows if row.agent != RECORDING]
    with figure_file(path, 9.0, 0.42 * len(rows) + 1.2) as figure:
        axes = figure.subplots(1, 2, sharey=True)
        for axis, (label, bars) in zip(axes, _ACCURACY, strict=True):
            for i, (name, _, colour) in enumerate(bars):
                at = [y + 0.38 * i - 0.19 for y in range(len(rows))]
                _bars(axis, at, [row.pooled.get(name) for row in rows], [colour] * len(rows), 0.36)
            axis.set_xlabel(label)
            handles = [Patch(color=colour, label=name) for _, name, colour in bars]
            axis.legend(
                handles=handles,
                loc="lower left",
                bbox_to_anchor=(0.0, 1.0),
                ncols=2,
                borderaxespad=0.2,
            )
        _label(axes[0], rows)


def plot_plausibility(rows: Sequence[Row], path: Path) -> None:
    """Skating, floating, penetration and root force; the colour shows the kind of row."""
    with figure_file(path, 11.0, 0.3 * len(rows) + 1.3) as figure:
        axes = figure.subplots(1, len(_PLAUSIBILITY), sharey=True)
        kinds = [kind_of(row) for row in rows]
        colours = [KINDS[kind] for kind in kinds]
        for axis, (name, label) in zip(axes, _PLAUSIBILITY, strict=True):
            values = [row.pooled.get(name) for row in rows]
            _bars(axis, [float(y) for y in range(len(rows))], values, colours, 0.65)
            axis.set_xlabel(label)
        _label(axes[0], rows)
        patches = [Patch(color=c, label=kind) for kind, c in KINDS.items() if kind in kinds]
        figure.legend(handles=patches, loc="outside upper right", ncols=len(patches))


def _bars(
    axis: Axes,
    at: Sequence[float],
    values: Sequence[float | None],
    colours: Sequence[str],
    height: float,
) -> None:
    """Bars labelled with their values; a dash for a missing value."""
    lengths = [value or 0.0 for value in values]
    bars = axis.barh(at, lengths, color=colours, height=height)
    texts = ["-" if value is None else f"{value:.2f}" for value in values]
    axis.bar_label(bars, texts, padding=3, fontsize=7)
    # Keep the widest limit so far: the axes are drawn on repeatedly, and labels need space.
    axis.set_xlim(0.0, max(1.18 * max(lengths, default=0.0), axis.dataLim.x1 * 1.18, 0.1))


def _label(axis: Axes, rows: Sequence[Row]) -> None:
    names = [row.agent for row in rows]
    short = [n if len(n) <= _LONGEST_NAME else "..." + n[3 - _LONGEST_NAME :] for n in names]
    labels = [f"{name}: {scenario_text(row)}" for name, row in zip(short, rows, strict=True)]
    axis.set_yticks(range(len(rows)), labels)
    axis.set_ylim(len(rows) - 0.4, -0.6)
    for each in axis.get_figure(root=True).axes:  # type: ignore[union-attr]
        each.grid(axis="y", visible=False)
        each.tick_params(axis="y", length=0)
