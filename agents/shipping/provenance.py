"""Provenance of a policy: its runs and stages, with their time and data."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import ceil
from pathlib import Path
from typing import Any

from agents.licence import strictest
from agents.policy.checkpoint import CARD_FILE, find_policy, find_teacher, read_card
from agents.resolve import policy_folder
from agents.run_folder import RECORD, default_of, plain, read_run
from agents.shipping.portable import (
    NAME_FILES,
    free_name,
    names_for_cards,
    portable,
    texts_of_files,
)
from agents.training.options import TrainArgs
from agents.training.specialists import read_specialist
from questsim.errors import InputError

RECORDED = ("stage", "steps", "minutes", "motions", "licences", "seed", "clips", "seconds")
"""Required keys of a policy's ``training``, which every training writes."""

NOT_REPEATED = (
    "out",
    "stage",
    "minutes",
    "steps",
    "resume",
    "teacher",
    "specialists",
    "start",
    "threads",
)
"""Options that the printed commands set themselves, or that do not affect learning."""

_NAMING = {f"--{name.replace('_', '-')}" for name in NAME_FILES} | {
    "--out", "--start", "--teacher", "--specialists",
}  # fmt: skip
"""Options whose values name files or runs."""


@dataclass(frozen=True)
class StagePart:
    """One training stage of a policy.

    Attributes:
        run: the run folder, or the folder of a shipped policy.
        training: ``training`` of the stage's policy.
        steps, minutes: totals of the stage; its best policy may be earlier.
        command: the training command, if there is no run to derive it from.
    """

    run: Path
    training: dict[str, Any]
    steps: int
    minutes: float
    command: str | None = None


