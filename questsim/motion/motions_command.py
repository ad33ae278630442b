"""The commands ``questsim motions import``, ``chain``, ``fetch`` and ``list``."""

from __future__ import annotations

import shlex
import sys
import textwrap
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np

from questsim.errors import InputError, at_least, usable_seed
from questsim.motion.clip import Clip
from questsim.motion.datasets import DATASETS, fetch, is_fetched
from questsim.motion.library import Library, bare, save_library
from questsim.motion.loaded import load_libraries, split_libraries
from questsim.motion.many import PartMapper, Refused, Retargeted, read_many
from questsim.motion.motion import Motion
from questsim.motion.naming import file_names, named, numbered
from questsim.motion.reading import ReadOptions, explain, read_as_recorded
from questsim.motion.skeletons import write_mapping
from questsim.motion.sources import KINDS, motion_files
from questsim.motion.spec import load_motions, reads_file
from questsim.motion_options import (
    ChainArgs,
    FetchArgs,
    ImportArgs,
    ListMotionsArgs,
    MappingArgs,
)

MAX_REPORTS = 20


def import_motions(args: ImportArgs, mapper: PartMapper | None = None) -> None:
    """Writes a library of the files' motions and clips; prints how each was taken.

    Files that cannot be used are named on stderr, with the reason, and counted.

    Args:
        args: the options.
        mapper: see ``read_many``.

    Raises:
        InputError: no file can be used (with ``strict``: any cannot), or the library cannot be
            written; then there is no library.
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
    skipped = _Skipped(strict=args.strict or len(args.paths) == 1)
    files = _files(args.paths, out, skipped)
    if not files and not skipped.count:
        raise InputError("is the only one of the files", out, "choose another --out")
    skipped.strict = args.strict or len(files) + skipped.count == 1
    raw, libraries = split_libraries(files)
    _refuse_unused(args, raw, libraries)
    if args.explain:
        _explain(raw[:MAX_REPORTS], options)
    done = _read(raw, options, skipped, args.explain, mapper)
    library, unread = load_libraries(libraries)
    for refused in unread:
        skipped.add(refused.message)
    if not done and not library.clips:
        total = len(files) + skipped.unfound
        raise InputError(f"none of {total} files can be imported", fix="see the reasons above")
    motions, clips = _joined(raw, done, library)
    if args.mirrored:
        motions += [motion.mirrored() for motion in motions]
        clips += [mirror_clip(clip) for clip in clips]
    save_library(out, motions, clips)
    if done and args.explain:
        results = list(done.values())
        _print_errors(results)
        _print_stances(results)
    count = f"{len(clips)} clip{'s' if len(clips) != 1 else ''}"
    print(f"{count}, {sum(c.duration for c in clips):.0f} s, in {out}{skipped}")
    clip, library_path = shlex.quote(clips[0].name), shlex.quote(str(out))
    print(f"look at one: questsim motions show {clip} --motions {library_path}")


_OF_READING = (
    "units", "up", "fps", "mapping", "height", "smpl", "licence", "accept", "explain",
)  # fmt: skip
"""Options that say how files are read."""


def _refuse_unused(args: ImportArgs, raw: Sequence[Path], libraries: Sequence[Path]) -> None:
    """Refuse options that none of the files needs.

    Raises:
        InputError: naming the option.
    """
    plain = ImportArgs(args.paths, args.out)
    given = [f"--{o}" for o in _OF_READING if getattr(args, o) != getattr(plain, o)]
    if given and libraries and not raw:
        what = "has no effect: these libraries have been imported before"
        raise InputError(what, given[0], "leave it out, or import the files again")
    if args.smpl is not None and not any(file.suffix.lower() == ".npz" for file in raw):
        raise InputError("has no effect: none is an AMASS file (.npz)", "--smpl", "leave it out")


@dataclass
class _Skipped:
    """Counts and names the files that cannot be used; refuses the first one if ``strict``."""

    strict: bool
    count: int = 0
    unfound: int = 0

    def add(self, message: str) -> None:
        if self.strict:
            raise InputError(message)
        self.count += 1
        print("skipped " + " ".join(message.split()), file=sys.stderr)

    def __str__(self) -> str:
        return f"; {self.count} skipped" if self.count else ""


def _files(paths: Sequence[str], out: Path, skipped: _Skipped) -> list[Path]:
    """The motion files that the paths name, each once, without the library to be written."""
    found: dict[Path, Path] = {}
    for path in paths:
        try:
            found |= {file.resolve(): file for file in motion_files(path)}
        except InputError as error:
            skipped.add(str(error))
    skipped.unfound = skipped.count
    found.pop(out.resolve(), None)
    return list(found.values())


def _explain(files: Sequence[Path], options: ReadOptions) -> None:
    for file in files:
        try:
            print("\n".join(explain(file, options)))
        except InputError as error:  # it is skipped later, for the same reason
            print(error)


def _joined(
    raw: Sequence[Path], done: dict[int, Retargeted], library: Library
) -> tuple[list[Motion], list[Clip]]:
    """Motions and clips of files and libraries; equal names of files get their folders'."""
    names = file_names(raw)
    read = [result.named(names[index]) for index, result in done.items()]
    motions = [r.motion for r in read] + library.motions
    clips = [r.clip for r in read] + library.clips
    # Alike for motions and clips: a library's motion is called as its clip is.
    return (
        [named(m, n) for m, n in zip(motions, numbered([m.name for m in motions]), strict=True)],
        [named(c, n) for c, n in zip(clips, numbered([c.name for c in clips]), strict=True)],
    )


