"""The scorecard: one command compares the shipped policies with every bar of the project.

A trial that has been evaluated is kept in its own file, so that an interrupted scorecard can
continue. The file is used again only for the same policy, motions, environment and versions.
"""

from __future__ import annotations

import hashlib
import io
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from agents.agent import Agent
from agents.evaluation.follow import choose_clips
from agents.evaluation.mapping import Mapper
from agents.evaluation.report import evaluation_context
from agents.evaluation.rollout import env_config, roll_out
from agents.evaluation.scorecard_rows import BARS, EXTRA, TRIALS, Trial
from agents.evaluation.standing_pushes import long_standing_clip, pushed
from agents.evaluation.worlds import world_clips, world_row
from agents.loading import load_agent
from agents.policy.checkpoint import find_policy
from agents.run_folder import data_record, plain, versions
from envs.config import EnvConfig
from questsim.errors import InputError
from questsim.evaluation_report import LABELS, write_report
from questsim.files import whole_file
from questsim.motion.clip import Clip
from questsim.statistics import interval

SCORECARD_FILE, TRIAL_FILE = "scorecard.json", "trial.json"
Answers = Callable[[Sequence[Clip]], tuple[list[Clip], Mapping[str, Clip] | None]]
"""Clips from the moment at which avatars begin, and estimates of that moment by name."""


@dataclass(frozen=True)
class _PlannedTrial:
    """A trial with all that it needs.

    Attributes:
        name: of the trial.
        trial: what to evaluate.
        label: name of the agent.
        agent: the agent.
        motions: argument that the clips come from.
        clips: motions to follow.
        config: the environment.
        frames: frames to simulate, about.
    """

    name: str
    trial: Trial
    label: str
    agent: Agent
    motions: str
    clips: list[Clip]
    config: EnvConfig
    frames: int


def scorecard(
    agent: str,
    motions: str,
    out: Path | None,
    max_clips: int | None,
    threads: int,
    seed: int = 0,
    rows: Sequence[str] = (),
    extra: str | None = None,
    answers: Answers | None = None,
    say: Callable[[str], None] = print,
    mapper: Mapper = map,
) -> dict[str, Any]:
    """Evaluate a policy and its variants, and compare the figures with the bars.

    Args:
        agent: name of a shipped policy; its variants have the suffixes of ``TRIALS``.
        motions: the motions to follow; for a test split, also evaluates the training split.
        out: folder for ``scorecard.json`` and one subfolder per trial with its report. Trials
            that are already there are not evaluated again.
        max_clips: follow only this many clips in each trial.
        threads: physics threads.
        seed: seed of the embedded motions.
        rows: names of ``TRIALS`` to evaluate; all that the agent has if empty.
        extra: motions of the trial ``extra``, which is left out without them.
        answers: clips from the moment at which avatars begin, and estimates of it, for the trial
            ``estimate``, which is left out without it.
        say: prints a line after each trial.
        mapper: runs the batches of a trial, here or on workers, with the same bits.

    Returns:
        The contents of ``scorecard.json``.

    Raises:
        InputError: one of the policies, rows or motions is missing.
    """
    jobs = _jobs(agent, motions, max_clips, seed, _chosen(agent, rows, extra, answers), extra)
    tracker = all(job.agent.needs.privileged for job in jobs)
    if not rows:
        jobs += _learnt(agent, motions, jobs)
    left, spent, done = sum(job.frames for job in jobs), 0.0, 0
    figures: dict[str, Any] = {}
    for job in jobs:
        kept, began = _kept(job, out), time.perf_counter()
        if kept is None:
            kept = _evaluated(job, out, threads, answers, mapper)
            spent, done = spent + time.perf_counter() - began, done + job.frames
        left -= job.frames
        figures[job.name] = kept
        rest = f"about {left * spent / done:.0f} s left" if done else "kept from before"
        say(f"{job.name}: {100.0 * kept['all']['success']:.1f} % of {len(job.clips)} clips; {rest}")
    card = {"agent": agent, "motions": motions, "rows": _rows(figures, tracker), "trials": figures}
    if out is not None:
        with whole_file(out / SCORECARD_FILE) as path:
            path.write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8")
    return card