def provenance(folder: Path, called: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Training information for a model card of a run's policy.

    Args:
        folder: the policy's folder, inside its run.
        called: see ``names_for_cards``.

    Returns:
        ``commands``, one per stage; ``stages``, each with ``stage``, ``steps``, ``minutes``,
        ``motions`` and, if a resume named another one, ``teachers``, the policy's own last;
        ``ground`` of the training, ``flat`` by default; whether it was ``pushed``; ``licence`` of
        the weights, from the motions of all stages; ``versions`` of the packages.

    Raises:
        InputError: the policy is not inside a run, an earlier stage is missing, or no stage has a
            file of ``called``.
    """
    parts = stages_behind(folder)
    names = _names_of_files(parts, called)
    lines = commands(parts, called)
    # A card and a run folder may describe the same training: as lines they are alike.
    spoken = [replace(part, command=line) for part, line in zip(parts, lines, strict=True)]
    once, renamed = _merged([], spoken)
    taught = {id(part.training): _several_teachers(part, parts, renamed) for part in parts}
    return {
        "commands": [part.command for part in once],
        "stages": [
            {
                "stage": part.training["stage"],
                "steps": part.steps,
                "minutes": part.minutes,
                "motions": portable(part.training["motions"], names),
            }
            | taught[id(part.training)]
            for part in once
        ],
        "ground": read_run(parts[-1].run)["args"].get("env") or "flat",
        "pushed": read_run(parts[-1].run)["args"].get("pushes") is not None,
        "objects": read_run(parts[-1].run)["args"].get("objects") or [],
        "shown_estimates": read_run(parts[-1].run)["args"].get("estimates") is not None,
        "device_faults": _has_device_faults(read_run(parts[-1].run)["args"]),
        "licence": strictest(name for part in parts for name in part.training["licences"]),
        "credits": sorted({c for part in parts for c in part.training.get("credits", ())}),
        "versions": read_run(parts[-1].run)["versions"],
    }


def _has_device_faults(args: Mapping[str, Any]) -> bool:
    """Whether a training had noise, mounting errors or jitter of the devices."""
    options = args.get("randomisation") or {}
    faults = ("noise_m", "noise_rad", "mount_m", "mount_rad", "latency_jitter_frames", "dropout")
    return any(max(options.get(name, (0.0,))) > 0 for name in faults)


def stages_behind(folder: Path) -> list[StagePart]:
    """The stages of a policy's training, its own last.

    Raises:
        InputError: see ``provenance``.
    """
    return _stages(folder, _training(folder))


def _stages(folder: Path, training: dict[str, Any]) -> list[StagePart]:
    """Like ``stages_behind``, for a policy with this description."""
    if "stages" in training:
        return _shipped_stages(folder, training)
    run = run_of(folder)
    stage, record = training["stage"], read_run(run)
    start = _start(record, stage)
    before: list[Origin] = []
    if stage == "student":
        special = [origin for _, origin in _specialists(record)]
        before += [*special, *_teachers(run, record)]
    if start:
        before.append(start)
    elif stage == "finetune":
        before.append((student := find_policy(run / "student"), _training(student)))
    earlier: list[StagePart] = []
    for policy, record in before:
        earlier = _joined(earlier, _stages(policy, record))
    last = run / stage / "last"
    end = _training(last) if (last / CARD_FILE).exists() else training
    return [*earlier, StagePart(run, training, end["steps"], end["minutes"])]


Origin = tuple[Path, dict[str, Any]]
"""The folder of a policy on which a stage builds, and its description at that time."""


def _commands_of(record: Mapping[str, Any], *stages: str) -> list[Mapping[str, Any]]:
    """The parts of a run's record, initial and resumed, whose ``--stage`` is one of ``stages``."""
    entries = (record, *record.get("resumed", ()))
    return [entry for entry in entries if entry["args"].get("stage") in stages]


def _start(record: Mapping[str, Any], stage: str) -> Origin | None:
    """The policy of ``--start``, which applies to the first stage of a command when it begins."""
    first = ("teacher", "all") if stage == "teacher" else (stage,)
    for entry in _commands_of(record, *first):
        if name := entry["args"].get("start"):
            folder = find_teacher(name) if stage == "teacher" else find_policy(name)
            return folder, _behind(entry, "start", folder)
    return None


def _teachers(run: Path, record: Mapping[str, Any]) -> list[Origin]:
    """The teachers of a run's student, in their order: a resume may name another one."""
    found: list[Origin] = []
    named = any(entry["args"].get("teacher") for entry in _commands_of(record, "student"))
    for entry in _commands_of(record, "student", "all"):
        name = entry["args"].get("teacher")
        if name is None and named and policy_folder(run / "teacher") is None:
            continue  # it was stopped before there was a teacher
        folder = find_teacher(name or run / "teacher").absolute()
        origin = folder, _behind(entry, "teacher", folder)
        if origin not in found:
            found.append(origin)
    return found


def _specialists(record: Mapping[str, Any]) -> list[tuple[str, Origin]]:
    """The specialists of a run's student: the text of the option, and the policy."""
    found: dict[str, Origin] = {}
    for entry in _commands_of(record, "student", "all"):
        for text in entry["args"].get("specialists") or ():
            folder = find_teacher(read_specialist(text).where)
            found.setdefault(text, (folder, _behind(entry, text, folder)))
    return list(found.items())


def _behind(entry: Mapping[str, Any], option: str, folder: Path) -> dict[str, Any]:
    return entry.get("behind", {}).get(option) or _training(folder)


def _several_teachers(
    part: StagePart, parts: Sequence[StagePart], renamed: Mapping[str, str]
) -> dict[str, list[str]]:
    """``teachers`` of a student that learned from one after the other, by name; else empty."""
    if part.command is not None or part.training["stage"] != "student":
        return {}
    names = _run_names(parts)
    teachers = _teachers(part.run, read_run(part.run))
    found = [_run_name(*origin, names, parts) for origin in teachers]
    texts = [renamed.get(name, name) for name in found]
    return {"teachers": texts} if len(texts) > 1 else {}


def _shipped_stages(folder: Path, training: dict[str, Any]) -> list[StagePart]:
    """The stages recorded in a shipped policy's description, its own last.

    Its run folder gets the policy's name, since ``runs/NAME`` of the card is another run.
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
    """``parts`` extended by ``more``, without duplicates: both may include the same teacher.

    Two shipped policies may record their common teacher under different run names; the first name
    is kept. Two runs of one name in two of them get different ones.
    """
    return _merged(parts, more)[0]


def _merged(
    parts: list[StagePart], more: Sequence[StagePart]
) -> tuple[list[StagePart], dict[str, str]]:
    """See ``_joined``; and the new names of runs of ``more``."""
    parts, names = list(parts), dict[str, str]()
    taken = {_out(part.command) for part in parts if part.command is not None}
    for part in more:
        twin = next((known for known in parts if _is_same(known, part)), None)
        if twin is None:
            if part.command is not None:
                names.setdefault(_out(part.command), free_name(_out(part.command), taken))
            command = None if part.command is None else _renamed(part.command, names)
            parts.append(replace(part, command=command))
        elif part.command is not None and twin.command is not None:
            names[_out(part.command)] = _out(twin.command)
    return parts, names


def _is_same(a: StagePart, b: StagePart) -> bool:
    """Whether two descriptions refer to the same training.

    Two cards may give its files and its run different names.
    """
    what = [(p.training["stage"], p.steps, p.minutes) for p in (a, b)]
    if what[0] != what[1]:
        return False
    if a.command is None or b.command is None:
        same = a.training["motions"] == b.training["motions"]
        return a.command is b.command and a.run == b.run and same
    return _unnamed(a.command) == _unnamed(b.command)


def _unnamed(command: str) -> list[str]:
    """The words of a command without the names of files and runs; their number remains."""
    words, option = [], ""
    for word in shlex.split(command):
        if word.startswith("--"):
            option = word
        elif option in _NAMING:
            word = "+" * word.count(",")
        words.append(word)
    return words


def _renamed(command: str, names: Mapping[str, str]) -> str:
    """The command with other names of runs, also of specialists: ``runs/steps:side-*``."""

    def name(word: str) -> str:
        run, colon, kinds = word.rpartition(":")
        return names.get(word) or (f"{names[run]}{colon}{kinds}" if run in names else word)

    return shlex.join(name(word) for word in shlex.split(command))


def _out(command: str) -> str:
    words = shlex.split(command)
    return words[words.index("--out") + 1]


def run_of(folder: Path) -> Path:
    """The run folder that contains a policy folder.

    Raises:
        InputError: it is not inside a run.
    """
    for parent in folder.absolute().parents:
        if (parent / RECORD).exists():
            return parent
    raise InputError("is not inside a run folder, so its training is unknown", folder)


def _training(folder: Path) -> dict[str, Any]:
    training = read_card(folder).get("training") or {}
    missing = [key for key in RECORDED if key not in training]
    if missing:
        raise InputError(f"does not state the {missing[0]} of its training", folder / CARD_FILE)
    return training


def commands(parts: Sequence[StagePart], called: Mapping[str, str] | None = None) -> list[str]:
    """Command lines that repeat the training, one per stage.

    The run is called ``runs/NAME``, whatever its folder was; a teacher from another run is in
    ``runs/TEACHER``; a shipped teacher keeps its name. Of several teachers of one student the
    command names the last.
    """
    names, lines, begun = _run_names(parts), [], set()
    files = _names_of_files(parts, called)
    for part in parts:
        if part.command is not None:
            lines.append(part.command)
            continue
        stage, run = part.training["stage"], part.run
        words = ["--stage", stage, "--minutes", str(ceil(part.minutes))]
        words += ["--out", names[run]]
        record, student = read_run(run), stage == "student"
        last = _teachers(run, record)[-1] if student else None
        if last is not None and run / "teacher" not in (last[0], *last[0].parents):
            words += ["--teacher", _run_name(*last, names, parts)]
        if start := _start(record, stage):
            words += ["--start", _run_name(*start, names, parts)]
        if student and (special := _specialists(record)):
            words.append("--specialists")
            for text, origin in special:
                kinds = "+".join(read_specialist(text).kinds)
                named = _run_name(*origin, names, parts)  # not a path, whose slashes Windows turns
                words.append(f"{named}:{kinds}" if kinds else named)
        if run in begun:
            words.append("--resume")
        begun.add(run)
        lines.append(
            shlex.join(["python", "train.py", *options_of(record["args"], files=files), *words])
        )
    return lines


def _names_of_files(
    parts: Sequence[StagePart], called: Mapping[str, str] | None = None
) -> dict[str, str]:
    """See ``names_for_cards``: those of all stages."""
    texts: list[str] = []
    for part in parts:
        texts.append(part.training["motions"])
        if part.command is None:
            texts += texts_of_files(read_run(part.run)["args"])
        else:
            texts += shlex.split(part.command)
    return names_for_cards(texts, called)


def _run_names(parts: Sequence[StagePart]) -> dict[Path, str]:
    """Name of each run folder in command lines; lines of shipped policies already have theirs."""
    names = {parts[-1].run: "runs/NAME"}
    for part in reversed(parts):
        if part.command is not None:
            continue
        if part.training["stage"] == "teacher" and "runs/TEACHER" not in names.values():
            names.setdefault(part.run, "runs/TEACHER")
        elif part.run not in names:
            taken = {*names.values(), *(_out(p.command) for p in parts if p.command is not None)}
            names[part.run] = free_name(f"runs/{part.run.name}", taken)
    return names


def _run_name(
    folder: Path,
    training: dict[str, Any],
    names: Mapping[Path, str],
    parts: Sequence[StagePart],
) -> str:
    """Name of a policy's run in command lines, shipped or not."""
    if "stages" not in training:
        return names[run_of(folder)]
    own = _shipped_stages(folder, training)[-1]
    return next(_out(p.command) for p in parts if p.command is not None and _is_same(p, own))


def options_of(
    args: Mapping[str, Any], kind: type = TrainArgs, files: Mapping[str, str] | None = None
) -> list[str]:
    """Recorded options that differ from the defaults; preset and motions are always included.

    Args:
        args: options as in a run's record.
        kind: dataclass of these options.
        files: see ``names_for_cards``; by default those of these options.
    """
    files = names_for_cards(texts_of_files(args)) if files is None else files
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
        elif name in NAME_FILES and value is not None:
            words += _words(name, portable(value, files))
        elif value != default or name == "preset":
            words += _words(name, value)
    return words


def _words(name: str, value: Any) -> list[str]:
    option = "--" + name.replace("_", "-")
    if isinstance(value, bool):
        return [option]
    return [option, *map(str, value if isinstance(value, list) else [value])]
