"""Loads the motions of a motion argument: dataset, library, file, folder or ``synthetic``."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

from filelock import FileLock

from questsim import rotations, skeleton
from questsim.assets import mjcf_path
from questsim.errors import InputError
from questsim.files import whole_file
from questsim.motion import datasets
from questsim.motion.clip import Clip
from questsim.motion.families import registered_families
from questsim.motion.library import VERSION, Library, is_library, load_library, save_library
from questsim.motion.many import Refused, Retargeted, named, read_many, say_skipped
from questsim.motion.mixture import is_mixture, load_mixture
from questsim.motion.motion import Motion
from questsim.motion.naming import file_names, place, split_parts, unique_names
from questsim.motion.reading import ReadOptions
from questsim.motion.sources import content_digest, motion_files

SYNTHETIC = "synthetic"
FILE = "<file>"
"""Placeholder for a skipped file's path in the cache."""
RANDOM, HELD_OUT = "random", "held-out"
RANDOM_COUNT = 100
"""Number of clips of ``synthetic:random`` and ``synthetic:held-out`` if not given."""

_T = TypeVar("_T", Motion, Clip)


def load_motions(
    spec: str | Sequence[str],
    *,
    height_m: float | None = None,
    mirrored: bool = False,
    seed: int = 0,
    strict: bool = False,
    own_proportions: bool = False,
) -> list[Clip]:
    """The avatar's clips that a motion argument names.

    Files are read and retargeted once; the result is kept in the cache. Unusable
    files in a folder or zip are skipped and named on stderr. Everything runs in this process,
    unless the caller allows more (``questsim.processes``).

    Args:
        spec: ``synthetic`` (or some of its kinds, ``synthetic:walk+bow``, or ``synthetic:all``,
            ``synthetic:random:500``, ``synthetic:held-out:40``), a dataset
            (``bandai-namco-2``, ``bandai-namco-2:train``, ``bandai-namco-2:test``), a library, a
            BVH or AMASS file, a folder of these, a part of a mixture file (``FILE.toml:PART``),
            or several, joined by commas or as a sequence; a file's or folder's own name may
            have commas.
        height_m: scale all clips to this stature; by default each keeps its performer's.
        mirrored: add a mirrored copy of each clip after the clip itself.
        seed: of the synthetic motions.
        strict: reject a folder that contains an unusable file.
        own_proportions: each clip's avatar has its performer's proportions, not only the stature.
            Such clips are retargeted anew in each call; synthetic ones are of the default body.

    Raises:
        InputError: nothing has this name, a dataset is not fetched, a file named directly
            is unusable, or all files of a folder are; a library has clips without motions, or a
            performer's body is none that the avatar can have, with ``own_proportions``.
    """
    from questsim.motion.retarget import mirror_clip

    def of(part: str, seed: int) -> list[Clip]:
        if is_mixture(part):
            return _with_unique_names(load_mixture(part, several, seed))
        if _is_synthetic(part):
            return _synthetic(part, seed)
        loaded = _load(part, not own_proportions, strict)
        return _in_proportion(part, loaded.motions) if own_proportions else loaded.clips

    def several(spec: str | Sequence[str], seed: int) -> list[Clip]:
        return _with_unique_names([(part, of(part, seed)) for part in _parts(spec)])

    clips = several(spec, seed)
    if height_m is not None:
        clips = [clip.scaled(height_m) for clip in clips]
    if mirrored:
        clips = [copy for clip in clips for copy in (clip, mirror_clip(clip))]
    return clips


def _in_proportion(part: str, motions: Sequence[Motion]) -> list[Clip]:
    from questsim.motion.retarget import to_clip

    if not motions:
        what = "has no motions, whose bodies could be measured"
        raise InputError(what, part, "import the files again with this version")
    return [to_clip(motion, own_proportions=True) for motion in motions]


def load_recordings(
    spec: str | Sequence[str], *, mirrored: bool = False, seed: int = 0, strict: bool = False
) -> list[Motion]:
    """Like ``load_motions``, but motions on the 22-joint skeleton, as recorded or generated.

    Args:
        spec: as in ``load_motions``.
        mirrored: add a mirrored copy of each motion after the motion itself.
        seed: of the synthetic motions.
        strict: as in ``load_motions``.

    Raises:
        InputError: as ``load_motions``.
    """
    from questsim.motion.retarget_back import to_motion

    def of(part: str, seed: int) -> list[Motion]:
        if is_mixture(part):
            return _with_unique_names(load_mixture(part, several, seed))
        if _is_synthetic(part):
            return [to_motion(clip) for clip in _synthetic(part, seed)]
        return _load(part, False, strict).motions

    def several(spec: str | Sequence[str], seed: int) -> list[Motion]:
        return _with_unique_names([(part, of(part, seed)) for part in _parts(spec)])

    motions = several(spec, seed)
    if mirrored:
        motions = [copy for motion in motions for copy in (motion, motion.mirrored())]
    return motions


