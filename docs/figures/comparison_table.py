"""The tables of a comparison in the pages: ``python -m docs.figures.comparison_table``.

    python -m docs.figures.comparison_table [--write] [scores/comparison.json]

Prints the tables of the kept report beside the shipped weights, or of the named one. ``--write``
replaces those in the pages: between ``<!-- comparison: short -->`` and ``<!-- end -->``; the others
are ``full``, ``gains``, ``noise``, ``starts`` and ``course``.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import get_args

from agents.comparison.conditions import Start, row_name
from agents.comparison.report import (
    COSTS,
    LABELS,
    RECORDING,
    SCHEMA,
    SCHEMA_VERSION,
    TABLES,
    Row,
    table,
)
from agents.kinematic.device_faults import NOISES
from agents.kinematic.scenario import PAPER_NAMES
from agents.resolve import base_of
from agents.shipping.cards import SOURCE
from agents.shipping.model_card import read_report
from questsim.cli import guarded
from questsim.errors import InputError
from questsim.files import whole_file

SHORT_NAMES = ("mpjpe_cm", "h_pe_cm", "pos_cm", "rot_deg", "foot_skate_cm_s", "floating_cm",
               "root_force_bw", "success_percent")  # fmt: skip
SHORT_SCENARIOS = ("60 Hz", "6", "4", "HMD", "HMD+3IMU", "H")
NOT_SHORT = ("lgsik-lengths",)
DOCS = Path(__file__).parents[1]
PAGES = (DOCS / "comparison.md", DOCS / "results.md")
GAIN_NAMES = ("mpjre_deg", "mpjpe_cm", "mpjve_cm_s", "h_pe_cm", "u_pe_cm", "l_pe_cm", "r_pe_cm")
NOISE_NAMES = ("mpjpe_cm", "jitter_100_m_s3", "foot_skate_cm_s", "success_percent")
COURSE_AT = (0, 1, 2, 3, 5, 6, 10, 20, 40)
"""Tenths of a second in the table of the course; 40 frames are 0.67 s."""


def main() -> None:
    """Print or write the tables."""
    words = [word for word in sys.argv[1:] if word != "--write"]
    if len(words) > 1:
        raise InputError("name one comparison.json", fix=(__doc__ or "").splitlines()[2].strip())
    rows = rows_of(Path(words[0]) if words else SOURCE)
    if "--write" not in sys.argv:
        print(full(rows))
        return
    write_pages(rows)


def write_pages(rows: Sequence[Row]) -> None:
    """Put the tables of the rows into the pages."""
    for page in PAGES:
        text = written(page, rows)
        with whole_file(page) as path:
            path.write_text(text, encoding="utf-8")


def rows_of(report: Path) -> list[Row]:
    """The rows of a comparison's report.

    Raises:
        InputError: it is missing, or no report of a comparison of this version.
    """
    found = read_report(report, SCHEMA, SCHEMA_VERSION, "a comparison", "comparison.json")
    return [Row(**row) for row in found["rows"]]


def written(page: Path, rows: Sequence[Row]) -> str:
    """The text of a page with the tables of the rows in their places."""
    made = (short, full, gains, noise, starts, course)
    tables = {make.__name__: make(rows) for make in made}
    text = page.read_text(encoding="utf-8")
    return in_places(text, "comparison", tables.__getitem__)


def in_places(text: str, of: str, table: Callable[[str], str]) -> str:
    """The text with ``table(NAME)`` between each ``<!-- OF: NAME -->`` and ``<!-- end -->``."""
    place = re.compile(rf"(<!-- {of}: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
    return place.sub(lambda m: f"{m[1]}\n{table(m[2])}\n\n{m[3]}", text)


def usual(rows: Sequence[Row]) -> list[Row]:
    """The rows with exact signals, physics from the own estimate."""
    return [
        row for row in rows if ", noise: " not in row.scenario and ", from " not in row.scenario
    ]


def short(rows: Sequence[Row]) -> str:
    """One scenario or two of each agent, and few figures."""
    chosen = [row for row in usual(rows) if row.scenario in SHORT_SCENARIOS]
    return table([row for row in chosen if row.agent not in NOT_SHORT], SHORT_NAMES)


def full(rows: Sequence[Row]) -> str:
    """All rows with usual conditions, and all figures."""
    rows = usual(rows)
    parts = [f"### {title}\n\n{table(rows, names)}" for title, names in TABLES.items()]
    streams = [row for row in rows if row.parameters and base_of(row.agent) is None]
    return "\n\n".join([*parts, f"### Costs\n\n{table(streams, COSTS)}"])


def gains(rows: Sequence[Row]) -> str:
    """Errors by set of sensors, with the change from headset and controllers, without physics."""
    there = {(row.agent, row.scenario): row for row in rows}
    first, *more = PAPER_NAMES.values()
    lines = _table(["agent", "scenario", *(LABELS[name] for name in GAIN_NAMES)])
    for agent in dict.fromkeys(row.agent for row in rows):
        plain = there.get((agent, first))
        found = [there[agent, name] for name in more if (agent, name) in there]
        if plain is None or not found or plain.pooled.get("success_percent") is not None:
            continue
        for row in (plain, *found):
            cells = [_gain(row, plain, name) for name in GAIN_NAMES]
            lines.append(_line([agent, row.scenario, *cells]))
    return "\n".join(lines)


def noise(rows: Sequence[Row]) -> str:
    """Each figure of ``NOISE_NAMES`` by kind of device error, all of the same clips if known."""
    there = {(row.agent, row.scenario): row for row in rows}
    split = [(row.agent, *row.scenario.partition(", noise: ")) for row in rows]
    tried = {(agent, scenario) for agent, scenario, found, _ in split if found}
    chosen = [row for row in usual(rows) if (row.agent, row.scenario) in tried]
    parts = []
    for name in NOISE_NAMES:
        lines = _table(["agent", "scenario", "exact", *NOISES])
        for row in chosen:
            noisy = (there.get((row.agent, row_name(row.scenario, n))) for n in NOISES)
            same = _alike([row, *noisy])
            cells = [_value(each, name) for each in same]
            if any(cell != "-" for cell in cells):
                lines.append(_line([row.agent, row.scenario, *cells]))
        parts.append("\n".join([f"{LABELS[name]}:", "", *lines]))
    return "\n\n".join(parts)


def starts(rows: Sequence[Row]) -> str:
    """Success and joint error of each start of the avatar, all of the same clips if known."""
    kinds: tuple[Start, ...] = get_args(Start)
    there = {(row.agent, row.scenario): row for row in rows}
    names = ("success_percent", "mpjpe_cm")
    head = [f"{LABELS[name]}, {kind}" for name in names for kind in kinds]
    lines = _table(["agent", "scenario", "clips", *head])
    for row in usual(rows):
        same = _alike([there.get((row.agent, row_name(row.scenario, None, k))) for k in kinds])
        if sum(each is not None for each in same) > 1 and row.pooled.get("success_percent"):
            cells = [_value(each, name) for name in names for each in same]
            clips = min(each.clips for each in same if each is not None)
            lines.append(_line([row.agent, row.scenario, str(clips), *cells]))
    return "\n".join(lines)


def _alike(rows: Sequence[Row | None]) -> list[Row | None]:
    """Rows of one line: those of more clips get their means over the clips of the others."""
    least = min(row.clips for row in rows if row is not None)

    def limited(row: Row) -> Row:
        more = row.clips > least and row.fewer
        return replace(row, pooled=row.fewer, clips=least) if more else row

    return [None if row is None else limited(row) for row in rows]


def course(rows: Sequence[Row]) -> str:
    """Mean joint error by time since the start, of kinematic systems with exact signals."""
    lines = _table(["agent", "scenario", *(f"{i / 10:.1f} s" for i in COURSE_AT)])
    for row in usual(rows):
        streams = row.pooled.get("success_percent") is None and base_of(row.agent) is None
        if streams and row.agent != RECORDING and len(row.course_cm) > max(COURSE_AT):
            cells = [f"{row.course_cm[i]:.2f}" for i in COURSE_AT]
            lines.append(_line([row.agent, row.scenario, *cells]))
    return "\n".join(lines)


def _gain(row: Row, plain: Row, name: str) -> str:
    value, before = row.pooled.get(name), plain.pooled.get(name)
    if row is plain or not value or not before:
        return _value(row, name)
    return f"{value:.2f} ({round(100.0 * (value / before - 1.0)):+d} %)"


def _value(row: Row | None, name: str) -> str:
    value = None if row is None else row.pooled.get(name)
    return "-" if value is None else f"{value:.2f}"


def _table(head: Sequence[str]) -> list[str]:
    return [_line(head), "|" + "---|" * len(head)]


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    sys.exit(guarded(main))
