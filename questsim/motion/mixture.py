"""Mixture files: training and validation sets chosen from several sources, in one TOML file."""

from __future__ import annotations

import difflib
import hashlib
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from questsim.errors import InputError, value_text
from questsim.files import read_toml
from questsim.motion.clip import Clip
from questsim.motion.motion import Motion
from questsim.motion.naming import is_synthetic

T = TypeVar("T", Clip, Motion)
SUFFIX = ".toml"
MAX_WEIGHT = 1000.0


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
            use ``{kind}``, ``{style}`` and ``{name}`` (without the numbers at its end). With
            ``{kind}``, variations stay variations: ``mine-walk+crouch`` of ``mine-{kind}``.
        licence: the licence of clips whose source states none, as an SPDX identifier.
        weight: trainings draw the clips so many times as often as without it, also where they draw
            by kind.
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
    weight: float = 1.0

    @property
    def reads_seed(self) -> bool:
        """Whether other seeds give other clips."""
        return self.count > 0 or any(map(is_synthetic, _pieces(self.motions)))


_TEXT, _TEXTS, _WHOLE = "a text", "a list of texts", "a whole number"
_TYPES: dict[str, tuple[str, type | tuple[type, ...]]] = {
    "motions": (_TEXT, str),
    "include": (_TEXTS, list),
    "exclude": (_TEXTS, list),
    "exclude_list": (_TEXT, str),
    "longest_s": ("a number", (int, float)),
    "count": (_WHOLE, int),
    "seed": (_WHOLE, int),
    "kind": (_TEXT, str),
    "licence": (_TEXT, str),
    "weight": ("a number", (int, float)),
}
_FIELD = re.compile(r"\{(kind|style|name)\}")


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
        load: loads a motion argument with a seed; an ``InputError`` gets the entry's place.
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
    taken: set[object] = set()
    for name, entries in parts.items():
        chosen = []
        for number, entry in enumerate(entries, 1):
            where = f"[[{name}]] number {number}"
            chosen.append((entry.motions, _choose(entry, path, where, load, seed, taken)))
        if name == wanted:
            return chosen
        taken.update(*(_keys(motion, s) for s, motion in _with_seeds(entries, chosen, seed)))
    raise AssertionError("unreachable")


def _with_seeds(
    entries: Sequence[MixtureEntry], chosen: Sequence[tuple[str, list[T]]], seed: int
) -> Iterator[tuple[int, T]]:
    for entry, (_, members) in zip(entries, chosen, strict=True):
        for motion in members:
            yield seed if entry.seed is None else entry.seed, motion


def _keys(motion: Clip | Motion, seed: int) -> set[object]:
    """Each identifies a clip: its frames, and its name in its source.

    Frames alone do not: a library rounds embedded motions, and a file may be imported in two ways.
    Names alone do not: two libraries of chains may have the same ones.
    """
    numbers = motion.qpos if isinstance(motion, Clip) else motion.rotations
    root = numbers if isinstance(motion, Clip) else motion.root_position
    digest = hashlib.sha256(root.astype(np.float32).tobytes())
    digest.update(numbers.astype(np.float32).tobytes())
    source = motion.source_sha256 or f"seed {seed}, {motion.source}"
    return {digest.digest(), (source, motion.name)}


def mixture_reads_seed(part: str) -> bool:
    """Whether the clips of a part of a mixture file depend on the seed of the command.

    Raises:
        InputError: as ``read_mixture``.
    """
    path, wanted = _split(part) or (Path(part), "")
    parts = read_mixture(path)
    entries = parts.get(wanted, []) if wanted else next(iter(parts.values()))
    return any(entry.seed is None and entry.reads_seed for entry in entries)


def mixture_sources(part: str) -> list[str]:
    """The motion arguments of all entries of a mixture file.

    Raises:
        InputError: as ``read_mixture``.
    """
    path, _ = _split(part) or (Path(part), "")
    return [entry.motions for entries in read_mixture(path).values() for entry in entries]


def _choose(
    entry: MixtureEntry,
    path: Path,
    where: str,
    load: Callable[[str, int], list[T]],
    seed: int,
    taken: set[object],
) -> list[T]:
    seed = seed if entry.seed is None else entry.seed
    try:
        found = load(entry.motions, seed)
    except InputError as error:
        inner = f": {error.where}" if error.where is not None else ""
        raise InputError(error.what, f"{path}: {where}{inner}", error.fix) from None
    names = {motion.name for motion in found}
    listed = _listed(entry, path, where, names)
    for pattern in (*entry.include, *entry.exclude):
        # A file that could not be read has no clip, but may well be excluded.
        known = names if pattern in entry.include else names | _stems(entry.motions)
        if not any(fnmatchcase(name, pattern) for name in known):
            raise InputError(f"no clip fits {pattern!r}", f"{path}: {where}", _names(found))
    fresh = [motion for motion in found if not taken & _keys(motion, seed)]
    if found and not fresh:
        what = "an earlier part of the file takes all of its clips"
        raise InputError(what, f"{path}: {where}", "name others, or let count leave some")
    out = [
        motion
        for motion in fresh
        if motion.name not in listed
        and (not entry.include or any(fnmatchcase(motion.name, p) for p in entry.include))
        and not any(fnmatchcase(motion.name, p) for p in entry.exclude)
        and (not entry.longest_s or motion.duration <= entry.longest_s)
    ]
    if entry.count:
        if entry.count > len(out):
            what = f"count is {entry.count} of {len(out)} clips"
            raise InputError(what, f"{path}: {where}", f"draw at most {len(out)}")
        drawn = np.random.default_rng(seed).choice(len(out), entry.count, replace=False)
        out = [out[i] for i in sorted(drawn)]
    if not out:
        fix = "check its include, exclude and longest_s"
        raise InputError("no clip is left", f"{path}: {where}", fix)
    if entry.kind:
        out = [
            replace(motion, kind=_kind(entry.kind, motion, f"{path}: {where}")) for motion in out
        ]
    if entry.weight != 1.0:
        out = [replace(motion, weight=entry.weight) for motion in out]
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


