"""How a policy came to be: the runs and stages behind it, their time, and all their data."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from math import ceil
from pathlib import Path
from typing import Any

from agents.checkpoint import CARD_FILE, find_policy, read_card
from agents.licence import strictest
from agents.run_folder import RECORD, plain, read_run
from agents.training import TrainArgs
from questsim.errors import InputError

STAGES = ("teacher", "student", "finetune")
"""In the order in which they build on each other; the paper's ``ppo`` stands alone."""

RECORDED = ("stage", "steps", "minutes", "motions", "licences", "seed", "clips", "seconds")
"""What the ``training`` of a policy must tell, as every training writes it."""

NOT_REPEATED = ("out", "stage", "minutes", "steps", "resume", "teacher", "threads")
"""Options that a command line here has of its own, or that have no effect on what is learnt."""


@dataclass(frozen=True)
class StagePart:
    """One stage behind a policy.

    Attributes:
        run: the run folder; of a shipped policy, its folder.
        training: of the policy that came out of it.
        steps, minutes: spent in all; its best policy may have come earlier.
        command: what trained it, where no run tells.
    """

    run: Path
    training: dict[str, Any]
    steps: int
    minutes: float
    command: str | None = None


def provenance(folder: Path) -> dict[str, Any]:
    """What a model card tells of the training of a run's policy.

    Args:
        folder: the policy's, inside its run.

    Returns:
        ``commands``, one a stage; ``stages``, each with ``stage``, ``steps``, ``minutes`` and
        ``motions``, the policy's own last; ``licence`` of the weights, from the motions of all
        stages; ``versions`` of the packages.

    Raises:
        InputError: the policy is not inside a run, or what came before it is gone.
    """
    parts = stages_behind(folder)
    return {
        "commands": commands(parts),
        "stages": [
            {
                "stage": part.training["stage"],
                "steps": part.steps,
                "minutes": part.minutes,
                "motions": part.training["motions"],
            }
            for part in parts
        ],
        "licence": strictest(name for part in parts for name in part.training["licences"]),
        "versions": read_run(parts[-1].run)["versions"],
    }


def stages_behind(folder: Path) -> list[StagePart]:
    """The stages that led to a policy, its own last.

    Raises:
        InputError: see ``provenance``.
    """
    training = _training(folder)
    if "stages" in training:
        return _shipped_stages(folder, training)
    run = run_of(folder)
    stage, earlier = training["stage"], list[StagePart]()
    start = read_run(run)["args"].get("start")
    if stage in STAGES[1:]:
        before = STAGES[STAGES.index(stage) - 1]
        teacher = read_run(run)["args"].get("teacher")
        where = Path(teacher) if teacher and before == "teacher" else run / before
        if start and stage == "finetune":
            where = Path(start)
        earlier = stages_behind(find_policy(where))
    if stage == "teacher" and start:
        earlier = stages_behind(find_policy(Path(start)))
    last = run / stage / "last"
    end = _training(last) if (last / CARD_FILE).exists() else training
    return [*earlier, StagePart(run, training, end["steps"], end["minutes"])]


def _shipped_stages(folder: Path, training: dict[str, Any]) -> list[StagePart]:
    """What a shipped policy's description tells of the stages behind it."""
    return [
        StagePart(folder, training | stage, stage["steps"], stage["minutes"], command)
        for stage, command in zip(training["stages"], training["commands"], strict=True)
    ]


def run_of(folder: Path) -> Path:
    """The run that a policy folder is in.

    Raises:
        InputError: it is in none.
    """
    for parent in folder.absolute().parents:
        if (parent / RECORD).exists():
            return parent
    raise InputError("is not inside a run, so nothing tells how it was trained", folder)


def _training(folder: Path) -> dict[str, Any]:
    training = read_card(folder).get("training") or {}
    missing = [key for key in RECORDED if key not in training]
    if missing:
        raise InputError(f"does not tell the {missing[0]} of its training", folder / CARD_FILE)
    return training


def commands(parts: list[StagePart]) -> list[str]:
    """The command lines that train alike, one a stage.

    A run is called ``runs/NAME``, whatever its folder was; another run's teacher is in
    ``runs/TEACHER``.
    """
    own, lines, begun = parts[-1].run, [], set()
    for part in parts:
        if part.command is not None:
            lines.append(part.command)
            continue
        stage, run = part.training["stage"], part.run
        words = ["--stage", stage, "--minutes", str(ceil(part.minutes))]
        words += ["--out", "runs/NAME" if run == own else "runs/TEACHER"]
        if run == own and parts[0].run != own and stage == "student":
            words += ["--teacher", _teacher_name(parts[0])]
        if run in begun:
            words.append("--resume")
        begun.add(run)
        lines.append(shlex.join(["python", "train.py", *options_of(read_run(run)["args"]), *words]))
    return lines


def _teacher_name(part: StagePart) -> str:
    return "runs/TEACHER" if part.command is None else part.run.name


def options_of(args: Mapping[str, Any]) -> list[str]:
    """The recorded options that are not the defaults, and always the preset and the motions."""
    words: list[str] = []
    for option in fields(TrainArgs):
        name = option.name
        if name in NOT_REPEATED or name not in args:
            continue
        value, default = args[name], None if option.default is MISSING else plain(option.default)
        if value == default and name not in ("motions", "preset"):
            continue
        words.append("--" + name.replace("_", "-"))
        if not isinstance(value, bool):
            words += map(str, value if isinstance(value, list) else [value])
    return words
