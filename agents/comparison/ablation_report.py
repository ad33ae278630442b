"""The table of an ablation: the full system, then each variant with its changes."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from agents.comparison.ablated import ablated
from agents.comparison.report import COSTS, Row
from questsim.files import whole_file

SCHEMA, SCHEMA_VERSION = "questsim-ablations", 1
FILES: tuple[str, ...] = ("ablations.json", "ablations.csv", "ablations.md")
"""What is written."""

WEIGHTINGS = ("pooled", "equal")

Figures = dict[str, float | None]


@dataclass(frozen=True)
class Result:
    """The full system, or a variant.

    Attributes:
        name, what: name and description of the variant.
        set, options: its changes: values of the preset, options at run time.
        training: by stage, ``steps`` and ``minutes``; the full system's for a variant that differs
            only at run time.
        rows: one per scenario.
        args: changed options of the training.
    """

    name: str
    what: str
    set: tuple[str, ...]
    options: dict[str, Any]
    training: dict[str, dict[str, float]]
    rows: Sequence[Row]
    args: dict[str, Any] = field(default_factory=dict)


def differences(row: Row, full: Row, weighting: str) -> Figures:
    """Each figure of a row minus the full system's, if both have it."""
    got, whole = row.figures(weighting), full.figures(weighting)
    apart: Figures = {}
    for name, value in got.items():
        reference = whole.get(name)
        apart[name] = None if value is None or reference is None else value - reference
    return apart


def _by_scenario(results: Sequence[Result]) -> Iterator[tuple[str, list[tuple[Result, Row]]]]:
    """For each scenario, the full system and then every variant that was run in it."""
    for full in results[0].rows:
        pairs = [(result, row) for result in results for row in result.rows]
        yield full.scenario, [pair for pair in pairs if pair[1].scenario == full.scenario]


def table(results: Sequence[Result], agent: str, weighting: str) -> str:
    """One Markdown table per scenario; differences from the full system are in brackets."""
    names = ablated(agent).figures
    lines = []
    for scenario, pairs in _by_scenario(results):
        head = [scenario, *names, "parameters", "steps"]
        lines += [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
        full = pairs[0][1]
        for result, row in pairs:
            apart = differences(row, full, weighting)
            cells = [
                cell(row.figures(weighting).get(name), None if row is full else apart.get(name))
                for name in names
            ]
            line = [result.name, *cells, f"{row.parameters:,}", steps_of(result.training)]
            lines.append(f"| {' | '.join(line)} |")
        lines.append("")
    return "\n".join(lines[:-1])


def steps_of(training: Mapping[str, Mapping[str, float]]) -> str:
    """The steps of each stage of a ``Result.training``."""
    return " + ".join(f"{stage['steps']:,}" for stage in training.values())


def cell(value: float | None, apart: float | None) -> str:
    """A figure, with its difference from the full system in brackets unless it is None."""
    if value is None:
        return "-"
    return f"{value:.2f}" + ("" if apart is None else f" ({apart:+.2f})")


def write(results: Sequence[Result], context: dict[str, Any], out: Path) -> None:
    """Write ``FILES``.

    Args:
        results: the full system first.
        context: ``agent``, ``preset``, ``motions``, ``minutes``, ``steps``, ``data`` and further
            entries to record.
        out: an existing folder.

    Raises:
        InputError: the folder cannot be written.
    """
    with whole_file(out / "ablations.json") as path:
        report = {
            "schema": SCHEMA,
            "version": SCHEMA_VERSION,
            "context": context,
            "variants": [_variant(result) for result in results],
            "rows": list(_rows(results)),
        }
        path.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    with whole_file(out / "ablations.csv") as path, path.open("w", newline="") as file:
        _write_csv(results, csv.writer(file))
    with whole_file(out / "ablations.md") as path:
        path.write_text(_page(results, context), encoding="utf-8")


def _variant(result: Result) -> dict[str, Any]:
    return {key: value for key, value in vars(result).items() if key != "rows"}


def _rows(results: Sequence[Result]) -> Iterator[dict[str, Any]]:
    for _, pairs in _by_scenario(results):
        full = pairs[0][1]
        for _, row in pairs:
            apart = {weighting: differences(row, full, weighting) for weighting in WEIGHTINGS}
            fields = {key: value for key, value in vars(row).items() if key != "agent"}
            yield {"variant": row.agent, **fields, "differences": apart}


def _write_csv(results: Sequence[Result], writer: Any) -> None:
    names = list(dict.fromkeys(n for result in results for row in result.rows for n in row.pooled))
    apart_names = [f"{name}_difference" for name in names]
    writer.writerow(["variant", "scenario", "weighting", *names, *apart_names, *COSTS])
    for scenario, pairs in _by_scenario(results):
        for _, row in pairs:
            for weighting in WEIGHTINGS:
                got = row.figures(weighting)
                apart = differences(row, pairs[0][1], weighting)
                cells = [*(got.get(n) for n in names), *(apart.get(n) for n in names)]
                cells += [getattr(row, cost) for cost in COSTS]
                writer.writerow([row.agent, scenario, weighting, *cells])


def _page(results: Sequence[Result], context: dict[str, Any]) -> str:
    data = context["data"]
    limits = [
        f"{context['minutes']:g} minutes" if context["minutes"] is not None else "",
        f"{context['steps']:,} steps a stage" if context["steps"] is not None else "",
    ]
    budget = ", at most ".join(limit for limit in limits if limit)
    lines = [
        f"# Ablations of {context['agent']}",
        "",
        f"Preset `{context['preset']}`, seed {context['seed']}. Each was trained on "
        f"`{context['motions']}` for {budget}; scored on {data['clips']} clips of "
        f"`{data['motions']}`, streamed, all frames alike. In brackets: what differs from the "
        "full system.",
        "",
    ]
    if context["seeds"] > 1:
        lines += [
            "Rows `seed-` are the same training with another seed: a difference no larger than "
            "theirs shows nothing.",
            "",
        ]
    for result in results[1:]:
        how = [f"`--{name.replace('_', '-')} {value}`" for name, value in result.args.items()]
        how += [f"`--set {value}`" for value in result.set]
        options = [f"`{name}={value}`" for name, value in result.options.items()]
        how += [f"{option} at run time, the full system's weights" for option in options]
        lines.append(f"- `{result.name}`: {result.what}; {', '.join(how)}")
    if len(results) > 1:
        lines.append("")
    return "\n".join([*lines, table(results, context["agent"], "pooled")]) + "\n"
