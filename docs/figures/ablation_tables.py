"""The tables of ablations in their page: ``python -m docs.figures.ablation_tables``.

    python -m docs.figures.ablation_tables [--write] [ablations/*/ablations.json]

Prints the tables of the reports that ``ablations.json`` in this folder keeps. Named reports replace
those of the same agents; ``--write`` keeps them, replaces the tables in the page, between
``<!-- ablations: AGENT -->`` (``AGENT-STAGE`` for one stage of a policy) and ``<!-- end -->``, and
draws the picture of performers never seen.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.comparison.ablated import QUESTSIM, TRUE_START, ablated
from agents.comparison.ablation_report import SCHEMA, SCHEMA_VERSION, cell, steps_of
from agents.comparison.ablations import FULL, HELD_OUT
from agents.comparison.report import LABELS
from agents.shipping.model_card import read_report
from docs.figures.comparison_people import paired_bars
from docs.figures.comparison_table import in_places
from questsim.cli import guarded
from questsim.files import whole_file
from questsim.plots import figure_file

HERE = Path(__file__).parent
KEPT = HERE / "ablations.json"
PAGE = HERE.parent / "ablations.md"
PICTURE = HERE.parent / "images" / "unseen-performer.png"
CONTEXT = (
    "preset", "stage", "teacher", "motions", "minutes", "steps", "seed", "seeds", "hold_out", "set",
)  # fmt: skip
POLICY_FIGURES = ("success_percent", "mpjpe_cm", "jitter_100_m_s3", "foot_skate_cm_s")

Report = dict[str, Any]


def main() -> None:
    """Print or write the tables."""
    kept: dict[str, Report] = json.loads(KEPT.read_text("utf-8")) if KEPT.exists() else {}
    for name in (word for word in sys.argv[1:] if word != "--write"):
        found = read_report(Path(name), SCHEMA, SCHEMA_VERSION, "ablations", "ablations.json")
        context = found["context"]
        stage = context.get("stage", "all")
        suffix = "" if stage == "all" else f"-{stage}"
        kept[f"{context['agent']}{suffix}"] = shortened(found)
    if "--write" not in sys.argv:
        print("\n\n".join(f"{agent}\n\n{table_of(report)}" for agent, report in kept.items()))
        return
    with whole_file(KEPT) as path:
        path.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    text = written(PAGE.read_text("utf-8"), kept)
    with whole_file(PAGE) as path:
        path.write_text(text, encoding="utf-8")
    draw(kept)


def shortened(report: Report) -> Report:
    """What is kept of a report: its tables' figures, and how it was made."""
    context = report["context"]
    names = _figures(context["agent"])
    return {
        "agent": context["agent"],
        **{name: context[name] for name in CONTEXT if name in context},
        "test": context["data"]["motions"],
        "clips": context["data"]["clips"],
        "variants": [{n: v[n] for n in ("name", "what", "training")} for v in report["variants"]],
        "rows": [
            {
                "variant": row["variant"],
                "scenario": row["scenario"],
                "clips": row["clips"],
                **{name: row["pooled"].get(name) for name in names},
            }
            for row in report["rows"]
        ],
    }


def _figures(agent: str) -> Sequence[str]:
    """Of a policy ``POLICY_FIGURES``, else the error, MPJPE or pos."""
    if agent == QUESTSIM:
        return POLICY_FIGURES
    return [n for n in ablated(agent).figures if n in ("mpjpe_cm", "pos_cm")][:1]


def written(text: str, kept: Mapping[str, Report]) -> str:
    """The page's text with the tables in their places."""
    return in_places(text, "ablations", lambda agent: described(kept[agent]))


def described(report: Report) -> str:
    """One sentence on how the variants were trained, and the table."""
    budget = (
        f"{report['steps']:,} steps a stage"
        if report["steps"] is not None
        else f"{report['minutes']:g} minutes"
    )
    held = report["hold_out"].replace(",", " and ")
    styles = f"; *unseen* are its clips of the styles {held}" if held else ""
    stage = ""
    if report.get("stage", "all") != "all":
        taught = f", taught by `{report['teacher']}`" if report["teacher"] else ""
        stage = f"Stage `{report['stage']}` alone{taught}. "
    where = f"{report['clips']} clips of `{report['test']}`{styles}"
    return (
        f"{stage}Each trained on `{report['motions']}` for {budget}, scored on {where}.\n\n"
        f"{table_of(report)}"
    )


def table_of(report: Report) -> str:
    """A line for each variant; in brackets what differs from the whole system."""
    names, suffix = _figures(report["agent"]), f"; {report['hold_out']}"
    scenarios = list(dict.fromkeys(row["scenario"] for row in report["rows"]))
    there = {(row["variant"], row["scenario"]): row for row in report["rows"]}
    few = names[:2]  # on unseen clips
    columns = [(n, s) for s in scenarios for n in (few if s.endswith(suffix) else names)]
    head = [
        f"{LABELS[name]}, {s.replace(suffix, ' *unseen*')}".replace(f", {TRUE_START}", "")
        for name, s in columns
    ]
    lines = [f"| variant | {' | '.join(head)} | steps |", "|---" * (len(columns) + 2) + "|"]
    for variant in report["variants"]:
        cells = []
        for name, scenario in columns:
            value = there.get((variant["name"], scenario), {}).get(name)
            whole = there[FULL, scenario][name]
            known = value is None or variant["name"] == FULL
            cells.append(cell(value, None if known else value - whole))
        lines.append(
            f"| `{variant['name']}` | {' | '.join(cells)} | {steps_of(variant['training'])} |"
        )
    return "\n".join(lines)


def unseen(kept: Mapping[str, Report]) -> list[tuple[str, str, str, float, float]]:
    """Agent, scenario, figure, and its values of a known and of an unseen performer.

    A policy that completes less than half of the clips is left out: its errors until a fall say
    nothing.
    """
    found = []
    for agent, report in kept.items():
        rows = {(row["variant"], row["scenario"]): row for row in report["rows"]}
        for (variant, scenario), row in rows.items():
            if variant == HELD_OUT and scenario.endswith(f"; {report['hold_out']}"):
                name = next(n for n in _figures(report["agent"]) if n in ("mpjpe_cm", "pos_cm"))
                whole = rows[FULL, scenario]
                if whole.get("success_percent", 100.0) >= 50.0:
                    found.append((agent, scenario.split(";")[0], name, whole[name], row[name]))
    return found


def draw(kept: Mapping[str, Report]) -> None:
    """The errors of known and of unseen performers as bars."""
    rows = unseen(kept)
    names = [
        f"{agent}, {scenario} ({LABELS[name].split(' (')[0]})"
        for agent, scenario, name, _, _ in rows
    ]
    known, new = (np.array([row[k] for row in rows], float) for k in (3, 4))
    with figure_file(PICTURE, 8.0, 0.42 * len(rows) + 1.0) as figure:
        axis = figure.subplots()
        place = paired_bars(axis, names, {"in the training": known, "never seen": new})
        for at, a, b in zip(place, known, new, strict=True):
            axis.annotate(
                f"{b / a:.1f} x", (b, at - 0.2), (3, 0), va="center", textcoords="offset points"
            )
        axis.set_xlabel("error on the same clips of one performer, cm")
        axis.margins(x=0.1)


if __name__ == "__main__":
    guarded(main)
