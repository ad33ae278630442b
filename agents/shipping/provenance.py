"""Provenance of a policy: the runs and stages behind it, their time and their data."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import ceil
from pathlib import Path
from typing import Any

from agents.licence import strictest
from agents.policy.checkpoint import CARD_FILE, find_policy, find_teacher, read_card
from agents.run_folder import RECORD, default_of, plain, read_run
from agents.training.options import TrainArgs
from questsim.errors import InputError
from questsim.motion.naming import split_parts

STAGES = ("teacher", "student", "finetune")
"""In the order in which they build on each other; the paper's ``ppo`` stands alone."""

RECORDED = ("stage", "steps", "minutes", "motions", "licences", "seed", "clips", "seconds")
"""What the ``training`` of a policy must tell, as every training writes it."""

NOT_REPEATED = ("out", "stage", "minutes", "steps", "resume", "teacher", "start", "threads")
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
        ``motions``, the policy's own last; ``ground`` it learnt on, ``flat`` if none is named,
        and whether it was ``pushed``; ``licence`` of the weights, from the motions of all
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
                "motions": portable(part.training["motions"]),
            }
            for part in parts
        ],
        "ground": read_run(parts[-1].run)["args"].get("env") or "flat",
        "pushed": read_run(parts[-1].run)["args"].get("pushes") is not None,
        "objects": read_run(parts[-1].run)["args"].get("objects") or [],
        "shown_estimates": read_run(parts[-1].run)["args"].get("estimates") is not None,
        "licence": strictest(name for part in parts for name in part.training["licences"]),
        "versions": read_run(parts[-1].run)["versions"],
    }


def portable(motions: str) -> str:
    """A motion argument with files called by name, in ``runs/``, wherever they were."""
    parts = split_parts(motions)
    return ",".join(f"runs/{Path(p).name}" if Path(p).is_absolute() else p for p in parts)


def stages_behind(folder: Path) -> list[StagePart]:
    """The stages that led to a policy, its own last.

    Raises:
        InputError: see ``provenance``.
    """
    return _stages(folder, _training(folder))


def _stages(folder: Path, training: dict[str, Any]) -> list[StagePart]:
    """As ``stages_behind``, of a policy that was so described."""
    if "stages" in training:
        return _shipped_stages(folder, training)
    run = run_of(folder)
    stage, record = training["stage"], read_run(run)
    start = _origin(record, stage, "start")
    before: list[tuple[Path, dict[str, Any]]] = []
    if stage == "student":
        own = (
            find_teacher(run / "teacher") if not recorded_option(record, stage, "teacher") else None
        )
        taught = (own, _training(own)) if own else _origin(record, stage, "teacher")
        assert taught is not None
        before.append(taught)
    if start:
        before.append(start)
    elif stage == "finetune":
        before.append((student := find_policy(run / "student"), _training(student)))
    earlier: list[StagePart] = []
    for policy, told in before:
        earlier = _joined(earlier, _stages(policy, told))
    last = run / stage / "last"
    end = _training(last) if (last / CARD_FILE).exists() else training
    return [*earlier, StagePart(run, training, end["steps"], end["minutes"])]


def _origin(
    record: Mapping[str, Any], stage: str, option: str
) -> tuple[Path, dict[str, Any]] | None:
    """The policy that an option of a run named, and how it was described then."""
    entry = _entry_with(record, stage, option)
    if entry is None:
        return None
    name = entry["args"][option]
    teacher = option == "teacher" or stage == "teacher"
    folder = find_teacher(name) if teacher else find_policy(name)
    return folder, entry.get("behind", {}).get(option) or _training(folder)


def recorded_option(record: Mapping[str, Any], stage: str, option: str) -> Any:
    """What an option of a run was when ``stage`` was begun.

    Args:
        record: of the run, with what it was resumed with.
        stage: a stage; ``--stage all`` begins with the teacher.
        option: ``start``, which counts only for the first stage of a command, or ``teacher``.
    """
    entry = _entry_with(record, stage, option)
    return None if entry is None else entry["args"][option]


def _entry_with(record: Mapping[str, Any], stage: str, option: str) -> Mapping[str, Any] | None:
    """The part of a record, begun or resumed, that has an option for a stage."""
    for entry in (record, *record.get("resumed", ())):
        args = entry["args"]
        mine = (stage, "all") if stage == "teacher" or option == "teacher" else (stage,)
        if args.get("stage") in mine and args.get(option):
            return entry
    return None


