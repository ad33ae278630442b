"""The commands ``questsim motions import``, ``fetch`` and ``list``."""

from __future__ import annotations

import sys
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from questsim.errors import InputError
from questsim.motion.clip import Clip
from questsim.motion.datasets import DATASETS, fetch
from questsim.motion.library import load_library, save_library
from questsim.motion.reading import ReadOptions, explain, read_recording
from questsim.motion.skeletons import write_mapping
from questsim.motion.sources import KINDS, motion_files
from questsim.motion.spec import Retargeted, load_motions, read_many, split_libraries

MAX_REPORTS = 20


@dataclass
class ImportArgs:
    """Read motion files, check them, retarget them to the avatar, write a library."""

    paths: tyro.conf.Positional[tuple[str, ...]]
    """BVH, ASF/AMC, DeepMimic or AMASS .npz files, libraries, or folders or zips of these."""
    out: str
    """The library to write, LIBRARY.npz."""
    units: Literal["m", "cm", "mm", "inch", "cmu", "dm"] | None = None
    """Units of the files; detected if not given (cmu: inches times 0.45)."""
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None
    """Up axis of the files; detected if not given."""
    fps: float | None = None
    """True frame rate; that of the files if not given."""
    mapping: str | None = None
    """A mapping file (TOML) for a skeleton that is not recognised."""
    height: float | None = None
    """The subject's height in metres, to which the skeleton is scaled."""
    smpl: str | None = None
    """A SMPL model (.npz) that gives AMASS files the subject's own skeleton."""
    licence: str = ""
    """Licence of the files, kept in the library."""
    mirrored: bool = False
    """Add a mirrored copy of each motion."""
    accept: bool = False
    """Take files even where they fail the physical checks."""
    explain: bool = False
    """Print which joint of the file was taken for what, and why."""


@dataclass
class MappingArgs:
    """Write a mapping file with the joints that are recognised; fill in and correct the rest."""

    path: tyro.conf.Positional[str]
    """A motion file of the skeleton."""
    out: str
    """The mapping file to write, RIG.toml."""


@dataclass
class FetchArgs:
    """Download a public dataset and verify every clip of it."""

    name: tyro.conf.Positional[str]
    """The dataset, e.g. bandai-namco-2."""
    mirror: str | None = None
    """A zip file or URL laid out as the public archive is, to use instead of it."""


@dataclass
class ListMotionsArgs:
    """Say what a motion argument contains."""

    spec: tyro.conf.Positional[str]
    """A dataset (with :train or :test), library, file, folder, or synthetic."""
    clips: Annotated[bool, tyro.conf.arg(aliases=["-c"])] = False
    """List each clip."""


def import_motions(args: ImportArgs) -> None:
    """Writes a library of the files' motions and clips; prints how each was taken.

    Raises:
        InputError: any file cannot be used, or the library cannot be written; then there is
            no library.
    """
    from questsim.motion.retarget import mirror_clip

    out = Path(args.out)
    check_library_path(out)
    options = ReadOptions(
        args.units, args.up, args.fps, args.mapping, args.height, args.smpl,
        args.licence, args.accept,
    )  # fmt: skip
    if not args.paths:
        raise InputError("no files given", fix=f"name {KINDS}, or folders or zips of them")
    files = [file for path in args.paths for file in motion_files(path)]
    files = [file for file in files if file.resolve() != out.resolve()]
    raw, libraries = split_libraries(files)
    if args.explain:
        for file in raw[:MAX_REPORTS]:
            print("\n".join(explain(file, options)))
    done = _read(raw, options)
    motions, clips = [r.motion for r in done], [r.clip for r in done]
    for file in libraries:
        library = load_library(file)
        motions, clips = motions + library.motions, clips + library.clips
    _refuse_twins(clips)
    if args.mirrored:
        motions += [motion.mirrored() for motion in motions]
        clips += [mirror_clip(clip) for clip in clips]
    save_library(out, motions, clips)
    if done:
        _print_errors(done)
        _print_stances(done)
    print(f"{len(clips)} clips, {sum(c.duration for c in clips):.0f} s, in {out}")


