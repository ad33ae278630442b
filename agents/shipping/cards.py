"""The figures in the cards of shipped kinematic systems, rewritten from a comparison.

The comparison's report is kept beside the weights, so that a test can hold the cards against it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from agents.kinematic.store import CARD_FILE, read_system_card
from agents.resolve import SHIPPED, shipped_systems
from agents.shipping.system_card import comparison_lines
from questsim.errors import InputError
from questsim.files import whole_file

CARD = "README.md"
SOURCE = SHIPPED / "comparison.json"
"""The kept report."""
ALIKE = ("data", "seed", "fewer_clips", "fewer_rows", "tracker")
"""What two reports must have in common for rows of both to stand in one table."""
_BEGINS, _ENDS = "## Figures\n", "## Intended use\n"


def figures_text(report: Path, folder: Path) -> str:
    """The figures of the system in ``folder`` from a report, as in its card.

    Raises:
        InputError: the report is not a comparison of this version, or has no row of the system.
    """
    training = read_system_card(folder)["training"]
    return "".join(f"{line}\n" for line in comparison_lines(report, training))


def rewrite_cards(report: Path, into: Path = SHIPPED) -> list[Path]:
    """Replace the figures of every shipped system that a comparison has rows of.

    A comparison of some agents replaces only their rows in the kept report.

    Args:
        report: ``comparison.json``.
        into: folder of the shipped agents.

    Returns:
        The files that were written: cards, and the kept report.

    Raises:
        InputError: the report is not a comparison of this version, or has other clips than the
            kept report and not all of its agents.
    """
    fresh, kept = json.loads(report.read_text(encoding="utf-8")), into / SOURCE.name
    compared = fresh["context"]["agents"]
    if kept.exists():
        fresh = merged(fresh, json.loads(kept.read_text(encoding="utf-8")), report)
    written = []
    for name in shipped_systems():
        folder = into / name
        if name not in compared or not (folder / CARD_FILE).exists():
            continue
        figures = figures_text(report, folder)
        card = folder / CARD
        text = card.read_text(encoding="utf-8")
        end = text.index(_ENDS)
        begin = text.find(_BEGINS)
        begin = end if begin < 0 else begin
        with whole_file(card) as path:
            new = f"{text[:begin]}{_BEGINS}\n{figures}{text[end:]}"
            path.write_text(new, encoding="utf-8")
        written.append(card)
    with whole_file(kept) as path:
        path.write_text(json.dumps(fresh, indent=1) + "\n", encoding="utf-8")
    return [*written, kept]


def merged(fresh: dict[str, Any], kept: dict[str, Any], report: Path = SOURCE) -> dict[str, Any]:
    """The kept report with the rows that a fresh one has of some of its agents.

    A row without times gets those of the kept row, if that has a network of the same size.

    Args:
        fresh: a report; if it lacks no agent of the kept one it is returned as it is.
        kept: the report of all agents.
        report: file of the fresh one, for the message.

    Raises:
        InputError: the fresh report lacks agents, and is of other clips, seed or tracker.
    """
    new, old = fresh["context"], kept["context"]
    missing = [name for name in old["agents"] if name not in new["agents"]]
    if not missing:
        return fresh
    differ = [key for key in ALIKE if new.get(key) != old.get(key)]
    if (fresh["schema"], fresh["version"]) != (kept["schema"], kept["version"]):
        differ.append("version")
    if differ:
        raise InputError(
            f"differs from the kept report in {', '.join(differ)}, and lacks {', '.join(missing)}",
            report,
            "compare all agents, or the same clips",
        )
    timed = {(row["agent"], row["scenario"], row["parameters"]): row["ms"] for row in kept["rows"]}
    order = dict.fromkeys(row["agent"] for row in (*kept["rows"], *fresh["rows"]))
    rows = [row for row in kept["rows"] if row["agent"] not in new["agents"]]
    for row in fresh["rows"]:
        if row["agent"] in new["agents"]:
            # Networks of the same size take the same time, whatever their weights.
            before = timed.get((row["agent"], row["scenario"], row["parameters"]))
            rows.append(row | {"ms": before if row["ms"] is None else row["ms"]})
    made_with = old.get("made_with", {}) | dict.fromkeys(new["agents"], new["versions"])
    context = old | {"agents": old["agents"] | new["agents"], "made_with": made_with}
    in_order = [row for name in order for row in rows if row["agent"] == name]
    return kept | {"context": context, "rows": in_order}
