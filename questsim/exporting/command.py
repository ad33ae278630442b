"""The command ``questsim motions export``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TypeVar

from questsim.errors import InputError
from questsim.evaluation_report import check_writable
from questsim.exporting import write_clip, write_motion
from questsim.exporting.formats import SKELETONS, check_format, safe_names
from questsim.motion.clip import Clip
from questsim.motion.motion import Motion
from questsim.motion_options import ExportMotionsArgs

T = TypeVar("T", Clip, Motion)


def export_motions(args: ExportMotionsArgs) -> None:
    """Write every motion of a motion argument into a folder.

    Raises:
        InputError: there are no such motions, or a format or folder that cannot be used.
    """
    from questsim.motion.spec import check_seed, load_motions, load_recordings

    kind = check_format(args.format, "--format")
    own = "avatar" if kind in ("glb", "csv") else "joints"
    skeleton = args.skeleton or own
    if skeleton not in SKELETONS:
        raise InputError(f"{skeleton!r} is not one of {', '.join(SKELETONS)}", "--skeleton")
    if kind != "bvh" and skeleton != own:
        raise InputError(f"a {kind} file always has the {own}", "--skeleton", "leave it out")
    check_seed(args.spec, args.seed)
    check_writable(args.out)
    if skeleton == "avatar":
        clips = load_motions(args.spec, seed=args.seed)
        for clip, path in _files(args.out, kind, clips):
            write_clip(path, clip, "avatar")
    else:
        for motion, path in _files(args.out, kind, load_recordings(args.spec, seed=args.seed)):
            write_motion(path, motion)


def _files(folder: Path, kind: str, motions: Sequence[T]) -> Iterator[tuple[T, Path]]:
    """Each motion with its file; says in the end how many there were."""
    folder.mkdir(parents=True, exist_ok=True)
    names = safe_names([motion.name for motion in motions])
    for motion, name in zip(motions, names, strict=True):
        yield motion, folder / f"{name}.{kind}"
    print(f"{len(motions)} motion{'s' if len(motions) != 1 else ''} in {folder}")
