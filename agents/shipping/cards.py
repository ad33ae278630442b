"""The figures in the cards of shipped kinematic systems, rewritten from a comparison.

The comparison's report is kept beside the weights, so that a test can hold the cards against it.
"""

from __future__ import annotations

import json
from pathlib import Path

from agents.kinematic.store import CARD_FILE, read_system_card
from agents.resolve import SHIPPED, shipped_systems
from agents.shipping.system_card import comparison_lines
from questsim.files import whole_file

CARD = "README.md"
SOURCE = SHIPPED / "comparison.json"
"""The kept report."""
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

    Args:
        report: ``comparison.json``.
        into: folder of the shipped agents.

    Returns:
        The files that were written: cards, and the kept report.

    Raises:
        InputError: the report is not a comparison of this version.
    """
    content = report.read_text(encoding="utf-8")
    compared = json.loads(content)["context"]["agents"]
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
    with whole_file(into / SOURCE.name) as path:
        path.write_text(content, encoding="utf-8")
    return [*written, into / SOURCE.name]
