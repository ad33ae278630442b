"""Mixture files: training and validation sets chosen from several sources, in one TOML file."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from questsim.errors import InputError
from questsim.files import read_toml
from questsim.motion.clip import Clip
from questsim.motion.motion import Motion

T = TypeVar("T", Clip, Motion)
SUFFIX = ".toml"


@dataclass(frozen=True)
class MixtureEntry:
    """One source of a part, ``[[PART]]`` in the file.

    Attributes:
        motions: a motion argument; files and folders are relative to the mixture file.
        include: only clips whose name fits one of these patterns, such as ``"*walk*"``.
        exclude: no clips whose name fits one of these patterns.
        exclude_list: a text file of names, one a line, that are left out.
        longest_s: no clips longer than this.
        count: draw this many of the clips that are left.
        seed: of the drawing and of synthetic motions; by default that of the command.
        kind: the clips' kind of motion, by which ``--vary`` and ``sampling=kind`` balance. It may
            use ``{kind}``, ``{style}`` and ``{name}`` (without the numbers at its end).
        licence: the licence of clips whose source states none, as an SPDX identifier.
    """

    motions: str
    include: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    exclude_list: str = ""
    longest_s: float = 0.0
    count: int = 0
    seed: int | None = None
    kind: str = ""
    licence: str = ""


_TYPES: dict[str, type | tuple[type, ...]] = {
    "motions": str,
    "include": list,
    "exclude": list,
    "exclude_list": str,
    "longest_s": (int, float),
    "count": int,
    "seed": int,
    "kind": str,
    "licence": str,
}


def is_mixture(part: str) -> bool:
    """Whether a part of a motion argument is ``FILE.toml`` or ``FILE.toml:PART``."""
    return _split(part) is not None


def load_mixture(
    part: str, load: Callable[[str, int], list[T]], seed: int
) -> list[tuple[str, list[T]]]:
    """The clips or motions of one part of a mixture file, for each of its entries.

    A clip that an earlier part of the file takes is left out of the later ones, so that training
    and validation never share a clip.

    Args:
        part: ``FILE.toml:PART``, or ``FILE.toml`` if it has one part only.
        load: loads a motion argument with a seed.
        seed: of entries without one.

    Raises:
        InputError: the file or the part cannot be used, or an entry yields no clip.
    """
    path, wanted = _split(part) or (Path(part), "")
    parts = read_mixture(path)
    if not wanted and len(parts) > 1:
        raise InputError("has several parts", path, f"write {path}:{next(iter(parts))}")
    wanted = wanted or next(iter(parts))
    if wanted not in parts:
        raise InputError(f"there is no part {wanted!r}", path, f"it has {', '.join(parts)}")
    taken: set[tuple[str, ...]] = set()
    for name, entries in parts.items():
        chosen = []
        for number, entry in enumerate(entries, 1):
            where = f"[[{name}]] number {number}"
            chosen.append((entry.motions, _choose(entry, path, where, load, seed, taken)))
        if name == wanted:
            return chosen
        taken |= {_key(motion, s) for s, motion in _with_seeds(entries, chosen, seed)}
    raise AssertionError("unreachable")


def _with_seeds(
    entries: Sequence[MixtureEntry], chosen: Sequence[tuple[str, list[T]]], seed: int
) -> Iterator[tuple[int, T]]:
    for entry, (_, members) in zip(entries, chosen, strict=True):
        for motion in members:
            yield seed if entry.seed is None else entry.seed, motion


def _key(motion: Clip | Motion, seed: int) -> tuple[str, ...]:
    """Identifies a clip: its source's content, or for synthetic ones the seed."""
    return motion.source_sha256 or f"seed {seed}", motion.name


def _choose(
    entry: MixtureEntry,
    path: Path,
    where: str,
    load: Callable[[str, int], list[T]],
    seed: int,
    taken: set[tuple[str, ...]],
) -> list[T]:
    seed = seed if entry.seed is None else entry.seed
    found = load(entry.motions, seed)
    listed = _listed(entry, path, where)
    names = {motion.name for motion in found}
    for pattern in (*entry.include, *entry.exclude):
        # A file that could not be read has no clip, but may well be excluded.
        known = names if pattern in entry.include else names | _stems(entry.motions)
        if not any(fnmatchcase(name, pattern) for name in known):
            raise InputError(f"no clip fits {pattern!r}", f"{path}: {where}", _names(found))
    out = [
        motion
        for motion in found
        if _key(motion, seed) not in taken
        and motion.name not in listed
        and (not entry.include or any(fnmatchcase(motion.name, p) for p in entry.include))
        and not any(fnmatchcase(motion.name, p) for p in entry.exclude)
        and (not entry.longest_s or motion.duration <= entry.longest_s)
    ]
    if entry.count:
        if entry.count > len(out):
            raise InputError(f"count is {entry.count} of {len(out)} clips", f"{path}: {where}")
        drawn = np.random.default_rng(seed).choice(len(out), entry.count, replace=False)
        out = [out[i] for i in sorted(drawn)]
    if not out:
        raise InputError("no clip is left", f"{path}: {where}", "check its include and exclude")
    if entry.kind:
        out = [replace(motion, kind=_kind(entry.kind, motion)) for motion in out]
    if entry.licence:
        _check_licence(out, entry.licence, f"{path}: {where}")
        out = [replace(motion, licence=entry.licence) for motion in out]
    return out


