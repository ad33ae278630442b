"""The tables of a comparison as the pages have them: ``python -m docs.figures.comparison_table``.

    python -m docs.figures.comparison_table scores/comparison.json [--short]

``--short`` prints the README's: one scenario or two of each agent, and few figures.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from agents.comparison.report import COSTS, TABLES, Row, table
from agents.resolve import base_of
from questsim.cli import guarded
from questsim.errors import InputError

SHORT_NAMES = ("mpjpe_cm", "h_pe_cm", "pos_cm", "rot_deg", "foot_skate_cm_s", "floating_cm",
               "root_force_bw", "success_percent", "ms")  # fmt: skip
SHORT_SCENARIOS = ("60 Hz", "6", "4", "HMD", "HMD+3IMU", "H")
NOT_SHORT = ("lgsik+physics", "questsim-now")


def main() -> None:
    """Print the tables of the comparison that is named."""
    words = [word for word in sys.argv[1:] if word != "--short"]
    if len(words) != 1:
        raise InputError("name one comparison.json", fix=(__doc__ or "").splitlines()[2].strip())
    report = json.loads(Path(words[0]).read_text(encoding="utf-8"))
    rows = [Row(**row) for row in report["rows"]]
    if "--short" in sys.argv:
        short = [row for row in rows if row.scenario in SHORT_SCENARIOS]
        print(table([row for row in short if row.agent not in NOT_SHORT], SHORT_NAMES))
        return
    for title, names in TABLES.items():
        print(f"### {title}\n\n{table(rows, names)}\n")
    # Of streams: windows have none, and physics is timed for all clips at once.
    streams = [row for row in rows if row.parameters and row.ms is not None]
    streams = [row for row in streams if base_of(row.agent) is None]
    print(f"### Costs\n\n{table(streams, COSTS)}")


if __name__ == "__main__":
    sys.exit(guarded(main))
