"""Draws how teachers and students learnt, from the tables beside this file.

    python docs/figures/training_curves.py  # into docs/images
    python docs/figures/training_curves.py --add NAME runs/RUN/STAGE [STEPS]  # adds a curve first

STEPS are those of the training that this one began with.

`curves.csv` has a row for every evaluation of a training on its fixed clips.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import matplotlib.pyplot as plt

HERE = Path(__file__).parent
TABLE, IMAGES = HERE / "curves.csv", HERE.parent / "images"
COLUMNS: tuple[str, ...] = ("curve", "steps", "tracked", "link_error_cm", "score")
MOST_INSIDE = 6
"""Curves whose legend has room inside the plot."""
FIGURES: dict[str, tuple[str | tuple[str, str], ...]] = {
    "training-teacher.png": (
        "springs of 100 c",
        "springs of 50 c, orientations rewarded",
        "and torques of the motion",
        "and errors of the links",
    ),
    "training-shipped.png": (
        ("and errors of the links", "from nothing, flat"),
        "goes on, flat",
        "goes on, mixed ground and pushes",
        ("and estimated motion, more hard ground", "and estimated motion"),
        (
            "only the hardest ground, larger batches",
            "only the hardest ground, balls, larger batches",
        ),
        ("and a longer horizon", "and a longer horizon (discount 0.99)"),
    ),
    "training-students.png": ("student H+2C", "student H", "student H+2C, no future frames"),
    "training-students-shipped.png": (
        "goes on, H+2C",
        "goes on, H",
        "goes on, H+2C, no future frames",
        ("goes on again, H+2C", "H+2C, of the next teacher"),
        ("goes on once more, H+2C", "H+2C, of the last teacher, hardest ground"),
        ("goes on again, H", "H, of the next teacher"),
    ),
    "training-wider.png": (
        ("wider, tracker, second part", "tracker, second part"),
        ("wider, tracker from nothing", "tracker from nothing"),
        ("wider, tracker of two", "one tracker of two, from it"),
        ("wider, tracker, seats", "D: sits down, too"),
        ("wider, student", "wide student, with device errors, first part"),
        ("wider, student, last part", "wide student, last part"),
        ("wider, questsim", "questsim, one student of two"),
        ("wider, now", "questsim-now, student of questsim"),
        ("wider, now, of two", "questsim-now, one student of two"),
    ),
    "training-steps.png": (
        ("steps, PPO from the head", "specialist: PPO from the head alone"),
        ("steps, PPO from D", "PPO from D, real walks, too"),
        ("steps, PPO from E", "PPO from E, statistics kept, second part"),
        ("steps, E", "E: one tracker of D and the specialist"),
        ("steps, student", "student of E, steps alone"),
    ),
    "training-others.png": (
        ("others, E by reward on all motions", "PPO from E on all motions"),
        ("others, by reward", "specialist: PPO on other people's motions alone"),
        ("others, F", "F: one tracker of E and both"),
        ("others, student of E", "student of E, a quarter of it steps"),
    ),
    "training-chains.png": (
        ("chains, first part", "first part: 144 chains"),
        ("chains, questsim", "second part: 288 chains, seats, more slopes"),
    ),
    "training-estimates.png": (
        ("shown estimates", "before: shown estimates of HMD-Poser and LGSIK-Poser"),
        ("shown estimates, again", "of ik and DragPoser, and recordings, too"),
        ("shown estimates, by reward", "by reward for the true motion"),
        ("shown estimates, D", "shipped: D, shown estimates of more motions"),
        ("shown estimates, D, begun in them", "begun in the estimates, too"),
    ),
}
"""The curves of each picture; a pair is a curve and what it is called there."""


def read(table: Path = TABLE) -> dict[str, list[dict[str, str]]]:
    """The rows of a table by curve; none if there is no such file."""
    curves: dict[str, list[dict[str, str]]] = {}
    if table.exists():
        with table.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                curves.setdefault(row["curve"], []).append(row)
    return curves


def write(
    curves: dict[str, list[dict[str, str]]],
    columns: tuple[str, ...] = COLUMNS,
    table: Path = TABLE,
) -> None:
    """Write the rows of all curves, with these columns, into a table."""
    with table.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(row for rows in curves.values() for row in rows)


def add(curve: str, stage: Path, before: int = 0) -> None:
    """Take the evaluations of a stage's last checkpoint into the table.

    Args:
        curve: its name.
        stage: the stage's folder.
        before: steps of the training that it began with.
    """
    from agents.policy.checkpoint import load_resume

    curves = read()
    history = load_resume(stage / "last")["history"]
    names = COLUMNS[1:]
    history = [row | {"steps": row["steps"] + before} for row in history]
    curves[curve] = [{"curve": curve} | {n: f"{row[n]:g}" for n in names} for row in history]
    write(curves)


def draw(curves: dict[str, list[dict[str, str]]]) -> None:
    """Share of clips tracked and mean link error against steps."""
    for name, members in FIGURES.items():
        many = len(members) > MOST_INSIDE
        size = (9, 4.2 if many else 3.2)
        figure, axes = plt.subplots(1, 2, figsize=size, layout="constrained")
        for member in members:
            curve, label = (member, member) if isinstance(member, str) else member
            rows = curves.get(curve, [])
            steps = [float(row["steps"]) / 1e6 for row in rows]
            axes[0].plot(steps, [100 * float(r["tracked"]) for r in rows], label=label)
            axes[1].plot(steps, [float(r["link_error_cm"]) for r in rows], label=label)
        axes[0].set(xlabel="steps (M)", ylabel="clips tracked (%)", ylim=(0, 100))
        axes[1].set(xlabel="steps (M)", ylabel="mean link error (cm)")
        axes[1].set_ylim(bottom=0)
        if many:
            figure.legend(
                *axes[0].get_legend_handles_labels(),
                loc="outside lower center",
                ncols=2,
                frameon=False,
            )
        else:
            axes[0].legend(frameon=False)
        for axis in axes:
            axis.spines[["top", "right"]].set_visible(False)
            axis.grid(alpha=0.25)
        figure.savefig(IMAGES / name, dpi=110)
        plt.close(figure)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--add"]:
        add(sys.argv[2], Path(sys.argv[3]), *map(int, sys.argv[4:]))
    draw(read())
