"""The table of a comparison: its rows, and how they are written."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from questsim.files import whole_file

SCHEMA, SCHEMA_VERSION = "questsim-comparison", 1
RECORDING = "recording"
"""What the row of the motions themselves is called."""


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        agent, scenario: what was run in which.
        parameters: of the networks, the tracker's among them.
        equal: means of the clips' means; pooled: means over all frames, long clips weigh more.
        ms: milliseconds a frame, streamed; None where not measured.
        mmac: millions of multiply-accumulates a frame, streamed; None where not counted.
        stream_kib: KiB that a stream keeps from frame to frame; None where not counted.
    """

    agent: str
    scenario: str
    parameters: int
    equal: dict[str, float | None]
    pooled: dict[str, float | None]
    ms: float | None
    mmac: float | None = None
    stream_kib: float | None = None


def row_of(
    agent: str, scenario: str, count: int, scored: Sequence[dict[str, np.ndarray]], ms: float | None
) -> Row:
    """A line of the means of samples.

    Args:
        agent, scenario: what was run in which.
        count: parameters.
        scored: one dictionary of samples a clip; a name that some lack counts where it is.
        ms: milliseconds a frame.
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


_Getter = Callable[[Row], dict[str, float | None]]
_WEIGHTS: dict[str, _Getter] = {"equal": lambda row: row.equal, "pooled": lambda row: row.pooled}


def _columns(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(name for row in rows for name in row.pooled))


def table(rows: Sequence[Row], weighting: str) -> str:
    """A Markdown table; ``weighting`` is ``equal`` or ``pooled``."""
    names = _columns(rows)
    head = ["agent", "scenario", *names, "parameters", "MMAC a frame", "KiB a stream", "ms a frame"]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for row in rows:
        figures = [_WEIGHTS[weighting](row).get(name) for name in names]
        cells = ["-" if value is None else f"{value:.2f}" for value in figures]
        costs = ["-" if x is None else f"{x:.2f}" for x in (row.mmac, row.stream_kib, row.ms)]
        told = [row.agent, row.scenario, *cells, f"{row.parameters:,}", *costs]
        lines.append(f"| {' | '.join(told)} |")
    return "\n".join(lines)


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
        costs = ["parameters", "mmac", "stream_kib", "ms"]
        writer.writerow(["agent", "scenario", "weighting", *names, *costs])
        for row in rows:
            told = [getattr(row, name) for name in costs]
            for weighting, figures in _WEIGHTS.items():
                values = [figures(row).get(name) for name in names]
                writer.writerow([row.agent, row.scenario, weighting, *values, *told])
    parts = [
        "# Comparison of kinematic systems",
        "",
        f"{context['data']['clips']} clips of `{context['data']['motions']}`, 60 frames a second.",
        "",
        "## All frames alike (length-weighted)",
        "",
        table(rows, "pooled"),
        "",
        "## All clips alike (equal-weighted)",
        "",
        table(rows, "equal"),
    ]
    with whole_file(out / "comparison.md") as path:
        path.write_text("\n".join(parts) + "\n", encoding="utf-8")
