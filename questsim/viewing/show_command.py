"""``questsim motions show``: look at a clip."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from questsim.errors import InputError, at_least, within
from questsim.evaluation_report import check_writable
from questsim.motion.clip import FPS, Clip
from questsim.motion_options import ShowArgs
from questsim.viewing.films import clip_frames, rollout_video
from questsim.viewing.gl import find_gl, missing_gl
from questsim.viewing.video import write_video

LIMITS = {"columns": (1, 40), "width": (64, 4096), "height": (64, 4096)}
"""Least and greatest values of options; not every OpenGL draws larger pictures."""

__all__ = ["ShowArgs", "rollout_video", "show_clip"]


def show_clip(args: ShowArgs) -> None:
    """Write OUT/CLIP.png, OUT/CLIP-feet.png and OUT/CLIP.mp4, and print their names.

    Without an OpenGL library the contact sheet has stick figures and one line on stderr says what
    to install for the video.

    Raises:
        InputError: there is no such clip, or an option is out of range.
    """
    from questsim.viewing.contact_sheet import contact_sheet
    from questsim.viewing.feet_sheet import feet_sheet

    _check_options(args)
    check_writable(args.out)
    clips = find_clips(args.clip, args.motions)
    for clip in clips:
        base = args.out / file_name(clip.name)
        sheet, film = base.with_name(f"{base.name}.png"), base.with_name(f"{base.name}.mp4")
        contact_sheet(clip, sheet, args.columns)
        print(sheet, flush=True)
        feet = base.with_name(f"{base.name}-feet.png")
        feet_sheet(clip, feet, args.columns)
        print(feet, flush=True)
        if args.video and find_gl():
            frames = clip_frames(clip, args.width, args.height, args.stride)
            write_video(film, frames, FPS / args.stride)
            print(film)
    if args.video and not find_gl():
        print(f"video skipped: {missing_gl()}", file=sys.stderr)


def _check_options(args: ShowArgs) -> None:
    """Refuse options that are out of range or have no effect.

    Raises:
        InputError: naming the option.
    """
    at_least(1, stride=args.stride)
    for option, limits in LIMITS.items():
        within(f"--{option}", *limits, **{option: getattr(args, option)})
    plain = ShowArgs(args.clip)
    for option in ("width", "height", "stride"):
        if not args.video and getattr(args, option) != getattr(plain, option):
            raise InputError("has no effect without a video", f"--{option}", "leave it out")
    if Path(args.clip).is_file() and args.motions != plain.motions:
        what = f"has no effect: {args.clip} is a file"
        raise InputError(what, "--motions", "leave it out, or name a clip")


def find_clips(name: str, motions: str) -> list[Clip]:
    """The clip called ``name`` in a motion argument, or the clips of the file ``name``.

    Raises:
        InputError: no such clip and no such file.
    """
    from questsim.motion.spec import load_motions

    if Path(name).is_file():
        return load_motions(name)
    clips = load_motions(motions)
    found = [clip for clip in clips if clip.name == name]
    if not found:
        similar = sorted(clip.name for clip in clips if name.lower() in clip.name.lower())
        shown = similar or sorted(clip.name for clip in clips)
        hint = ", ".join(shown[:5]) + (", ..." if len(shown) > 5 else "")
        raise InputError(f"no clip {name!r} and no such file", motions, f"it has {hint}")
    return found


def file_name(name: str) -> str:
    """A clip's name with only such characters as every file system takes."""
    return re.sub(r"[^\w.+-]+", "_", name).strip(".") or "clip"