def _chosen(
    agent: str, rows: Sequence[str], extra: str | None, answers: Answers | None
) -> list[str]:
    """Names of the trials to run."""
    unknown = [name for name in rows if name not in TRIALS]
    if unknown:
        raise InputError(
            f"there is no {unknown[0]!r}", "--rows", f"choose from {', '.join(TRIALS)}"
        )
    if EXTRA in rows and extra is None:
        raise InputError("needs motions", f"--rows {EXTRA}", "add --extra MOTIONS")
    if rows and extra is not None and EXTRA not in rows:
        raise InputError("is not among --rows", "--extra", f"add {EXTRA} to --rows")
    if rows:
        return [name for name in TRIALS if name in rows]
    # A tracker observes the whole body, so it has no variants for other devices.
    variants = not load_agent(agent).needs.privileged
    return [
        name
        for name, trial in TRIALS.items()
        if (variants or not trial.suffix)
        and (name != EXTRA or extra is not None)
        and (not trial.estimate or answers is not None)
    ]


def _jobs(
    agent: str,
    motions: str,
    max_clips: int | None,
    seed: int,
    names: Sequence[str],
    extra: str | None,
) -> list[_PlannedTrial]:
    """The trials with their agents and clips; everything is loaded before anything runs."""
    from questsim.motion.spec import load_motions

    agents = {suffix: load_agent(agent + suffix) for suffix in {TRIALS[n].suffix for n in names}}
    loaded: dict[tuple[str, int], list[Clip]] = {}
    jobs = []
    for name in names:
        trial = TRIALS[name]
        spec = (extra if name == EXTRA else trial.motions) or motions
        key = (spec, seed if trial.seed is None else trial.seed)
        if trial.push_n is None and key not in loaded:
            loaded[key] = load_motions(spec, seed=key[1])
        clips = [long_standing_clip()] if trial.push_n is not None else loaded[key]
        if trial.world is not None:
            clips = world_clips(trial.world, clips)
            if not clips:  # a row of walking, for motions that do not walk
                continue
        if max_clips is not None:
            clips = choose_clips(clips, max_clips)
        acting = agents[trial.suffix]
        config = replace(env_config(acting, height_m=trial.height_m), **trial.changes)
        settings = 1 if trial.world is None else len(trial.world.settings)
        frames = sum(map(len, clips)) * (16 if trial.push_n is not None else settings)
        label = agent + trial.suffix
        jobs.append(_PlannedTrial(name, trial, label, acting, spec, list(clips), config, frames))
    if not jobs:
        raise InputError("no clip of these motions suits --rows", motions, "choose other rows")
    return jobs


def _learnt(agent: str, motions: str, jobs: Sequence[_PlannedTrial]) -> list[_PlannedTrial]:
    """For a test split also the training split, with as many clips."""
    from questsim.motion.spec import load_motions

    dataset, _, split = motions.partition(":")
    if split != "test":
        return []
    plain_job = next(job for job in jobs if job.name == "h2c")
    spec = f"{dataset}:train"
    clips = choose_clips(load_motions(spec), len(plain_job.clips))
    frames = sum(map(len, clips))
    return [replace(plain_job, name="train", motions=spec, clips=clips, frames=frames)]