def _shipped_stages(folder: Path, training: dict[str, Any]) -> list[StagePart]:
    """What a shipped policy's description tells of the stages behind it.

    Its own run folder is called after it, since another run will be the ``runs/NAME`` of the card.
    """
    names = {"runs/NAME": f"runs/{folder.name}", "runs/TEACHER": f"runs/{folder.name}-teacher"}
    return [
        StagePart(
            folder,
            training | stage,
            stage["steps"],
            stage["minutes"],
            _renamed(command, names),
        )
        for stage, command in zip(training["stages"], training["commands"], strict=True)
    ]


def _joined(parts: list[StagePart], more: Sequence[StagePart]) -> list[StagePart]:
    """``parts`` and what ``more`` adds: two ways may lead to the same teacher.

    Two shipped policies tell of their common teacher each under its own run's name; the first
    name is kept.
    """
    parts, names = list(parts), dict[str, str]()
    for part in more:
        twin = next((known for known in parts if _is_same(known, part)), None)
        if twin is None:
            command = None if part.command is None else _renamed(part.command, names)
            parts.append(replace(part, command=command))
        elif part.command is not None and twin.command is not None:
            names[_out(part.command)] = _out(twin.command)
    return parts


def _is_same(a: StagePart, b: StagePart) -> bool:
    """Whether two descriptions are of one training."""
    if (a.command is None) != (b.command is None):
        return False
    if a.command is None and a.run != b.run:
        return False
    what = [
        (p.training["stage"], portable(p.training["motions"]), p.steps, p.minutes) for p in (a, b)
    ]
    return what[0] == what[1]


def _renamed(command: str, names: Mapping[str, str]) -> str:
    return shlex.join(names.get(word, word) for word in shlex.split(command))


def _out(command: str) -> str:
    words = shlex.split(command)
    return words[words.index("--out") + 1]


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


def commands(parts: Sequence[StagePart]) -> list[str]:
    """The command lines that train alike, one a stage.

    The run is called ``runs/NAME``, whatever its folder was; another run's teacher is in
    ``runs/TEACHER``; that of a shipped policy has its name.
    """
    names, lines, begun = _run_names(parts), [], set()
    for part in parts:
        if part.command is not None:
            lines.append(part.command)
            continue
        stage, run = part.training["stage"], part.run
        words = ["--stage", stage, "--minutes", str(ceil(part.minutes))]
        words += ["--out", names[run]]
        record = read_run(run)
        for option in ("teacher", "start") if stage == "student" else ("start",):
            if origin := _origin(record, stage, option):
                words += [f"--{option}", _run_name(*origin, names, parts)]
        if run in begun:
            words.append("--resume")
        begun.add(run)
        lines.append(shlex.join(["python", "train.py", *options_of(record["args"]), *words]))
    return lines


def _run_names(parts: Sequence[StagePart]) -> dict[Path, str]:
    """What command lines call each run folder; shipped policies' lines have their names already."""
    names = {parts[-1].run: "runs/NAME"}
    for part in reversed(parts):
        if part.command is not None:
            continue
        if part.training["stage"] == "teacher" and "runs/TEACHER" not in names.values():
            names.setdefault(part.run, "runs/TEACHER")
        else:
            names.setdefault(part.run, f"runs/{part.run.name}")
    return names


def _run_name(
    folder: Path,
    training: dict[str, Any],
    names: Mapping[Path, str],
    parts: Sequence[StagePart],
) -> str:
    """What command lines call the run of a policy, shipped or not."""
    if "stages" not in training:
        return names[run_of(folder)]
    own = _shipped_stages(folder, training)[-1]
    return next(_out(p.command) for p in parts if p.command is not None and _is_same(p, own))


def options_of(args: Mapping[str, Any], kind: type = TrainArgs) -> list[str]:
    """The recorded options that are not the defaults, and always the preset and the motions.

    Args:
        args: as a run's record has them.
        kind: the dataclass of options that they are of.
    """
    words: list[str] = []
    for option in fields(kind):
        name = option.name
        if name in NOT_REPEATED or name not in args:
            continue
        value, default = args[name], plain(default_of(option))
        if isinstance(value, dict):
            for inner, number in value.items():
                if number != default[inner]:
                    words += _words(f"{name}.{inner}", number)
        elif name in ("motions", "estimates") and value is not None:
            words += _words(name, portable(value))
        elif value != default or name == "preset":
            words += _words(name, value)
    return words


def _words(name: str, value: Any) -> list[str]:
    option = "--" + name.replace("_", "-")
    if isinstance(value, bool):
        return [option]
    return [option, *map(str, value if isinstance(value, list) else [value])]