def chain_motions(args: ChainArgs) -> None:
    """Write a library of chains.

    Raises:
        InputError: too few motions can be chained, or the library cannot be written; then there is
            no library.
    """
    from questsim.motion.varying.chain import LIMITS, can_be_chained, chains

    at_least(1, count=args.count, each=args.each)
    usable_seed(args.seed)
    check_library_path(args.out, args.spec)
    clips = load_motions(args.spec, seed=args.seed)
    made = [bare(chain) for chain in chains(clips, args.count, args.each, args.seed)]
    save_library(args.out, [], made)
    usable = sum(map(can_be_chained, clips))
    print(f"{usable} of {len(clips)} clips {LIMITS}")
    count = "1 chain" if len(made) == 1 else f"{len(made)} chains"
    print(f"{count}, {sum(clip.duration for clip in made):.0f} s, in {args.out}")
    licences = sorted({clip.licence or "not stated" for clip in made})
    print(f"licence: {', '.join(licences)}")


def check_library_path(out: Path, spec: str | Sequence[str] | None = None) -> None:
    """Refuse what cannot become a library, before the work begins.

    Args:
        out: the library to be written.
        spec: the motions that it is made of, as in ``load_motions``.

    Raises:
        InputError: the name has another ending, there is no such folder, it cannot be written, or
            the library would replace motions that it is made of.
    """
    if out.suffix.lower() != ".npz":
        raise InputError("a library's name ends in .npz", out)
    if not out.parent.is_dir():
        raise InputError("no such folder", out.parent, "create it first")
    if out.is_dir():
        raise InputError("is a folder", out, "choose another --out")
    try:
        with TemporaryFile(dir=out.parent):
            pass
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", out) from None
    if spec is not None and out.exists() and reads_file(spec, out):
        what = "is one of the motions, which the new library would replace"
        raise InputError(what, out, "choose another --out")


def _read(
    files: Sequence[Path],
    options: ReadOptions,
    skipped: _Skipped,
    explained: bool,
    mapper: PartMapper | None,
) -> dict[int, Retargeted]:
    """The files that can be used, by index; says of the first ones how they were read."""
    done: dict[int, Retargeted] = {}
    names = file_names(files)
    results = read_many(files, options, with_error=True, mapper=mapper)
    for index, result in enumerate(results):
        if isinstance(result, Refused):
            skipped.add(result.message)
            continue
        if len(done) < MAX_REPORTS:
            print(f"{names[index]}: {result.summary}")
            if explained:
                print(f"    {len(result.motion)} frames, {result.report}")
                print(f"    feet: {result.stance}")
        elif len(done) == MAX_REPORTS:
            print("... and more")
        for warning in result.warnings:
            print(f"warning: {names[index]}: {warning}", file=sys.stderr)
        done[index] = result
    return done


def start_mapping(args: MappingArgs) -> None:
    """Writes a mapping file for a motion file's skeleton.

    Raises:
        InputError: the motion cannot be read, or the file not be written.
    """
    if Path(args.out).suffix.lower() != ".toml":
        raise InputError("a mapping file's name ends in .toml", args.out)
    todo = write_mapping(read_as_recorded(Path(args.path)), Path(args.out))
    print(f"{args.out}: {todo}")


def fetch_dataset(args: FetchArgs) -> None:
    """Fetches a dataset into the cache; see ``datasets.fetch``."""
    fetch(args.name, args.mirror)


def list_motions(args: ListMotionsArgs) -> None:
    """Prints the kinds, and on request the clips, that a motion argument contains."""
    if not args.spec:
        if args.clips:
            raise InputError(
                "needs motions", "--clips", "name them: questsim motions list WHAT --clips"
            )
        _list_all()
        return
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
        print(" ".join([f"licence: {', '.join(licences)}.", *credit]))


def _list_all() -> None:
    """Prints the datasets and the kinds of embedded motions."""
    from questsim.motion.synthesis.synthetic import ACTIONS, KINDS, SEATED

    for name, dataset in DATASETS.items():
        here = "downloaded" if is_fetched(name) else f"get it with questsim motions fetch {name}"
        print(f"{name}: {dataset.title}, licence {dataset.licence}; {here}")
    kinds = textwrap.wrap(", ".join((*KINDS, *ACTIONS, *SEATED)), 94, break_on_hyphens=False)
    print("\n  ".join(["synthetic:KIND+KIND, embedded motions; the kinds are", *kinds]))


def _summary(clips: Sequence[Clip]) -> str:
    heights = [clip.height_m for clip in clips]
    low, high = min(heights), max(heights)
    tall = f"{low:.2f}" if high - low < 0.005 else f"{low:.2f}-{high:.2f}"
    return f"{len(clips):6d} {sum(clip.duration for clip in clips):8.0f} {tall:>10}"


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