def _key(job: _PlannedTrial) -> str:
    """Hash of all that a trial's figures depend on."""
    digest = hashlib.sha256(json.dumps(plain(versions()), sort_keys=True).encode())
    digest.update(repr((job.name, job.trial, job.config)).encode())
    digest.update(data_record(job.motions, job.clips)["sha256"].encode())
    try:
        weights = find_policy(job.label)
    except InputError:  # an agent without weights
        digest.update(job.label.encode())
    else:
        for file in sorted(weights.glob("policy.*")):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _kept(job: _PlannedTrial, out: Path | None) -> dict[str, Any] | None:
    """The figures of an earlier evaluation of the same trial."""
    if out is None:
        return None
    try:
        record = json.loads((out / job.name / TRIAL_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record["figures"] if record.get("key") == _key(job) else None


def _evaluated(
    job: _PlannedTrial,
    out: Path | None,
    threads: int,
    answers: Answers | None,
    mapper: Mapper,
) -> dict[str, Any]:
    """The figures of a trial; writes its report and the file that keeps it."""
    folder = None if out is None else out / job.name
    trial = job.trial
    if trial.push_n is not None:
        good = pushed(job.agent, job.clips[0], job.config, float(trial.push_n), threads)
        figures = _share(float(np.mean(good)), interval(np.asarray(good, float)))
    elif trial.world is not None:
        row = world_row(trial.world, job.agent, job.clips, job.config, threads, 0, mapper)
        figures = _share(row["success"], row["interval"]) | {"world": row}
    else:
        clips, begin_at = job.clips, None
        if trial.estimate and answers:
            clips, begin_at = answers(clips)
        # Sorted, as the reports of earlier versions are.
        ordered = sorted(clips, key=len)
        rollouts = roll_out(
            job.agent, ordered, job.config, threads, begin_at=begin_at, mapper=mapper
        )
        context = evaluation_context(
            job.label, job.agent, job.motions, job.clips, job.config, threads
        )
        figures = _report(rollouts, context, folder)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        with whole_file(folder / TRIAL_FILE) as path:
            record = {"key": _key(job), "figures": figures}
            path.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    return json.loads(json.dumps(figures))


def _share(success: float, ends: Sequence[float] | None) -> dict[str, Any]:
    return {
        "all": {"success": success},
        "completed": {},
        "intervals": {"all": {"success": None if ends is None else list(ends)}},
        "by_kind": {},
        "by_style": {},
    }


def _report(rollouts: list[Any], context: dict[str, Any], out: Path | None) -> dict[str, Any]:
    """The figures of one trial; writes its full report if a folder is given."""
    from questsim.metrics import evaluate

    metrics = evaluate(rollouts) if out is None else write_report(rollouts, out, context)
    kept = ("all", "completed", "intervals", "by_kind", "by_style")
    return {key: metrics[key] for key in kept}


def _rows(figures: Mapping[str, Any], tracker: bool) -> list[dict[str, Any]]:
    """The figures that have a bar; ``tracker``: the policy observes the whole body."""
    rows = []
    for bar in BARS:
        if bar.trial not in figures:
            continue
        bar = bar.of(tracker)
        if bar.below is not None:
            if bar.below not in figures:
                continue
            whole = figure(figures[bar.below], bar.metric) or 0.0
            bar = replace(bar, bar=whole - bar.bar, goal=whole - bar.goal)
        value = figure(figures[bar.trial], bar.metric)
        rows.append(
            asdict(bar)
            | {
                "value": value,
                "interval": interval_of(figures[bar.trial], bar.metric),
                "bar_reached": bar.reached(value, bar.bar),
                "goal_reached": bar.reached(value, bar.goal),
            }
        )
    return rows


def figure(metrics: Mapping[str, Any], metric: str) -> float | None:
    """A figure as the bars define it: success over all clips in percent, others over completed."""
    value = metrics["all" if metric == "success" else "completed"][metric]
    return 100.0 * value if metric == "success" and value is not None else value


def interval_of(metrics: Mapping[str, Any], metric: str) -> list[float] | None:
    """The 95 % interval of ``figure`` over clips; None for fewer than 11 clips."""
    column = "all" if metric == "success" else "completed"
    ends = metrics.get("intervals", {}).get(column, {}).get(metric)
    if ends is None:
        return None
    return [100.0 * end for end in ends] if metric == "success" else list(ends)


def _between(ends: Sequence[float] | None) -> str:
    return "" if ends is None else f"{ends[0]:.2f} to {ends[1]:.2f}"


def format_scorecard(card: Mapping[str, Any], width: int = 100) -> str:
    """The scorecard as text for a terminal, followed by training clips beside test clips.

    Args:
        card: the result of ``scorecard``.
        width: columns of the terminal.
    """
    table = Table(title=f"{card['agent']} on {card['motions']}", title_justify="left")
    numbers = ("value", "95 % over clips", "bar", "goal")
    for column in ("", "figure", *numbers, "reached"):
        table.add_column(column, justify="right" if column in numbers else "left")
    for row in card["rows"]:
        reached = "goal" if row["goal_reached"] else "bar" if row["bar_reached"] else "no"
        table.add_row(
            TRIALS[row["trial"]].says,
            LABELS[row["metric"]],
            "-" if row["value"] is None else f"{row['value']:.2f}",
            _between(row.get("interval")),
            *("-" if row[key] is None else f"{row[key]:.2f}" for key in ("bar", "goal")),
            reached,
        )
    console = Console(file=io.StringIO(), width=width, color_system=None, markup=False)
    console.print(table)
    if {"train", "h2c"} <= set(card["trials"]):
        console.print(_gap(card["trials"]))
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    return "\n".join(line.rstrip() for line in lines)


def _gap(trials: Mapping[str, Any]) -> Table:
    """Training clips beside test clips; a large difference shows overfitting."""
    table = Table(title="Clips it learnt from and clips no stage saw", title_justify="left")
    for column in ("figure", "train", "test"):
        table.add_column(column, justify="left" if column == "figure" else "right")
    for metric in dict.fromkeys(bar.metric for bar in BARS if bar.trial == "h2c"):
        values = (figure(trials[name], metric) for name in ("train", "h2c"))
        table.add_row(LABELS[metric], *("-" if v is None else f"{v:.2f}" for v in values))
    return table