def check_library_path(out: Path) -> None:
    """Refuse what cannot become a library, before the work begins.

    Raises:
        InputError: the name has another ending, or there is no such folder.
    """
    if out.suffix.lower() != ".npz":
        raise InputError("a library's name ends in .npz", out)
    if not out.parent.is_dir():
        raise InputError("no such folder", out.parent, "create it first")


def _read(files: Sequence[Path], options: ReadOptions) -> list[Retargeted]:
    """All files, read and retargeted; says of the first ones how they were taken."""
    done = []
    for index, result in enumerate(read_many(files, options, with_error=True)):
        if index < MAX_REPORTS:
            print(f"{result.motion.name}: {len(result.motion)} frames, {result.report}")
            print(f"    feet: {result.stance}")
        elif index == MAX_REPORTS:
            print(f"... and {len(files) - MAX_REPORTS} more")
        for warning in result.stance.warnings() if result.stance else ():
            print(f"warning: {result.motion.name}: {warning}", file=sys.stderr)
        done.append(result)
    return done


def start_mapping(args: MappingArgs) -> None:
    """Writes a mapping file for a motion file's skeleton.

    Raises:
        InputError: the motion cannot be read, or the file not be written.
    """
    if Path(args.out).suffix.lower() != ".toml":
        raise InputError("a mapping file's name ends in .toml", args.out)
    todo = write_mapping(read_recording(Path(args.path)), Path(args.out))
    print(f"{args.out}: {todo}")


def fetch_dataset(args: FetchArgs) -> None:
    """Fetches a dataset into the cache; see ``datasets.fetch``."""
    fetch(args.name, args.mirror)


def list_motions(args: ListMotionsArgs) -> None:
    """Prints the kinds, and on request the clips, that a motion argument contains."""
    clips = load_motions(args.spec)
    groups: dict[tuple[str, str], list[Clip]] = defaultdict(list)
    for clip in clips:
        groups[clip.kind or "-", clip.style or "-"].append(clip)
        if args.clips:
            print(f"{clip.name}  {clip.duration:.1f} s  {clip.height_m:.2f} m")
    print(f"{'kind':22} {'style':12} {'clips':>6} {'seconds':>8} {'height m':>10}")
    for (kind, style), members in sorted(groups.items()):
        print(f"{kind:22} {style:12} {_summary(members)}")
    print(f"{'all':22} {'':12} {_summary(clips)}")
    licences = sorted({clip.licence for clip in clips if clip.licence})
    if licences:
        credit = [d.credit for d in DATASETS.values() if d.name in args.spec]
        print(f"licence: {', '.join(licences)}. {' '.join(credit)}")


def _summary(clips: Sequence[Clip]) -> str:
    heights = [clip.height_m for clip in clips]
    low, high = min(heights), max(heights)
    tall = f"{low:.2f}" if high - low < 0.005 else f"{low:.2f}-{high:.2f}"
    return f"{len(clips):6d} {sum(clip.duration for clip in clips):8.0f} {tall:>10}"


def _refuse_twins(clips: Sequence[Clip]) -> None:
    twins = [name for name, count in Counter(c.name for c in clips).items() if count > 1]
    if twins:
        raise InputError(f"two motions are called {twins[0]}", fix="rename one or leave it out")


def _print_errors(done: Sequence[Retargeted]) -> None:
    """Mean retargeting error by joint over all files, largest first."""
    mean = {
        joint: float(np.mean([result.error_cm[joint] for result in done]))
        for joint in done[0].error_cm
    }
    ordered = sorted(mean.items(), key=lambda pair: -pair[1])
    print("retargeting error in cm: " + ", ".join(f"{j} {e:.1f}" for j, e in ordered))


def _print_stances(done: Sequence[Retargeted]) -> None:
    """Mean figures of the feet over all files."""
    from questsim.motion.stance_figures import mean_figures

    print(f"feet, mean of all: {mean_figures([r.stance for r in done if r.stance])}")
