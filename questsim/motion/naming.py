"""Names of motions that come from several places, and motion arguments with several parts."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from questsim.motion.clip import Clip
from questsim.motion.motion import Motion

_Named = TypeVar("_Named", Motion, Clip)
SYNTHETIC = "synthetic"
"""Embedded motions, as a part of a motion argument, or the part before its colon."""


def is_synthetic(part: str) -> bool:
    """Whether a part of a motion argument names embedded motions."""
    return part.partition(":")[0] == SYNTHETIC


def named(item: _Named, name: str) -> _Named:
    """A motion or clip under that name."""
    return item if item.name == name else replace(item, name=name)


def unique_names(stems: Sequence[str], folders: Sequence[tuple[str, ...]]) -> list[str]:
    """Unique names: equal ones are prefixed with as many folder names as needed.

    ``a/walk.bvh`` and ``b/walk.bvh`` become ``a-walk`` and ``b-walk``. Names that are still
    equal, e.g. of a file given twice, are numbered from the second on.

    Args:
        stems: the names.
        folders: the folders that each is in, outermost first.
    """
    groups: dict[str, list[int]] = defaultdict(list)
    for index, stem in enumerate(stems):
        groups[stem].append(index)
    names = list(stems)
    for group in groups.values():
        if len({folders[index] for index in group}) > 1:
            depth = _telling_depth([folders[index] for index in group])
            for index in group:
                names[index] = "-".join((*folders[index][-depth:], stems[index]))
    return numbered(names)


def _telling_depth(folders: Sequence[tuple[str, ...]]) -> int:
    """How many of the innermost folders distinguish as many paths as all folders do."""
    places = len(set(folders))
    deepest = max(map(len, folders))
    return next(
        depth for depth in range(1, deepest + 1) if len({f[-depth:] for f in folders}) == places
    )


def numbered(names: Sequence[str]) -> list[str]:
    """The names; repeated ones are numbered from 2 on."""
    taken, given = set(names), set[str]()
    out = []
    for name in names:
        fresh, count = name, 1
        while fresh in given or (count > 1 and fresh in taken):
            count += 1
            fresh = f"{name}-{count}"
        given.add(fresh)
        out.append(fresh)
    return out


def file_names(files: Sequence[Path]) -> list[str]:
    """The names of motions read from files: their stems, made unique."""
    places = [Path(os.path.abspath(file)).parent.parts[1:] for file in files]
    return unique_names([file.stem for file in files], places)


def place(part: str) -> tuple[str, ...]:
    """Folder names that distinguish one part of a motion argument from the others."""
    if not os.path.exists(part):  # a data set, or synthetic
        return (part.replace(":", "-"),)
    path = Path(os.path.abspath(part))
    if path.is_dir():
        return path.parts[1:]
    if path.suffix.lower() in (".npz", ".zip"):  # a library, or as good as a folder
        return path.with_suffix("").parts[1:]
    return path.parent.parts[1:]


def split_parts(spec: str | Sequence[str]) -> list[str]:
    """The parts of a motion argument: split at commas, but not inside the path of a file.

    Pieces that, joined by commas, are an existing path form one part; the longest such path
    wins.
    """
    parts: list[str] = []
    for entry in [spec] if isinstance(spec, str) else spec:
        pieces = str(entry).split(",")
        while pieces:
            taken = next((n for n in range(len(pieces), 1, -1) if _is_path(pieces[:n])), 1)
            parts.append(",".join(pieces[:taken]).strip())
            pieces = pieces[taken:]
    return [part for part in parts if part]


def _is_path(pieces: Sequence[str]) -> bool:
    # A leading or trailing comma means a list with a gap, not a path.
    return bool(pieces[0].strip()) and os.path.exists(",".join(pieces).strip())
