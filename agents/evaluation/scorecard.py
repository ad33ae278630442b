"""The scorecard: one command compares the shipped policies with every bar of the project."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from agents.evaluation.follow import choose_clips
from agents.evaluation.report import evaluation_context
from agents.evaluation.rollout import env_config, roll_out
from agents.loading import load_agent
from questsim.evaluation_report import LABELS, write_report
from questsim.files import whole_file

SCORECARD_FILE = "scorecard.json"


@dataclass(frozen=True)
class Trial:
    """One evaluation of the scorecard.

    Attributes:
        suffix: suffix of the agent's name; each sensor set has its own policy.
        height_m: stature that avatar and clips are scaled to; None for the clips' own.
        says: label in the table.
    """

    suffix: str = ""
    height_m: float | None = None
    says: str = ""


@dataclass(frozen=True)
class Bar:
    """A metric with its minimum requirement (bar) and its target (goal).

    Attributes:
        trial: name in ``TRIALS``.
        metric: key of the report; ``success`` is over all clips, the others over completed clips.
        bar, goal: in the metric's unit; success in percent.
    """

    trial: str
    metric: str
    bar: float
    goal: float

    def reached(self, value: float | None, limit: float) -> bool:
        """Whether a figure satisfies a limit."""
        if value is None:
            return False
        return value >= limit if self.metric == "success" else value <= limit


TRIALS: dict[str, Trial] = {
    "h2c": Trial(says="headset and controllers"),
    "headset": Trial("-headset", says="headset only"),
    "now": Trial("-now", says="headset and controllers, no future frames"),
    "short": Trial(height_m=1.45, says="headset and controllers, 1.45 m"),
    "tall": Trial(height_m=1.95, says="headset and controllers, 1.95 m"),
}

BARS: tuple[Bar, ...] = (
    Bar("h2c", "success", 95.0, 99.0),
    Bar("h2c", "mpjpe_cm", 4.0, 3.0),
    Bar("h2c", "mpjre_deg", 8.0, 5.7),
    Bar("h2c", "root_cm", 3.0, 1.8),
    Bar("h2c", "sip_deg", 12.3, 10.0),
    Bar("h2c", "jitter_km_s3", 0.5, 0.3),
    Bar("h2c", "mhpe_cm", 5.0, 3.7),
    Bar("h2c", "mhre_deg", 10.0, 8.4),
    Bar("headset", "success", 85.0, 95.0),
    Bar("now", "success", 85.0, 95.0),
    Bar("short", "success", 90.0, 97.0),
    Bar("tall", "success", 90.0, 97.0),
)
"""Bars of the project on bandai-namco-2:test; most goals are QuestSim's figures."""


def scorecard(
    agent: str,
    motions: str,
    out: Path | None,
    max_clips: int | None,
    threads: int,
    seed: int = 0,
) -> dict[str, Any]:
    """Evaluate a policy and its variants, and compare the figures with the bars.

    Args:
        agent: name of a shipped policy; its variants have the suffixes of ``TRIALS``.
        motions: the motions to follow; for a test split, also evaluates the training split.
        out: folder for ``scorecard.json`` and one subfolder per trial with its report.
        max_clips: follow only this many clips.
        threads: physics threads.
        seed: seed of the embedded motions.

    Returns:
        The contents of ``scorecard.json``.

    Raises:
        InputError: one of the policies or the motions is missing.
    """
    from questsim.motion.spec import load_motions

    agents = {name: load_agent(agent + trial.suffix) for name, trial in TRIALS.items()}
    clips = load_motions(motions, seed=seed)
    if max_clips is not None:
        clips = choose_clips(clips, max_clips)
    sets = {name: (motions, clips, trial) for name, trial in TRIALS.items()}
    dataset, _, split = motions.partition(":")
    if split == "test":
        learnt = choose_clips(load_motions(f"{dataset}:train"), len(clips))
        sets["train"] = (f"{dataset}:train", learnt, TRIALS["h2c"])
        agents["train"] = agents["h2c"]
    figures = {}
    for name, (spec, followed, trial) in sets.items():
        config = env_config(agents[name], height_m=trial.height_m)
        rollouts = roll_out(agents[name], followed, config, threads)
        context = evaluation_context(
            agent + trial.suffix, agents[name], spec, followed, config, threads
        )
        figures[name] = _report(rollouts, context, out / name if out else None)
    card = {"agent": agent, "motions": motions, "rows": _rows(figures), "trials": figures}
    if out is not None:
        with whole_file(out / SCORECARD_FILE) as path:
            path.write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8")
    return card


def _report(rollouts: list[Any], context: dict[str, Any], out: Path | None) -> dict[str, Any]:
    """The figures of one trial; writes its full report if a folder is given."""
    from questsim.metrics import evaluate

    metrics = evaluate(rollouts) if out is None else write_report(rollouts, out, context)
    return {key: metrics[key] for key in ("all", "completed", "by_kind", "by_style")}


def _rows(figures: Mapping[str, Any]) -> list[dict[str, Any]]:
    rows = []
    for bar in BARS:
        value = figure(figures[bar.trial], bar.metric)
        rows.append(
            asdict(bar)
            | {
                "value": value,
                "bar_reached": bar.reached(value, bar.bar),
                "goal_reached": bar.reached(value, bar.goal),
            }
        )
    return rows


def figure(metrics: Mapping[str, Any], metric: str) -> float | None:
    """A figure as the bars define it: success over all clips in percent, others over completed."""
    value = metrics["all" if metric == "success" else "completed"][metric]
    return 100.0 * value if metric == "success" and value is not None else value


def format_scorecard(card: Mapping[str, Any], width: int = 100) -> str:
    """The scorecard as text for a terminal, followed by training clips beside test clips.

    Args:
        card: the result of ``scorecard``.
        width: columns of the terminal.
    """
    table = Table(title=f"{card['agent']} on {card['motions']}", title_justify="left")
    for column in ("", "figure", "value", "bar", "goal", "reached"):
        table.add_column(column, justify="right" if column in ("value", "bar", "goal") else "left")
    for row in card["rows"]:
        reached = "goal" if row["goal_reached"] else "bar" if row["bar_reached"] else "no"
        table.add_row(
            TRIALS[row["trial"]].says,
            LABELS[row["metric"]],
            *("-" if row[key] is None else f"{row[key]:.2f}" for key in ("value", "bar", "goal")),
            reached,
        )
    console = Console(file=io.StringIO(), width=width, color_system=None, markup=False)
    console.print(table)
    if "train" in card["trials"]:
        console.print(_gap(card["trials"]))
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    return "\n".join(line.rstrip() for line in lines)


def _gap(trials: Mapping[str, Any]) -> Table:
    """Training clips beside test clips; a large difference shows overfitting."""
    table = Table(title="Clips it learnt from and clips no stage saw", title_justify="left")
    for column in ("figure", "train", "test"):
        table.add_column(column, justify="left" if column == "figure" else "right")
    for metric in dict.fromkeys(bar.metric for bar in BARS):
        values = (figure(trials[name], metric) for name in ("train", "h2c"))
        table.add_row(LABELS[metric], *("-" if v is None else f"{v:.2f}" for v in values))
    return table
