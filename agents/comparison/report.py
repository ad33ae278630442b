"""The table of a comparison: its rows and the files they are written to."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agents.kinematic.entry import HEADS_ALIGNED, ROOTS_ALIGNED
from questsim.files import whole_file

SCHEMA, SCHEMA_VERSION = "questsim-comparison", 1
WEIGHTINGS = ("equal", "pooled")
RECORDING = "recording"
"""Name of the row for the motions themselves."""


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        agent, scenario: names of the agent and of its scenario.
        parameters: number of network parameters, including the tracker's.
        equal: means of the clips' means; pooled: means over all frames, so long clips weigh more.
        ms: milliseconds per streamed frame; None if not measured.
        mmac: millions of multiply-accumulates per streamed frame; None if not counted.
        stream_kib: KiB of state that a stream keeps between frames; None if not counted.
    """

    agent: str
    scenario: str
    parameters: int
    equal: dict[str, float | None]
    pooled: dict[str, float | None]
    ms: float | None
    mmac: float | None = None
    stream_kib: float | None = None

    def figures(self, weighting: str) -> dict[str, float | None]:
        """The figures under a weighting in ``WEIGHTINGS``."""
        return self.pooled if weighting == "pooled" else self.equal


def row_of(
    agent: str, scenario: str, count: int, scored: Sequence[dict[str, np.ndarray]], ms: float | None
) -> Row:
    """A row with the means of the samples.

    Args:
        agent, scenario: names of the agent and of its scenario.
        count: number of parameters.
        scored: one dictionary of samples per clip; a mean uses only clips that have its name.
        ms: milliseconds per frame.
    """
    names = list(dict.fromkeys(name for samples in scored for name in samples))

    def of(name: str) -> list[np.ndarray]:
        return [samples[name] for samples in scored if len(samples.get(name, ()))]

    return Row(
        agent=agent,
        scenario=scenario,
        parameters=count,
        equal={name: _mean(np.array([part.mean() for part in of(name)])) for name in names},
        pooled={name: _mean(np.concatenate(of(name) or [np.zeros(0)])) for name in names},
        ms=ms,
    )


def _mean(values: np.ndarray) -> float | None:
    return float(values.mean()) if len(values) else None


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


def table(rows: Sequence[Row], names: Sequence[str], weighting: str = "pooled") -> str:
    """A Markdown table of some figures.

    Args:
        rows: one line each.
        names: keys of ``LABELS``.
        weighting: ``equal`` or ``pooled``.
    """
    head = ["agent", "scenario", *(LABELS[name] for name in names)]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for row in rows:
        figures = {**row.figures(weighting), **{name: getattr(row, name) for name in COSTS}}
        cells = [_cell(figures.get(name)) for name in names]
        lines.append(f"| {' | '.join([row.agent, row.scenario, *cells])} |")
    return "\n".join(lines)


def _cell(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:,}" if isinstance(value, int) else f"{value:.2f}"


def tables(rows: Sequence[Row]) -> str:
    """All tables as Markdown: means over all frames, then the same with clips weighted equally."""
    parts = []
    for title, names in TABLES.items():
        parts += [f"## {title}", "", table(rows, names), ""]
    parts += ["## Costs", "", table(rows, COSTS), ""]
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
        writer.writerow(["agent", "scenario", "weighting", *names, *COSTS])
        for row in rows:
            told = [getattr(row, name) for name in COSTS]
            for weighting in WEIGHTINGS:
                values = [row.figures(weighting).get(name) for name in names]
                writer.writerow([row.agent, row.scenario, weighting, *values, *told])
    data = context["data"]
    text = (
        f"# Comparison\n\n{data['clips']} clips of `{data['motions']}`, 60 frames a second. Means "
        f"over all frames (length-weighted), but where it says clips.\n\n{tables(rows)}"
    )
    with whole_file(out / "comparison.md") as path:
        path.write_text(text, encoding="utf-8")