def _check_licence(found: Sequence[Clip | Motion], licence: str, where: str) -> None:
    """Refuse to replace another licence that a source states."""
    for motion in found:
        if motion.licence not in ("", licence):
            what = f"licence is {licence}, but that of {motion.name} is {motion.licence}"
            raise InputError(what, where, "leave out the key licence")


def _kind(pattern: str, motion: Clip | Motion) -> str:
    stem = re.sub(r"[\W\d_]+$", "", motion.name) or motion.name
    return pattern.format(kind=motion.kind, style=motion.style, name=stem)


def _stems(motions: str) -> set[str]:
    """Names of the files and of the folders' files that a motion argument names."""
    places = [Path(piece.strip()) for piece in motions.split(",")]
    files = [file for place in places if place.is_dir() for file in place.rglob("*")]
    return {file.stem for file in (*places, *files) if file.is_file()}


def _names(found: Sequence[Clip | Motion]) -> str:
    return f"its clips are named like {', '.join(m.name for m in found[:3])}"


def _listed(entry: MixtureEntry, path: Path, where: str) -> set[str]:
    if not entry.exclude_list:
        return set()
    file = path.parent / entry.exclude_list
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8"
        raise InputError(
            f"exclude_list {file} cannot be read ({reason})", f"{path}: {where}"
        ) from None
    return {line.strip() for line in lines if line.strip()}


def read_mixture(path: Path) -> dict[str, list[MixtureEntry]]:
    """The parts of a mixture file and their entries, in the file's order.

    Raises:
        InputError: the file cannot be read, or a key or value is not one of ``MixtureEntry``'s.
    """
    table = read_toml(path, "mixture file")
    for name, entries in table.items():
        if not isinstance(entries, list) or not all(isinstance(e, dict) for e in entries):
            raise InputError(
                f"{name[:80]!r} is not a list of tables", path, f"write [[{name[:80]}]]"
            )
    if not table:
        raise InputError("has no part", path, "write [[train]] and a line motions = ...")
    return {
        name: [_entry(e, path, f"[[{name}]] number {n}") for n, e in enumerate(entries, 1)]
        for name, entries in table.items()
    }


def _entry(table: dict[str, Any], path: Path, where: str) -> MixtureEntry:
    place, known = f"{path}: {where}", [field.name for field in fields(MixtureEntry)]
    for key, value in table.items():
        if key not in known:
            near = difflib.get_close_matches(key, known, 1)
            hint = f" (did you mean {near[0]}?)" if near else ""
            raise InputError(f"unknown key {key[:80]!r}{hint}", place, f"keys: {', '.join(known)}")
        if not isinstance(value, _TYPES[key]) or isinstance(value, bool):
            raise InputError(f"the value of {key} is of the wrong type", place)
        if isinstance(value, list) and not all(isinstance(text, str) for text in value):
            raise InputError(f"{key} is not a list of texts", place)
        if isinstance(value, int | float) and not 0 <= value < 1e9:
            raise InputError(f"{key} is {value}, not a number from 0", place)
    if not table.get("motions"):
        raise InputError("has no motions", place, 'write motions = "bandai-namco-2:train"')
    if any(is_mixture(piece.strip()) for piece in table["motions"].split(",")):
        raise InputError("motions names a mixture file", place, "write its entries here")
    try:
        str(table.get("kind", "")).format(kind="", style="", name="")
    except (KeyError, ValueError, IndexError, AttributeError):
        raise InputError(
            f"kind is {table['kind']!r}", place, "use {kind}, {style}, {name}"
        ) from None
    motions = ",".join(_beside(path, piece) for piece in table["motions"].split(","))
    values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in table.items()}
    values["motions"] = motions
    return MixtureEntry(**values)


def _beside(path: Path, piece: str) -> str:
    """A file or folder beside the mixture file, or the piece as it is."""
    beside = path.parent / piece.strip()
    return str(beside) if beside.exists() else piece.strip()


def _split(part: str) -> tuple[Path, str] | None:
    if part.lower().endswith(SUFFIX):
        return Path(part), ""
    file, colon, name = part.rpartition(":")
    return (Path(file), name) if colon and file.lower().endswith(SUFFIX) else None
