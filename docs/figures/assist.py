"""Draws success, upright avatars and error against the bound of the assist, from ``assist.csv``.

    python docs/figures/assist.py                   # into docs/images
    python docs/figures/assist.py --add NAME DIR... # adds evaluations first, see evaluate.py --out

A row of ``assist.csv``, beside this file, is one evaluation with ``--assist``, which may be 0.
"""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt

HERE = Path(__file__).parent
TABLE, IMAGE = HERE / "assist.csv", HERE.parent / "images" / "assist.png"
COLUMNS = (
    "motions", "clips", "bound_n", "success", "upright", "error_cm", "time_percent", "mean_n",
)  # fmt: skip


def add(name: str, folder: Path) -> None:
    """Append an evaluation; the error is the mean of all frames before a fall."""
    report = json.loads((folder / "metrics.json").read_text())
    use = report["context"]["assist"]
    with (folder / "clips.csv").open() as file:
        rows = list(csv.DictReader(file))
    frames = sum(int(row["frames"]) for row in rows)
    error = sum(float(row["mpjpe_cm"]) * int(row["frames"]) for row in rows) / frames
    success = 100.0 * sum(int(row["completed"]) for row in rows) / len(rows)
    values = (
        use["bound_n"], success, use["upright_percent"], error, use["time_percent"],
        use["mean_n"] or 0.0,
    )  # fmt: skip
    with TABLE.open("a", newline="") as file:
        csv.writer(file).writerow([name, len(rows), *(f"{value:.1f}" for value in values)])


def draw() -> None:
    """Draw one line per set of motions."""
    with TABLE.open() as file:
        rows = list(csv.DictReader(file))
    figure, axes = plt.subplots(1, 3, figsize=(11.0, 3.4), layout="constrained")
    for name in dict.fromkeys(row["motions"] for row in rows):
        these = sorted(
            (row for row in rows if row["motions"] == name), key=lambda row: float(row["bound_n"])
        )
        bound = [float(row["bound_n"]) for row in these]
        label = f"{name} ({these[0]['clips']} clips)"
        for axis, column in zip(axes, ("success", "upright", "error_cm"), strict=True):
            value = [float(row[column] or "nan") for row in these]  # empty: not measured
            axis.plot(bound, value, marker="o", label=label)
    axes[0].set(ylabel="Clips followed within 0.5 m (%)", ylim=(0, 102))
    axes[1].set(ylabel="Upright to the end of the clip (%)", ylim=(0, 102))
    axes[2].set(ylabel="Mean link error until it is lost (cm)")
    axes[2].set_ylim(0.0, 1.1 * max(float(row["error_cm"]) for row in rows))
    axes[0].legend(fontsize=8, loc="lower right")
    for axis in axes:
        axis.set_xlabel("Bound of the assist (N)")
        axis.grid(alpha=0.3)
    figure.savefig(IMAGE, dpi=110)


def main() -> None:
    """Add evaluations, if any are named, and draw."""
    if not TABLE.is_file():
        TABLE.write_text(",".join(COLUMNS) + "\n")
    if sys.argv[1:2] == ["--add"]:
        for folder in sys.argv[3:]:
            add(sys.argv[2], Path(folder))
    draw()
    print(f"written to {IMAGE}")


if __name__ == "__main__":
    main()