def split_libraries(files: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Motion files to be read, and libraries to be loaded."""
    libraries = {file for file in files if file.suffix.lower() == ".npz" and is_library(file)}
    return [f for f in files if f not in libraries], [f for f in files if f in libraries]


def _parts(spec: str | Sequence[str]) -> list[str]:
    parts = split_parts(spec)
    if not parts:
        raise InputError("no motions named", fix=_choices())
    return parts


def _choices() -> str:
    return (
        f"give {SYNTHETIC}, {', '.join(datasets.DATASETS)} (or with :train, :test), a library, "
        f"a BVH or npz file, a folder, or a part of a mixture file"
    )


def _load(part: str, clips: bool, strict: bool) -> Library:
    """The clips or the motions of one part of a spec other than ``synthetic``."""
    name, _, split = part.partition(":")
    if name in datasets.DATASETS:
        return _load_dataset(name, split or None, clips)
    if not os.path.exists(part):
        raise InputError(f"no motions {part!r}", fix=_choices())
    files = motion_files(part)
    raw, libraries = split_libraries(files)
    out, skipped = load_libraries(libraries, motions=not clips, clips=clips)
    if raw:
        names = file_names(raw)
        key = [f"{name} {content_digest(file)}" for name, file in zip(names, raw, strict=True)]
        loaded, refused = _cached(key, lambda: raw, ReadOptions(), clips, given=names)
        out.motions.extend(loaded.motions)
        out.clips.extend(loaded.clips)
        skipped += refused
    messages = tuple(refused.message for refused in skipped)
    if messages and (strict or len(files) == 1):
        raise InputError(messages[0])
    if len(messages) == len(files):
        raise InputError(f"none of {len(files)} files can be used; the first: {messages[0]}", part)
    if messages:
        say_skipped(part, len(files), messages)
    return out


def load_libraries(
    files: Sequence[Path], *, motions: bool = True, clips: bool = True
) -> tuple[Library, list[Refused]]:
    """The content of several libraries, and the libraries that cannot be read."""
    out, refused = Library(), []
    for file in files:
        try:
            loaded = load_library(file, motions=motions, clips=clips)
        except InputError as error:
            refused.append(Refused(file, str(error)))
            continue
        out.motions.extend(loaded.motions)
        out.clips.extend(loaded.clips)
    return out, refused


def _load_dataset(name: str, split: str | None, clips: bool) -> Library:
    chosen = set(datasets.split_names(name, split))
    options = ReadOptions(licence=datasets.DATASETS[name].licence)
    key = [name, datasets.manifest_digest(name)]
    # Checked first, so that cached clips are not used for a dataset that is missing.
    files = datasets.clip_files(name)
    loaded, refused = _cached(key, lambda: files, options, clips, chosen)
    if refused:  # the files are verified, so none may be skipped
        raise InputError(refused[0].message)
    return loaded


def _cached(
    key: list[str],
    files: Callable[[], Sequence[Path]],
    options: ReadOptions,
    clips: bool,
    names: set[str] | None = None,
    given: Sequence[str] | None = None,
) -> tuple[Library, list[Refused]]:
    """Reads files through a cached library, whose name is a digest of all its inputs.

    Args:
        key: everything on which the library depends.
        files: read if the library is not in the cache.
        options: for reading.
        clips: whether to return clips or motions.
        names: return only these.
        given: the name of each file's motion; by default its own.

    Returns:
        The library and the unusable files, whose list is stored next to it.
    """
    others = map(repr, registered_families())
    digest = hashlib.sha256("\n".join([*key, repr(options), *others, _code_digest()]).encode())
    path = datasets.cache_dir() / "clips" / f"{digest.hexdigest()[:32]}.npz"
    if not path.is_file():
        with _alone(path):
            if not path.is_file():  # another process may have made it
                _make(path, files(), options, given)
    refused = _refused(path, files)
    # The first call also reads the file back, so that it agrees with later calls to the bit.
    return load_library(path, motions=not clips, clips=clips, names=names), refused


def _make(
    path: Path, files: Sequence[Path], options: ReadOptions, given: Sequence[str] | None
) -> None:
    results = list(read_many(files, options))
    done, refused = [], []
    for index, result in enumerate(results):
        if isinstance(result, Retargeted):
            done.append(result.named(given[index]) if given else result)
        else:  # the file may have moved by the next call
            refused.append([index, result.message.replace(str(result.path), FILE)])
    if refused:
        with whole_file(_beside(path)) as fresh:
            fresh.write_text(json.dumps(refused), encoding="utf-8")
    save_library(path, [r.motion for r in done], [r.clip for r in done])


def _refused(path: Path, files: Callable[[], Sequence[Path]]) -> list[Refused]:
    """The unusable files that a cached library leaves out."""
    if not _beside(path).is_file():
        return []
    entries, chosen = json.loads(_beside(path).read_text(encoding="utf-8")), files()
    return [Refused(chosen[i], text.replace(FILE, str(chosen[i]))) for i, text in entries]


def _beside(path: Path) -> Path:
    return path.with_suffix(".skipped.json")


def _alone(path: Path) -> FileLock:
    """Lock for making ``path``, so that trainings started together make it only once."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise InputError(
            f"cache cannot be written ({error.strerror})",
            path.parent,
            "set QUESTSIM_CACHE to a folder of yours",
        ) from None
    return FileLock(path.with_suffix(".lock"))


