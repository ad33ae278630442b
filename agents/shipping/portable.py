"""Names that cards give to the files of a training: no path of its machine, no name twice."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

from questsim.errors import InputError
from questsim.motion.naming import split_parts

NAME_FILES = ("motions", "estimates", "validation", "start_estimates", "body")
"""Options that may name files of the machine of the training."""


def names_for_cards(
    texts: Iterable[str], called: Mapping[str, str] | None = None
) -> dict[str, str]:
    """The names that cards give to files of the machine of a training, by absolute path.

    A file becomes ``runs/`` and its own name; a second file of that name gets a number.

    Args:
        texts: all motion arguments of the training.
        called: names of the user's choice, by absolute path.

    Raises:
        InputError: ``called`` has a file that the training does not have.
    """
    files = [_file_of(part)[0] for text in texts for part in split_parts(text)]
    names = dict(called or {})
    for file in names:
        if file not in files:
            known = ", ".join(sorted({f for f in files if Path(f).is_absolute()})) or "none"
            raise InputError("is no file of the training", file, f"it has {known}")
    taken = {file for file in files if not Path(file).is_absolute()} | {*names.values()}
    for file in dict.fromkeys(files):
        if Path(file).is_absolute() and file not in names:
            names[file] = free_name(f"runs/{Path(file).stem}", taken, Path(file).suffix)
            taken.add(names[file])
    return names


def _file_of(part: str) -> tuple[str, str]:
    """The file and the rest of a part of a motion argument, such as ``("a.toml", ":train")``."""
    file, colon, split = part.partition(":")
    return file, colon + split


def portable(motions: str, names: Mapping[str, str]) -> str:
    """A motion argument with the names of ``names_for_cards`` instead of absolute paths."""
    parts = [_file_of(part) for part in split_parts(motions)]
    return ",".join(names.get(file, file) + rest for file, rest in parts)


def nameable(motions: str) -> str:
    """A motion argument alone, as cards name it."""
    return portable(motions, names_for_cards([motions]))


def texts_of_files(args: Mapping[str, Any]) -> list[str]:
    """The options of a run that may name files."""
    return [args[name] for name in NAME_FILES if args.get(name) is not None]


def free_name(name: str, taken: Collection[str], ending: str = "") -> str:
    """The name of a run or file, with a number if another one has it."""
    number, found = 2, name + ending
    while found in taken:
        number, found = number + 1, f"{name}-{number}{ending}"
    return found
