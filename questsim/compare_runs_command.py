"""``questsim compare-runs``: which of two evaluations is better, and how sure that is."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from questsim.compare_runs_options import CompareRunsArgs
from questsim.evaluation_report import LABELS
from questsim.statistics import Paired, paired


def compare_runs(args: CompareRunsArgs) -> None:
    """Print the differences of B from A with 95 % intervals, and clips that only one completes.

    Raises:
        InputError: one is no evaluation, or they have no clip in common.
    """
    found = paired(args.a, args.b)
    console = Console(width=100, highlight=False, markup=False)
    console.print(_table(found, str(args.a), str(args.b)))
    for title, names in (("only B completed", found.gained), ("only A completed", found.lost)):
        if names:
            console.print(f"{title} ({len(names)}): {', '.join(names)}", soft_wrap=True)


def _table(found: Paired, a: str, b: str) -> Table:
    table = Table(title=f"A: {a}\nB: {b}\n{len(found.clips)} clips of both", title_justify="left")
    for name in ("", "B - A", "95 % interval", "clips"):
        table.add_column(name, justify="left" if not name else "right")
    first, second = (100 * share for share in found.success)
    table.add_row(
        f"success (%): {first:.1f} and {second:.1f}, p = {found.p_success:.3f}",
        f"{second - first:+.1f}",
        _ends(found.success_interval, 100, 1),
        str(len(found.clips)),
    )
    for name, (mean, ends, count) in found.differences.items():
        table.add_row(
            f"{LABELS[name]}, completed by both", f"{mean:+.2f}", _ends(ends, 1, 2), str(count)
        )
    return table


def _ends(ends: tuple[float, float] | None, factor: float, digits: int) -> str:
    if ends is None:
        return "-"
    low, high = (factor * end for end in ends)
    return f"{low:+.{digits}f} to {high:+.{digits}f}"
