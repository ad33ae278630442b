"""Draws how the shipped kinematic systems learnt, from the table beside this file.

    python -m docs.figures.system_curves  # into docs/images
    python -m docs.figures.system_curves --add NAME runs/RUN/STAGE  # adds a curve first

`system_curves.csv` has a row for every evaluation of a training on its validation motions. The run
must have been logged with ``--log csv``.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import matplotlib.pyplot as plt

from docs.figures.training_curves import read, write

HERE = Path(__file__).parent
TABLE, IMAGE = HERE / "system_curves.csv", HERE.parent / "images" / "training-systems.png"
COLUMNS: tuple[str, ...] = ("curve", "steps", "error_cm")


def evaluations(stage: Path) -> list[tuple[int, float]]:
    """Steps and error in cm of each evaluation of a stage, in the order of the steps."""
    found = {}
    for log in sorted(stage.glob("tensorboard/progress-*.csv")):
        with log.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                if error := row.get("evaluation/error_cm"):
                    found[int(row["time/total_timesteps"])] = float(error)
    return sorted(found.items())


def add(curve: str, stage: Path, table: Path = TABLE) -> None:
    """Take the evaluations of a stage into the table, in place of the curve of the same name."""
    curves = read(table)
    curves[curve] = [
        {"curve": curve, "steps": str(steps), "error_cm": f"{error:.3f}"}
        for steps, error in evaluations(stage)
    ]
    write(curves, COLUMNS, table)


def draw(curves: dict[str, list[dict[str, str]]]) -> None:
    """Mean joint error of the validation motions against gradient steps."""
    figure, axis = plt.subplots(figsize=(6, 3.2), layout="constrained")
    for curve, rows in curves.items():
        steps = [int(row["steps"]) / 1000 for row in rows]
        axis.plot(steps, [float(row["error_cm"]) for row in rows], label=curve)
    axis.set(xlabel="gradient steps (thousands)", ylabel="mean joint error (cm)")
    axis.set_ylim(bottom=0)
    axis.legend(frameon=False)
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.25)
    figure.savefig(IMAGE, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--add"]:
        add(sys.argv[2], Path(sys.argv[3]))
    draw(read(TABLE))
