"""Loads the clips or motions of data sets, libraries, files and folders, through the cache."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path

from filelock import FileLock

from questsim import rotations, skeleton
from questsim.assets import mjcf_path
from questsim.errors import InputError, did_you_mean
from questsim.extensions import load_extensions
from questsim.files import whole_file
from questsim.motion import datasets
from questsim.motion.cache import cache_dir
from questsim.motion.clip import Clip
from questsim.motion.families import registered_families
from questsim.motion.library import (
    VERSION,
    Library,
    clip_names,
    is_library,
    load_library,
    save_library,
)
from questsim.motion.many import Refused, Retargeted, read_many, say_skipped
from questsim.motion.motion import Motion
from questsim.motion.naming import file_names
from questsim.motion.reading import ReadOptions
from questsim.motion.sources import content_digest, motion_files

FILE = "<file>"
"""Placeholder for a skipped file's path in the cache."""


def choices() -> str:
    """What a motion argument may be, for error messages."""
    return (
        f"give synthetic, {', '.join(datasets.DATASETS)} (or with :train, :test), a library, "
        f"a BVH or npz file, a folder, or a part of a mixture file"
    )


def split_libraries(files: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Motion files to be read, and libraries to be loaded."""
    libraries = {file for file in files if file.suffix.lower() == ".npz" and is_library(file)}
    return [f for f in files if f not in libraries], [f for f in files if f in libraries]


MotionOf = Callable[[Clip], Motion]
"""Makes the motion of a clip that has none: a variation, a chain."""


def load_part(part: str, strict: bool, motion_of: MotionOf | None = None) -> Library:
    """The clips of one part of a spec other than ``synthetic``; with ``motion_of`` its motions."""
    clips = motion_of is None
    name, _, split = part.partition(":")
    if name not in datasets.DATASETS and not os.path.exists(part):
        load_extensions()  # it may be a data set of another package
    if name in datasets.DATASETS:
        return _load_dataset(name, split or None, clips)
    if not os.path.exists(part):
        near = did_you_mean(name, ("synthetic", *datasets.DATASETS))
        raise InputError(f"no motions {part!r}", fix=near + choices())
    files = motion_files(part)
    raw, libraries = split_libraries(files)
    out, skipped = load_libraries(libraries, motions=False, motion_of=motion_of)
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
    files: Sequence[Path], *, motions: bool = True, motion_of: MotionOf | None = None
) -> tuple[Library, list[Refused]]:
    """The content of several libraries, and the libraries that cannot be read.

    Args:
        files: the libraries.
        motions: whether to read the motions beside the clips.
        motion_of: read the motions alone, and make those of clips without any.
    """
    out, refused = Library(), []
    for file in files:
        try:
            if motion_of is None:
                loaded = load_library(file, motions=motions)
            else:
                loaded = Library(motions=_all_motions(file, motion_of))
        except InputError as error:
            refused.append(Refused(file, str(error)))
            continue
        out.motions.extend(loaded.motions)
        out.clips.extend(loaded.clips)
    return out, refused


def _all_motions(file: Path, motion_of: MotionOf) -> list[Motion]:
    """A library's motions, in its clips' order, with one made of each clip without any."""
    motions, names = load_library(file, clips=False).motions, clip_names(file)
    known = {motion.name: motion for motion in motions}
    lacking = {name for name in names if name not in known}
    if lacking:
        made = load_library(file, motions=False, names=lacking).clips
        known |= {clip.name: motion_of(clip) for clip in made}
    if not lacking:
        return motions
    alone = [motion for motion in motions if motion.name not in names]
    return [known[name] for name in names] + alone


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
    path = cache_dir() / "clips" / f"{digest.hexdigest()[:32]}.npz"
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
        "cache datasets doubts inverse_dynamics library loaded many mixture motions_command naming "
        "reproportion retarget_stream spec stance_stream variation"
    )
    sources = sorted(path for path in here.glob("*.py") if path.stem not in others.split())
    sources += [Path(str(module.__file__)) for module in (rotations, skeleton)]
    sources += [here.parent / "body.py", mjcf_path("humanoid.xml")]
    digest = hashlib.sha256(str(VERSION).encode())
    for source in sources:
        digest.update(source.read_bytes())
    return digest.hexdigest()
