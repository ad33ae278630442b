"""Reads many motion files; unusable files are skipped, reported and counted."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from questsim.errors import InputError
from questsim.motion.checks import Report
from questsim.motion.clip import FPS, Clip
from questsim.motion.doubts import doubts
from questsim.motion.families import SMPL, add_families, registered_families
from questsim.motion.motion import Motion
from questsim.motion.naming import named
from questsim.motion.reading import ReadOptions, read_motion
from questsim.motion.skeletons import RECOGNISED
from questsim.processes import allowed

if TYPE_CHECKING:
    from questsim.motion.stance_figures import StanceFigures

MAX_ERROR_CM, MAX_EXPECTED_CM = 15.0, 20.0
"""A recognised skeleton is rejected if any joint of its clip has a larger mean error. Other
proportions than the avatar's excuse up to ``MAX_EXPECTED_CM`` more; of people measured, 17 cm."""
MAX_KNOWN_CM, SAMPLES = 30.0, 12
"""The same for known skeletons, in some frames: there a file's values are wrong (radians, say)."""
MANY = 64
"""From this many files on, a progress bar is shown and processes are used if allowed."""
PART = 8
"""Files that a worker of another node reads at a time."""
MAX_SHOWN = 20
"""How many skipped files of a motion argument are listed by name."""


@dataclass(frozen=True)
class Retargeted:
    """The result of ``read_and_retarget``; errors, feet and warnings if requested.

    ``summary`` is plain; ``report`` says all that was detected.
    """

    motion: Motion
    clip: Clip
    summary: str
    report: str
    error_cm: dict[str, float]
    stance: StanceFigures | None = None
    warnings: tuple[str, ...] = ()

    def named(self, name: str) -> Retargeted:
        """A copy with another name."""
        return replace(self, motion=named(self.motion, name), clip=named(self.clip, name))


@dataclass(frozen=True)
class Refused:
    """A file that cannot be used.

    Attributes:
        path: the file.
        message: what is wrong with it, where, and what to do.
    """

    path: Path
    message: str


PartMapper = Callable[
    [Callable[[Sequence[Path]], list["Retargeted | Refused"]], Sequence[Sequence[Path]]],
    Iterable[list["Retargeted | Refused"]],
]
"""Like ``map`` over parts of the files."""


def read_and_retarget(path: Path, options: ReadOptions, with_error: bool = False) -> Retargeted:
    """Reads, checks and retargets one file."""
    from questsim.motion.retarget import retargeting_error, to_clip
    from questsim.motion.stance_figures import stance_figures

    motion, report = read_motion(path, options)
    clip = to_clip(motion)
    error = retargeting_error(motion, clip) if with_error else {}
    if not options.accept:
        check = check_fit if report.skeleton == RECOGNISED else check_roughly
        check(motion, clip, path)
    summary = _summary(motion, report)
    stance = stance_figures(motion, clip) if with_error else None
    if stance and not stance.still:
        report = replace(report, notes=(*report.notes, _unmeasured_soles(report)))
    warnings = (*doubts(motion, report), *stance.warnings()) if stance else ()
    return Retargeted(motion, clip, summary, str(report), error, stance, warnings)


def _summary(motion: Motion, report: Report) -> str:
    """Duration, height, and what was changed."""
    scaled = [report.units.partition("; ")[2].rstrip(")")] if "scaled to" in report.units else []
    said = [f"{motion.duration:.1f} s, {report.stature_m:.2f} m tall", *scaled, *report.notes]
    return "; ".join(said)


def _unmeasured_soles(report: Report) -> str:
    """Says what the tilt of the soles is taken from in a file whose feet are never still."""
    kind = report.skeleton or SMPL.name
    if report.foot_pitch:
        degrees = np.degrees(report.foot_pitch)
        return f"feet never still: soles pitched by {degrees:.0f} deg, as declared for {kind} files"
    return f"feet never still: soles not measured, and no pitch is known for {kind} files"


