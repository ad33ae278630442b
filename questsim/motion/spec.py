"""One string names motions everywhere: a dataset, a library, a file, a folder, ``synthetic``."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from filelock import FileLock

from questsim import rotations, skeleton
from questsim.assets import mjcf_path
from questsim.errors import InputError
from questsim.motion import datasets
from questsim.motion.clip import Clip
from questsim.motion.families import add_families, registered_families
from questsim.motion.library import VERSION, Library, is_library, load_library, save_library
from questsim.motion.motion import Motion
from questsim.motion.reading import ReadOptions, read_motion
from questsim.motion.skeletons import RECOGNISED
from questsim.motion.sources import content_digest, motion_files

SYNTHETIC = "synthetic"
MAX_ERROR_CM = 15.0
"""A recognised skeleton whose clip is further off in any joint, on average, is refused."""
RANDOM, HELD_OUT = "random", "held-out"
RANDOM_COUNT = 100
"""Clips of ``synthetic:random`` and ``synthetic:held-out`` without a number."""
MANY = 64
"""From this many files on, two processes read them and a progress bar is shown."""

if TYPE_CHECKING:
    from questsim.motion.stance_figures import StanceFigures

_T = TypeVar("_T", Motion, Clip)


def load_motions(
    spec: str | Sequence[str],
    *,
    height_m: float | None = None,
    mirrored: bool = False,
    seed: int = 0,
) -> list[Clip]:
    """The avatar's clips that a motion argument names.

    Files are read and retargeted once; the result is kept in the cache.

    Args:
        spec: ``synthetic`` (or some of its kinds, ``synthetic:walk+bow``, or ``synthetic:all``,
            ``synthetic:random:500``, ``synthetic:held-out:40``), a dataset
            (``bandai-namco-2``, ``bandai-namco-2:train``, ``bandai-namco-2:test``), a library, a
            BVH or AMASS file, a folder of these, or several, joined by commas or as a sequence.
        height_m: scale all clips to this stature; by default each keeps its performer's.
        mirrored: add a mirrored copy of each clip after the clip itself.
        seed: of the synthetic motions.

    Raises:
        InputError: there is no such thing, a dataset has not been fetched, or a file cannot be
            used.
    """
    from questsim.motion.retarget import mirror_clip

    clips: list[Clip] = []
    for part in _parts(spec):
        clips += _synthetic(part, seed) if _is_synthetic(part) else _load(part, clips=True).clips
    clips = _with_unique_names(clips)
    if height_m is not None:
        clips = [clip.scaled(height_m) for clip in clips]
    if mirrored:
        clips = [copy for clip in clips for copy in (clip, mirror_clip(clip))]
    return clips


def load_recordings(
    spec: str | Sequence[str], *, mirrored: bool = False, seed: int = 0
) -> list[Motion]:
    """The same as motions on the 22-joint skeleton, as recorded (synthetic ones as made).

    Args:
        spec: as in ``load_motions``.
        mirrored: add a mirrored copy of each motion after the motion itself.
        seed: of the synthetic motions.

    Raises:
        InputError: as ``load_motions``.
    """
    from questsim.motion.retarget_back import to_motion

    motions: list[Motion] = []
    for part in _parts(spec):
        if _is_synthetic(part):
            motions += [to_motion(clip) for clip in _synthetic(part, seed)]
        else:
            motions += _load(part, clips=False).motions
    motions = _with_unique_names(motions)
    if mirrored:
        motions = [copy for motion in motions for copy in (motion, motion.mirrored())]
    return motions


@dataclass(frozen=True)
class Retargeted:
    """What ``read_and_retarget`` makes of a file; errors and feet if asked for."""

    motion: Motion
    clip: Clip
    report: str
    error_cm: dict[str, float]
    stance: StanceFigures | None = None


def read_and_retarget(path: Path, options: ReadOptions, with_error: bool = False) -> Retargeted:
    """Reads, checks and retargets one file."""
    from questsim.motion.retarget import retargeting_error, to_clip
    from questsim.motion.stance_figures import stance_figures

    motion, report = read_motion(path, options)
    clip = to_clip(motion)
    error = retargeting_error(motion, clip) if with_error else {}
    if report.skeleton == RECOGNISED and not options.accept:
        check_fit(motion, clip, path)
    stance = stance_figures(motion, clip) if with_error else None
    return Retargeted(motion, clip, str(report), error, stance)


def check_fit(motion: Motion, clip: Clip, path: Path) -> None:
    """Refuses a recognised skeleton whose clip is far from its motion.

    What the retargeted T-pose is off by is the difference between the performer's proportions and
    the avatar's; it is taken off.

    Raises:
        InputError: a joint is further off than ``MAX_ERROR_CM`` on average.
    """
    from questsim.motion.retarget import retargeting_error, to_clip

    rotations = np.zeros_like(motion.rotations[:1])
    rotations[..., 0] = 1.0
    standing = replace(motion, rotations=rotations, root_position=motion.root_position[:1])
    expected = retargeting_error(standing, to_clip(standing))
    error = {j: e - expected[j] for j, e in retargeting_error(motion, clip).items()}
    joint = max(error, key=lambda name: error[name])
    if error[joint] > MAX_ERROR_CM:
        raise InputError(
            f"retargeted, the {joint} is {error[joint]:.0f} cm off on average: the skeleton is "
            "not what it was recognised as",
            path,
            "see import --explain, and name the joints in a mapping file",
        )


def read_many(
    paths: Sequence[Path], options: ReadOptions, *, with_error: bool = False
) -> Iterable[Retargeted]:
    """Reads and retargets files in order; many of them on two processes."""
    task = partial(read_and_retarget, options=options, with_error=with_error)
    if len(paths) < MANY:
        yield from map(task, paths)
        return
    from tqdm import tqdm

    # The parent may hold threads and a GL context: a fresh process inherits neither.
    workers = min(2, os.cpu_count() or 1)
    with ProcessPoolExecutor(
        workers, get_context("spawn"), add_families, (registered_families(),)
    ) as pool:
        results = pool.map(task, paths, chunksize=8)
        yield from tqdm(results, total=len(paths), desc="retargeting", unit=" clips", disable=None)


def split_libraries(files: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Motion files to be read, and libraries to be loaded."""
    libraries = [file for file in files if file.suffix.lower() == ".npz" and is_library(file)]
    return [file for file in files if file not in libraries], libraries