@lru_cache
def _code_digest() -> str:
    """Digest of the code and the body that clips depend on; a change invalidates the cache."""
    here = Path(__file__).parent
    others = (
        "datasets inverse_dynamics library many mixture motions_command naming reproportion "
        "retarget_stream spec stance_stream variation vary_command"
    )
    sources = sorted(path for path in here.glob("*.py") if path.stem not in others.split())
    sources += [Path(str(module.__file__)) for module in (rotations, skeleton)]
    sources += [here.parent / "body.py", mjcf_path("humanoid.xml")]
    digest = hashlib.sha256(str(VERSION).encode())
    for source in sources:
        digest.update(source.read_bytes())
    return digest.hexdigest()


def _is_synthetic(part: str) -> bool:
    return part.partition(":")[0] == SYNTHETIC


def _synthetic(part: str, seed: int) -> list[Clip]:
    """All of ``synthetic``, the kinds in ``synthetic:KIND+KIND``, or random clips."""
    from questsim.motion.synthesis import random_clips as random
    from questsim.motion.synthesis.synthetic import (
        ACTIONS,
        KINDS,
        SEATED,
        seated_clips,
        synthetic_clips,
    )

    _, colon, kinds = part.partition(":")
    if not colon:
        return synthetic_clips(seed)
    first, colon, number = kinds.partition(":")
    if first in (RANDOM, HELD_OUT):
        make = random.random_clips if first == RANDOM else random.held_out_clips
        return make(_count(number, part) if colon else RANDOM_COUNT, seed)
    if kinds == "all":
        return synthetic_clips(seed) + random.action_clips(tuple(ACTIONS), seed)
    wanted, known = kinds.split("+"), (*KINDS, *ACTIONS, *SEATED)
    for kind in wanted:
        if kind not in known:
            choices = ", ".join((*known, "all", f"{RANDOM}:COUNT", f"{HELD_OUT}:COUNT"))
            raise InputError(f"there is no kind {kind!r}", part, f"choose from {choices}")
    # Each is generated only on request.
    clips = synthetic_clips(seed, kinds=wanted)
    clips += random.action_clips([kind for kind in ACTIONS if kind in wanted], seed)
    clips += seated_clips(seed) if set(wanted) & set(SEATED) else []
    return [clip for clip in clips if clip.kind in wanted]


def _count(text: str, part: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise InputError(
            f"{text!r} is not a number of clips", part, f"write {SYNTHETIC}:{RANDOM}:500"
        )
    return int(text)


def _with_unique_names(parts: Sequence[tuple[str, Sequence[_T]]]) -> list[_T]:
    """The items of all parts; repeated names get a folder's name or a number."""
    items = [item for _, members in parts for item in members]
    places = [place(part) for part, members in parts for _ in members]
    names = unique_names([item.name for item in items], places)
    return [named(item, name) for item, name in zip(items, names, strict=True)]
