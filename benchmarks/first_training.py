"""A first training, over seeds: does it learn what the tutorial says?

    python -m benchmarks.first_training [--seeds 3] [--minutes 4 10] [--preset cpu] [--out DIR]
    python -m benchmarks.first_training --steps 300000 150000

Each seed is trained once for each time, from nothing, in a process of its own; at the defaults this
takes 42 minutes. Run it while nothing else uses the processor, since it gives minutes, not steps;
with --steps the result is the same on any processor, also beside other work. Trainings that --out
has already are not repeated. The bars: the first update of PPO has a KL divergence below 0.2,
teacher and student are better at the end than at their start, the student is better than zero
torques, and after the longest time all clips of standing and waving are followed to the end.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from agents.evaluation.follow import evaluation_sim, follow
from agents.evaluation.rollout import env_config
from agents.loading import load_agent
from questsim.files import whole_file
from questsim.motion.spec import load_motions

ROOT = Path(__file__).parents[1]
FOLLOWED = "synthetic:stand+wave"
"""Motions that are to be followed to the end."""
FIRST_KL = 0.2
RESULT = "first-training.json"


def main() -> int:
    """Train, score and print; returns 1 if a bar is missed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--minutes", type=float, nargs="+", default=[4.0, 10.0])
    parser.add_argument("--steps", type=int, nargs=2, metavar=("TEACHER", "STUDENT"))
    parser.add_argument("--preset", default="cpu", choices=["cpu", "smoke"])
    parser.add_argument("--set", nargs="*", default=[], help="as in train.py")
    parser.add_argument("--out", type=Path, default=Path("runs/first"))
    given = parser.parse_args()
    budgets = [Budget(steps=tuple(given.steps))] if given.steps else []
    budgets = budgets or [Budget(minutes=minutes) for minutes in given.minutes]
    results = [result(given, budget, seed) for budget in budgets for seed in range(given.seeds)]
    longest = None if given.steps else str(Budget(minutes=max(given.minutes)))
    for each in results:
        each["bars"] = bars(each, each["budget"] == longest)
    if given.json:
        print(json.dumps(results, indent=1))
    else:
        print(table(results))
    return int(not all(met for each in results for met in each["bars"].values()))


@dataclass(frozen=True)
class Budget:
    """How long a training takes: minutes, or steps of the teacher and of the student."""

    minutes: float = 1e5
    steps: tuple[int, ...] = ()

    def __str__(self) -> str:
        return "+".join(map(str, self.steps)) or f"{self.minutes:g}"

    @property
    def overrides(self) -> list[str]:
        """For ``--set``."""
        stages = zip(("teacher", "student"), self.steps, strict=False)
        return [f"stages.{stage}.steps={steps}" for stage, steps in stages]


def result(given: argparse.Namespace, budget: Budget, seed: int) -> dict[str, Any]:
    """Figures of one training, which is made if the folder has none."""
    out = given.out / f"{given.preset}-{budget}-seed-{seed}"
    if (out / RESULT).is_file():
        return json.loads((out / RESULT).read_text(encoding="utf-8"))
    words = ["--preset", given.preset, "--minutes", str(budget.minutes), "--seed", str(seed)]
    words += ["--motions", "synthetic", "--out", str(out), "--log", "csv"]
    changes = [*budget.overrides, *given.set]
    words += ["--set", *changes] if changes else []
    subprocess.run([sys.executable, ROOT / "train.py", *words], check=True, stdout=sys.stderr)
    figures = figures_of(out) | {"preset": given.preset, "budget": str(budget), "seed": seed}
    with whole_file(out / RESULT) as fresh:
        fresh.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    return figures


def figures_of(out: Path) -> dict[str, Any]:
    """What a finished training learnt, from its curves and from its policy.

    Args:
        out: folder of the run.

    Returns:
        ``first_kl`` of the teacher, ``start`` and ``end`` scores of each stage, the policy's score
        on ``FOLLOWED`` beside that of zero torques, and the share of these clips that it follows.
    """
    stages = {
        path.parents[1].name: curve(path) for path in out.glob("*/tensorboard/progress-1.csv")
    }
    figures: dict[str, Any] = {}
    for stage, rows in sorted(stages.items()):
        scores = [float(row["evaluation/score"]) for row in rows if row.get("evaluation/score")]
        figures[stage] = {"start": scores[0], "end": scores[-1]}
        steps = [row["time/total_timesteps"] for row in rows if row.get("time/total_timesteps")]
        figures[stage]["steps"] = int(float(steps[-1]))
    kls = (float(row["train/kl"]) for row in stages["teacher"] if row.get("train/kl"))
    figures["first_kl"] = next((kl for kl in kls if kl > 0), None)  # 0 while the critic warms up
    clips = load_motions(FOLLOWED)
    for name in ("zero", str(out)):
        agent = load_agent(name)
        sim = evaluation_sim(clips, replace(env_config(agent), fixed_start=True))
        agent.bind(sim)
        found = follow(agent, sim, clips)
        part = "zero" if name == "zero" else "policy"
        figures[part] = {"score": found.score, "followed": found.tracked}
    return figures


def curve(path: Path) -> list[dict[str, str]]:
    """The rows of a file of curves."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def bars(figures: dict[str, Any], longest: bool) -> dict[str, bool]:
    """Which bars a training meets."""
    teacher, student, policy = figures["teacher"], figures["student"], figures["policy"]
    met = {
        "first KL": figures["first_kl"] is not None and figures["first_kl"] < FIRST_KL,
        "teacher better than its start": teacher["end"] > teacher["start"],
        "better than its start": student["end"] > student["start"],
        "better than zero torques": policy["score"] > figures["zero"]["score"],
    }
    return met | ({"stand and wave": policy["followed"] == 1.0} if longest else {})


def table(results: Sequence[dict[str, Any]]) -> str:
    """One line per training."""
    lines = ["      budget seed  first KL  teacher        student        stand+wave  zero   missed"]
    for each in results:
        scores = [f"{each[s]['start']:.3f}->{each[s]['end']:.3f}" for s in ("teacher", "student")]
        missed = ", ".join(name for name, met in each["bars"].items() if not met) or "-"
        kl = "-" if each["first_kl"] is None else f"{each['first_kl']:.3f}"
        lines.append(
            f"{each['budget']:>12} {each['seed']:4d}  {kl:>8}  {'  '.join(scores)}  "
            f"{100 * each['policy']['followed']:8.0f} %  {each['zero']['score']:.3f}  {missed}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