def _kind(pattern: str, motion: Clip | Motion, where: str) -> str:
    """The kind that an entry gives to a motion.

    Raises:
        InputError: it hides that the motion needs a chair.
    """
    from questsim.motion.synthesis.wish import SEATED

    stem = re.sub(r"[\W\d_]+$", "", motion.name) or motion.name
    kind, plus, changes = motion.kind.partition("+")
    fields = {"kind": kind, "style": motion.style, "name": stem}
    # A plus in a name would make it a variation.
    given = _FIELD.sub(lambda found: fields[found[1]].replace("+", "-"), pattern)
    if motion.kind in SEATED and given not in SEATED:
        what = f"kind is {given!r}, but {motion.name} needs a chair, which its kind stands for"
        raise InputError(what, where, f"leave out the key kind, or write {motion.kind!r}")
    return given + plus + changes if "{kind}" in pattern else given


def _stems(motions: str) -> set[str]:
    """Names of the files and of the folders' files that a motion argument names."""
    places = [Path(piece) for piece in _pieces(motions)]
    files = [file for place in places if place.is_dir() for file in place.rglob("*")]
    return {file.stem for file in (*places, *files) if file.is_file()}


def _names(found: Sequence[Clip | Motion]) -> str:
    return f"its clips are named like {', '.join(m.name for m in found[:3])}"


def _listed(entry: MixtureEntry, path: Path, where: str, names: set[str]) -> set[str]:
    """The names in ``exclude_list``, of which the entry has at least one."""
    if not entry.exclude_list:
        return set()
    file = path.parent / entry.exclude_list
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8"
        raise InputError(
            f"exclude_list {file} cannot be read ({reason})", f"{path}: {where}"
        ) from None
    listed = {line.strip() for line in lines if line.strip()}
    if not listed & (names | _stems(entry.motions)):
        what = f"none of the {len(listed)} names in {file} is one of its clips"
        fix = f"write names such as {min(names, default='walk')}, one a line, or leave the list out"
        raise InputError(what, f"{path}: {where}", fix)
    return listed


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
        if not entries:
            fix = f"write [[{name[:80]}]] and a line motions = ..."
            raise InputError(f"{name[:80]!r} has no entry", path, fix)
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
        _check_value(key, value, place)
    if "motions" not in table:
        raise InputError("has no motions", place, 'write motions = "bandai-namco-2:train"')
    if any(map(is_mixture, _pieces(table["motions"]))):
        raise InputError("motions names a mixture file", place, "write its entries here")
    values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in table.items()}
    values["motions"] = ",".join(_beside(path, piece) for piece in _pieces(table["motions"]))
    entry = MixtureEntry(**values)
    if entry.seed is not None and not entry.reads_seed:
        what = "seed has no effect: motions are neither embedded nor drawn by count"
        raise InputError(what, place, "leave it out")
    return entry


def _check_value(key: str, value: Any, place: str) -> None:
    """Refuse a value of another type, or one with which the key would do nothing."""
    says, types = _TYPES[key]
    texts = value if isinstance(value, list) else []
    wrong = not isinstance(value, types) or not all(isinstance(text, str) for text in texts)
    if wrong or isinstance(value, bool):
        raise InputError(f"{key} is {value_text(value)}, not {says}", place)
    if isinstance(value, int | float):
        least = 0 if key == "seed" else 1 if key == "count" else 1e-3
        most = MAX_WEIGHT if key == "weight" else 1e9
        if not least <= value <= most:
            what = f"{key} is {value}, not a number from {least:g} to {most:g}"
            raise InputError(what, place, "change it")
    elif not value or not all(text.strip() for text in texts or [value]):
        raise InputError(f"{key} is empty", place, "write something, or leave it out")
    if key == "kind" and set("{}+") & set(_FIELD.sub("", str(value))):
        fix = "use {kind}, {style} and {name}; a + is for variations alone"
        raise InputError(f"kind is {value_text(value)}", place, fix)


def _pieces(motions: str) -> list[str]:
    return [piece.strip() for piece in motions.split(",")]


def _beside(path: Path, piece: str) -> str:
    """A file or folder beside the mixture file, or the piece as it is."""
    beside = path.parent / piece
    return str(beside) if beside.exists() else piece


def _split(part: str) -> tuple[Path, str] | None:
    if part.lower().endswith(SUFFIX):
        return Path(part), ""
    file, colon, name = part.rpartition(":")
    return (Path(file), name) if colon and file.lower().endswith(SUFFIX) else None
