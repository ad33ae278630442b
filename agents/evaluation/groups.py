"""Success of a policy by group of motions, under several conditions: ``evaluate.py --by-group``."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from agents.agent import Agent
from agents.evaluation.follow import choose_clips
from agents.evaluation.mapping import Mapper
from agents.evaluation.options import CONDITIONS
from agents.evaluation.rollout import roll_out
from envs.config import EnvConfig
from envs.randomisation import REAL_DEVICES
from envs.starts import WHOLLY
from questsim.errors import InputError
from questsim.evaluation_report import write_report
from questsim.metrics import Rollout, summarise
from questsim.motion.clip import Clip
from questsim.motion.mixture import is_mixture, load_mixture
from questsim.motion.naming import named, place, unique_names
from questsim.motion.spec import load_motions
from questsim.statistics import interval

FILE = "groups.json"
ALL = "all"
_CHANGES: dict[str, dict[str, Any]] = {
    "reference": {},
    "still": {"starts": WHOLLY["still"]},
    "standing": {"starts": WHOLLY["standing"]},
    "noise": {"randomisation": REAL_DEVICES},
}
_HEADS = {
    "reference": "begun in the\nuser's state",
    "still": "begun in the\nuser's pose",
    "standing": "begun\nstanding",
    "noise": "device\nerrors",
}


def grouped_clips(motions: str, seed: int, most: int | None) -> tuple[list[Clip], dict[str, str]]:
    """Clips, and the group of each by its name: the entry of a mixture, else the kind of motion.

    Args:
        motions: a motion argument.
        seed: of synthetic motions.
        most: largest number of clips; None for all.

    Raises:
        InputError: the motions cannot be used.
    """

    def load(text: str, seed: int) -> list[Clip]:
        return load_motions(text, seed=seed)

    if is_mixture(motions):
        entries = load_mixture(motions, load, seed)
        loaded = [(entry, clip) for entry, members in entries for clip in members]
        names = unique_names([clip.name for _, clip in loaded], [place(e) for e, _ in loaded])
        clips = [named(clip, name) for (_, clip), name in zip(loaded, names, strict=True)]
        beside = f"{Path(motions).parent}{os.sep}"  # entries are relative to the mixture file
        labels = [entry.removeprefix(beside) for entry, _ in loaded]
        groups = dict(zip(names, labels, strict=True))
    else:
        clips = load(motions, seed)
        groups = {clip.name: clip.kind for clip in clips}
    return clips if most is None else choose_clips(clips, most), groups


def check_conditions(under: Sequence[str]) -> None:
    """Refuse unknown conditions.

    Raises:
        InputError: naming the first.
    """
    for name in under:
        if name not in CONDITIONS:
            fix = f"choose from {', '.join(CONDITIONS)}"
            raise InputError(f"there is no condition {name!r}", "--under", fix)


def by_group(
    agent: Agent,
    clips: Sequence[Clip],
    groups: Mapping[str, str],
    config: EnvConfig,
    under: Sequence[str],
    threads: int,
    mapper: Mapper,
    out: Path | None,
    context: Mapping[str, Any],
) -> dict[str, Any]:
    """Follow all clips under every condition.

    Args:
        agent: a policy.
        clips: what to follow.
        groups: the group of each clip, by its name.
        config: the environment that the policy needs.
        under: names of conditions; see ``CONDITIONS``.
        threads: of physics and networks.
        mapper: runs the batches, here or on workers.
        out: gets ``FILE`` and a folder with the report of each condition; None for none.
        context: recorded in these files.

    Returns:
        By condition and group: ``clips``, ``completed``, ``mpjpe_cm``, and the 95 % ``interval``
        of the share completed.
    """
    found: dict[str, Any] = {}
    for name in dict.fromkeys(under):
        changed = replace(config, **_CHANGES[name])
        rollouts = roll_out(agent, clips, changed, threads, mapper=mapper)
        members: dict[str, list[Rollout]] = {ALL: list(rollouts)}
        for rollout in rollouts:
            members.setdefault(groups[rollout.name], []).append(rollout)
        found[name] = {group: _figures(each) for group, each in members.items()}
        if out is not None:
            write_report(rollouts, out / name, {**context, "config": changed})
    if out is not None:
        text = json.dumps({"agent": context["agent"], "groups": found}, indent=2)
        (out / FILE).write_text(text + "\n", encoding="utf-8")
    return found


def _figures(rollouts: Sequence[Rollout]) -> dict[str, Any]:
    completed = [float(rollout.completed) for rollout in rollouts]
    return {
        "clips": len(rollouts),
        "completed": int(sum(completed)),
        "interval": interval(completed),
        "mpjpe_cm": summarise(rollouts)["mpjpe_cm"],
    }


def format_groups(found: Mapping[str, Any], width: int = 100) -> str:
    """The table as text: completed clips of each group, and the MPJPE of all until their fall."""
    table = Table(title="Completed clips (95 % interval over clips)", title_justify="left")
    table.add_column("motions", overflow="fold")
    table.add_column("clips", justify="right")
    for name in found:
        table.add_column(_HEADS[name], justify="right", no_wrap=True)
    groups = next(iter(found.values()))
    for group, figures in groups.items():
        cells = [_cell(condition[group], group == ALL) for condition in found.values()]
        table.add_row(group, str(figures["clips"]), *cells, end_section=group == ALL)
    errors = [f"{condition[ALL]['mpjpe_cm']:.2f} cm" for condition in found.values()]
    table.add_section()
    table.add_row("MPJPE until the fall", "", *errors)
    console = Console(file=io.StringIO(), width=width, color_system=None, markup=False)
    console.print(table)
    return "\n".join(line.rstrip() for line in console.file.getvalue().splitlines())  # type: ignore


def _cell(figures: Mapping[str, Any], whole: bool) -> str:
    text = str(figures["completed"])
    if whole:
        text = f"{100 * figures['completed'] / figures['clips']:.1f} %"
    ends = figures["interval"]
    if ends is None:
        return text
    low, high = f"{100 * ends[0]:.0f}", f"{100 * ends[1]:.0f}"
    return f"{text} ({low} to {high})" if whole else f"{text} ({low} to {high} %)"