def check_fit(motion: Motion, clip: Clip, path: Path) -> None:
    """Rejects a recognised skeleton if its clip is far from its motion.

    The error of the retargeted T-pose is the difference between the performer's and the avatar's
    proportions; it is subtracted first.

    Raises:
        InputError: the mean error of a joint is above ``MAX_ERROR_CM``.
    """
    from questsim.motion.retarget import retargeting_error, to_clip

    rotations = np.zeros_like(motion.rotations[:1])
    rotations[..., 0] = 1.0
    standing = replace(motion, rotations=rotations, root_position=motion.root_position[:1])
    expected = retargeting_error(standing, to_clip(standing))
    error = {
        j: e - min(expected[j], MAX_EXPECTED_CM) for j, e in retargeting_error(motion, clip).items()
    }
    joint = max(error, key=lambda name: error[name])
    if error[joint] > MAX_ERROR_CM:
        raise InputError(
            f"after retargeting, the {joint} is {error[joint]:.0f} cm off on average: "
            "the skeleton is not what it was recognised as",
            path,
            "see import --explain, and name the joints in a mapping file",
        )


def check_roughly(motion: Motion, clip: Clip, path: Path) -> None:
    """Rejects a known skeleton in poses that the avatar cannot nearly take.

    Raises:
        InputError: the mean error of a joint in some frames is above ``MAX_KNOWN_CM``.
    """
    from questsim.motion.retarget import retargeting_error

    frames = np.unique(np.linspace(0, len(clip) - 1, SAMPLES).astype(int))
    theirs = np.minimum(np.round(frames * motion.fps / FPS).astype(int), len(motion) - 1)
    some = replace(
        motion,
        fps=FPS,  # of single frames; then they are not resampled
        root_position=motion.root_position[theirs],
        rotations=motion.rotations[theirs],
    )
    shown = replace(clip, link_position=clip.link_position[frames])
    error = retargeting_error(some, shown)
    joint = max(error, key=lambda name: error[name])
    if error[joint] > MAX_KNOWN_CM:
        raise InputError(
            f"after retargeting, the {joint} is {error[joint]:.0f} cm off on average: "
            "no person moves like this",
            path,
            "check how it was exported: degrees, order of the rotations, up axis",
        )


def _read(path: Path, options: ReadOptions, with_error: bool) -> Retargeted | Refused:
    try:
        return read_and_retarget(path, options, with_error)
    except InputError as error:
        return Refused(path, str(error))


def _read_part(
    paths: Sequence[Path], options: ReadOptions, with_error: bool
) -> list[Retargeted | Refused]:
    return [_read(path, options, with_error) for path in paths]


def read_many(
    paths: Sequence[Path],
    options: ReadOptions,
    *,
    with_error: bool = False,
    mapper: PartMapper | None = None,
) -> Iterable[Retargeted | Refused]:
    """Reads and retargets files in order; on several processes if the caller allows them.

    Args:
        paths: the files.
        options: how they are read.
        with_error: whether to measure errors and feet.
        mapper: reads them elsewhere, ``PART`` files at a time; the results are the same.
    """
    from tqdm import tqdm

    shown = partial(tqdm, total=len(paths), desc="retargeting", unit=" clips", disable=None)
    if mapper is not None:
        parts = [paths[i : i + PART] for i in range(0, len(paths), PART)]
        read = partial(_read_part, options=options, with_error=with_error)
        yield from shown(result for part in mapper(read, parts) for result in part)
        return
    task: Callable[[Path], Retargeted | Refused]
    task = partial(_read, options=options, with_error=with_error)
    if len(paths) < MANY:
        yield from map(task, paths)
        return
    workers = min(allowed(), os.cpu_count() or 1)
    if workers < 2:
        yield from shown(map(task, paths))
        return
    # The parent may hold threads and a GL context: a fresh process inherits neither.
    with ProcessPoolExecutor(
        workers, get_context("spawn"), add_families, (registered_families(),)
    ) as pool:
        yield from shown(pool.map(task, paths, chunksize=8))


@lru_cache(maxsize=64)
def say_skipped(part: str, total: int, messages: tuple[str, ...]) -> None:
    """Print the skipped files of a motion argument on stderr, once for each state of it."""
    for message in messages[:MAX_SHOWN]:
        print(f"warning: skipped {message}", file=sys.stderr)
    print(f"warning: {len(messages)} of {total} files in {part} skipped", file=sys.stderr)