def _parts(spec: str | Sequence[str]) -> list[str]:
    listed = [spec] if isinstance(spec, str) else list(spec)
    parts = [part.strip() for entry in listed for part in entry.split(",") if part.strip()]
    if not parts:
        raise InputError("no motions named", fix=_choices())
    return parts


def _choices() -> str:
    return (
        f"give {SYNTHETIC}, {', '.join(datasets.DATASETS)} (or with :train, :test), a library, "
        f"a BVH or npz file, or a folder"
    )


def _load(part: str, clips: bool) -> Library:
    """One part of a spec, but ``synthetic``: its clips, or else its motions."""
    name, _, split = part.partition(":")
    if name in datasets.DATASETS:
        return _load_dataset(name, split or None, clips)
    if not Path(part).exists():
        raise InputError(f"no motions {part!r}", fix=_choices())
    raw, libraries = split_libraries(motion_files(part))
    out = Library()
    for file in libraries:
        loaded = load_library(file, motions=not clips, clips=clips)
        out.motions.extend(loaded.motions)
        out.clips.extend(loaded.clips)
    if raw:
        digests = [f"{file.stem} {content_digest(file)}" for file in raw]
        loaded = _cached(digests, lambda: raw, ReadOptions(), clips)
        out.motions.extend(loaded.motions)
        out.clips.extend(loaded.clips)
    return out


def _load_dataset(name: str, split: str | None, clips: bool) -> Library:
    chosen = set(datasets.split_names(name, split))
    options = ReadOptions(licence=datasets.DATASETS[name].licence)
    key = [name, datasets.manifest_digest(name)]
    # Asked first, so that a cache of clips does not serve a dataset that is not there.
    files = datasets.clip_files(name)
    return _cached(key, lambda: files, options, clips, chosen)


def _cached(
    key: list[str],
    files: Callable[[], Sequence[Path]],
    options: ReadOptions,
    clips: bool,
    names: set[str] | None = None,
) -> Library:
    """Reads files through a library in the cache, whose name is a digest of all it depends on."""
    others = map(repr, registered_families())
    digest = hashlib.sha256("\n".join([*key, repr(options), *others, _code_digest()]).encode())
    path = datasets.cache_dir() / "clips" / f"{digest.hexdigest()[:32]}.npz"
    if not path.is_file():
        with _alone(path):
            if not path.is_file():  # another process may have been at it
                done = list(read_many(files(), options))
                save_library(path, [r.motion for r in done], [r.clip for r in done])
    # Also the first time through the file, so that the first and later calls agree to the bit.
    return load_library(path, motions=not clips, clips=clips, names=names)


def _alone(path: Path) -> FileLock:
    """The lock under which ``path`` is made, so that trainings begun together make it once."""
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
    """Digest of the code and the body that clips depend on: they outdate the cache."""
    here = Path(__file__).parent
    others = "datasets inverse_dynamics library motions_command spec variation vary_command"
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
    """``synthetic``, or of it only the kinds in ``synthetic:KIND+KIND``, or random clips."""
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
    # Each is made only if it is asked for.
    clips = synthetic_clips(seed, kinds=wanted)
    clips += random.action_clips([kind for kind in ACTIONS if kind in wanted], seed)
    clips += seated_clips(seed) if set(wanted) & set(SEATED) else []
    return [clip for clip in clips if clip.kind in wanted]


def _count(text: str, part: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise InputError(f"{text!r} is no count of clips", part, f"write {SYNTHETIC}:{RANDOM}:500")
    return int(text)


def _with_unique_names(items: list[_T]) -> list[_T]:
    """Numbers the names that come twice, as from two folders with equal file names."""
    seen: dict[str, int] = {}
    out = []
    for item in items:
        count = seen[item.name] = seen.get(item.name, 0) + 1
        out.append(item if count == 1 else replace(item, name=f"{item.name}-{count}"))
    return out
