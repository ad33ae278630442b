"""The result of a sweep: a table on the terminal, sweep.csv of the runs, sweep.json of both."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table

from agents.sweep.runs import FIGURES
from agents.sweep.settings import Setting
from questsim.files import whole_file
from questsim.statistics import OverSeeds, over_seeds, probability_of_improvement

SCHEMA, SCHEMA_VERSION = "questsim-sweep", 1


class Outcome(NamedTuple):
    """A setting with the results of its seeds."""

    setting: Setting
    results: list[dict[str, Any]]

    def of(self, figure: str) -> list[float]:
        """A figure of every seed that trained; for ``score``, 0 of those that failed."""
        figures = [result["figures"] for result in self.results]
        if figure == "score":
            return [float(f["score"]) if f else 0.0 for f in figures]
        return [float(f[figure]) for f in figures if f]

    @property
    def failed(self) -> int:
        """Number of seeds whose training failed."""
        return sum(result["figures"] is None for result in self.results)

    @property
    def score(self) -> OverSeeds:
        """Score over the seeds."""
        return over_seeds(self.of("score"))


def write(out: Path, outcomes: Sequence[Outcome]) -> None:
    """Write sweep.csv and sweep.json into ``out``."""
    with whole_file(out / "sweep.csv") as path, path.open("w", newline="", encoding="utf-8") as f:
        paths = list(outcomes[0].setting.values)
        table = csv.writer(f)
        table.writerow(["setting", "seed", *paths, *FIGURES, "stage", "steps", "failure"])
        for setting, results in outcomes:
            for result in results:
                figures = result["figures"] or {}
                table.writerow(
                    [setting.number, result["seed"], *(setting.values[p] for p in paths)]
                    + [figures.get(name, "") for name in FIGURES]
                    + [result["stage"], result["steps"], result["failure"]]
                )
    settings = [
        {
            "setting": outcome.setting.number,
            "values": outcome.setting.values,
            "seeds": len(outcome.results),
            "failed": outcome.failed,
            "score": asdict(outcome.score),
            "better_than_first": asdict(_better(outcomes[0], outcome)),
        }
        for outcome in outcomes
    ]
    content = {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "settings": settings,
        "runs": [result for outcome in outcomes for result in outcome.results],
    }
    with whole_file(out / "sweep.json") as path:
        path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def show(outcomes: Sequence[Outcome]) -> None:
    """Print the table, best score first."""
    table = Table(title="score: of the best checkpoint on the validation clips, 0 if failed")
    for name in ("setting", "seeds", "failed", "score (IQM)", "95 % interval", "tracked (%)",
                 "link error (cm)", "P(better than 0)", "95 % interval"):  # fmt: skip
        table.add_column(name, justify="left" if name == "setting" else "right")
    for outcome in sorted(outcomes, key=lambda outcome: -outcome.score.mean):
        score, better = outcome.score, _better(outcomes[0], outcome)
        first = outcome.setting.number == outcomes[0].setting.number
        table.add_row(
            f"{outcome.setting.number}: {outcome.setting.label}",
            str(len(outcome.results)),
            str(outcome.failed),
            f"{score.mean:.3f}",
            _ends(score),
            _mean(outcome.of("tracked"), 100.0),
            _mean(outcome.of("link_error_cm"), 1.0),
            "-" if first else f"{better.mean:.2f}",
            "-" if first else _ends(better),
        )
    Console(width=140, highlight=False, markup=False).print(table)


def _better(first: Outcome, other: Outcome) -> OverSeeds:
    return probability_of_improvement(first.of("score"), other.of("score"))


def _mean(values: Sequence[float], factor: float) -> str:
    return f"{factor * sum(values) / len(values):.1f}" if values else "-"


def _ends(found: OverSeeds) -> str:
    return "-" if found.interval is None else "{:.3f} to {:.3f}".format(*found.interval)
