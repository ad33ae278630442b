"""The figures in the cards of shipped kinematic systems, written anew from a comparison."""

from __future__ import annotations

import json
from pathlib import Path

from agents.kinematic.store import CARD_FILE, read_system_card
from agents.resolve import SHIPPED, shipped_systems
from agents.shipping.system_card import comparison_lines
from questsim.files import whole_file

CARD = "README.md"
_BEGINS, _ENDS = "## Figures\n", "## Intended use\n"


def rewrite_cards(report: Path, into: Path | None = None) -> list[Path]:
    """Replace the figures of every shipped system that a comparison has rows of.

    Args:
        report: ``comparison.json``.
        into: folder of the shipped agents.

    Returns:
        The cards that were written.

    Raises:
        InputError: the report is not a comparison of this version.
    """
    into = into or SHIPPED
    compared = json.loads(report.read_text(encoding="utf-8"))["context"]["agents"]
    written = []
    for name in shipped_systems():
        folder = into / name
        if name not in compared or not (folder / CARD_FILE).exists():
            continue
        training = read_system_card(folder)["training"]
        lines = [_BEGINS, *[f"{line}\n" for line in comparison_lines(report, training)]]
        card = folder / CARD
        text = card.read_text(encoding="utf-8")
        begin, end = text.find(_BEGINS), text.index(_ENDS)
        begin = end if begin < 0 else begin
        with whole_file(card) as path:
            path.write_text(text[:begin] + lines[0] + "\n" + "".join(lines[1:]) + text[end:],
                            encoding="utf-8")  # fmt: skip
        written.append(card)
    return written
