"""The tables of a comparison in the pages: ``python -m docs.figures.comparison_table``.

    python -m docs.figures.comparison_table [--write] [scores/comparison.json]

Prints the tables of the kept report beside the shipped weights, or of the named one. ``--write``
replaces those in the pages: between ``<!-- comparison: short -->``, or ``full``, and
``<!-- end -->``.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from agents.comparison.report import COSTS, TABLES, Row, table
from agents.resolve import base_of
from agents.shipping.cards import SOURCE
from questsim.cli import guarded
from questsim.errors import InputError
from questsim.files import whole_file

SHORT_NAMES = ("mpjpe_cm", "h_pe_cm", "pos_cm", "rot_deg", "foot_skate_cm_s", "floating_cm",
               "root_force_bw", "success_percent")  # fmt: skip
SHORT_SCENARIOS = ("60 Hz", "6", "4", "HMD", "HMD+3IMU", "H")
NOT_SHORT = ("lgsik-lengths", "questsim-now")
DOCS = Path(__file__).parents[1]
PAGES = (DOCS / "comparison.md", DOCS / "results.md")
_PLACE = re.compile(r"(<!-- comparison: (short|full) -->\n).*?(<!-- end -->)", re.DOTALL)


def main() -> None:
    """Print or write the tables."""
    words = [word for word in sys.argv[1:] if word != "--write"]
    if len(words) > 1:
        raise InputError("name one comparison.json", fix=(__doc__ or "").splitlines()[2].strip())
    rows = rows_of(Path(words[0]) if words else SOURCE)
    if "--write" not in sys.argv:
        print(full(rows))
        return
    for page in PAGES:
        text = written(page, rows)
        with whole_file(page) as path:
            path.write_text(text, encoding="utf-8")


def rows_of(report: Path) -> list[Row]:
    """The rows of a comparison's report."""
    return [Row(**row) for row in json.loads(report.read_text(encoding="utf-8"))["rows"]]


def written(page: Path, rows: Sequence[Row]) -> str:
    """The text of a page with the tables of the rows in their places."""
    tables = {"short": short(rows), "full": full(rows)}
    text = page.read_text(encoding="utf-8")
    return _PLACE.sub(lambda m: f"{m[1]}\n{tables[m[2]]}\n\n{m[3]}", text)


def short(rows: Sequence[Row]) -> str:
    """One scenario or two of each agent, and few figures."""
    chosen = [row for row in rows if row.scenario in SHORT_SCENARIOS]
    return table([row for row in chosen if row.agent not in NOT_SHORT], SHORT_NAMES)


def full(rows: Sequence[Row]) -> str:
    """All rows and figures."""
    parts = [f"### {title}\n\n{table(rows, names)}" for title, names in TABLES.items()]
    streams = [row for row in rows if row.parameters and base_of(row.agent) is None]
    return "\n\n".join([*parts, f"### Costs\n\n{table(streams, COSTS)}"])


if __name__ == "__main__":
    sys.exit(guarded(main))
