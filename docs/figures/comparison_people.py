"""Known against other people: ``python -m docs.figures.comparison_people KNOWN OTHERS``.

    python -m docs.figures.comparison_people agents/weights/comparison.json scores/comparison.json

Both files are reports of ``evaluate.py --compare``. Prints one table of the rows that both have,
and draws their mean joint errors (``docs/images/comparison-people.png``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from matplotlib.axes import Axes

from agents.comparison.plots import scenario_text
from agents.comparison.report import RECORDING, Row
from docs.figures.comparison_table import rows_of
from questsim.cli import guarded
from questsim.errors import InputError
from questsim.plots import figure_file

PICTURE = Path(__file__).parents[1] / "images" / "comparison-people.png"


@dataclass(frozen=True)
class Args:
    """Print and draw the errors of the same agents with known and with other people."""

    known: tyro.conf.Positional[Path]
    """Report on people of the training."""
    others: tyro.conf.Positional[Path]
    """Report on other people."""


def pairs(known: Path, others: Path) -> Iterator[tuple[Row, Row]]:
    """Rows of the same agent and scenario in both reports, without the recording's."""
    first = {(row.agent, row.scenario): row for row in rows_of(known)}
    for row in rows_of(others):
        key = row.agent, row.scenario
        if key in first and row.agent != RECORDING and "no physics" not in row.scenario:
            yield first[key], row


def percent(row: Row) -> str:
    """Success of an avatar with physics; a dash for a kinematic system."""
    success = row.pooled.get("success_percent")
    return "-" if success is None else f"{success:.0f}"


def main() -> None:
    """Print the table and draw the picture.

    Raises:
        InputError: a file is no report of a comparison, or they have no row in common.
    """
    args = tyro.cli(Args)
    both = list(pairs(args.known, args.others))
    if not both:
        raise InputError(f"has no row of {args.known}", args.others, "compare the same agents")
    print(
        "| agent | scenario | MPJPE (cm), known | others | skate (cm/s), known | others |", end=""
    )
    print(" success (%), known | others |\n|" + "---|" * 8)
    for a, b in both:
        cells = [a.agent, a.scenario]
        for key, digits in (("mpjpe_cm", 2), ("foot_skate_cm_s", 1)):
            cells += [f"{row.pooled[key]:.{digits}f}" for row in (a, b)]
        print("| " + " | ".join([*cells, percent(a), percent(b)]) + " |")
    names = [f"{row.agent}, {scenario_text(row)}" for row, _ in both]
    known, others = (np.array([p[k].pooled["mpjpe_cm"] for p in both], float) for k in (0, 1))
    with figure_file(PICTURE, 8.0, 0.3 * len(both) + 1.0) as figure:
        axis = figure.subplots()
        paired_bars(axis, names, {"people of the training": known, "other people": others})
        axis.set_xlabel("MPJPE (cm)")


def paired_bars(axis: Axes, names: Sequence[str], bars: Mapping[str, np.ndarray]) -> np.ndarray:
    """Draw two horizontal bars a name, the first name above; returns the heights of the names.

    Args:
        axis: to draw on.
        names: ``n`` of them.
        bars: two labels, and the ``(n,)`` lengths of their bars.
    """
    place = np.arange(len(names))[::-1]
    for number, (label, lengths) in enumerate(bars.items()):
        axis.barh(place + 0.2 - 0.4 * number, lengths, 0.4, label=label)
    axis.set_yticks(place, names, fontsize=8)
    axis.margins(y=0.01)
    axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return place


if __name__ == "__main__":
    raise SystemExit(guarded(main))
