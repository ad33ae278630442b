"""``questsim motions show``: look at a clip."""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from questsim.errors import InputError, at_least
from questsim.motion.clip import FPS, Clip
from questsim.viewing.films import clip_frames, rollout_video
from questsim.viewing.gl import find_gl, missing_gl
from questsim.viewing.video import write_video

__all__ = ["ShowArgs", "rollout_video", "show_clip"]


@dataclass(frozen=True)
class ShowArgs:
    """Draw a clip: a contact sheet PNG, one of its feet close up, and an MP4."""

    clip: Annotated[str, tyro.conf.Positional]
    """A clip's name in --motions, or a library, BVH or npz file."""
    motions: str = "synthetic"
    """Where to look the name up: synthetic, a dataset, a library file or a folder."""
    out: Path = Path("shown")
    """The folder for the PNG and the MP4."""
    video: bool = True
    """Whether to make the MP4."""
    columns: int = 8
    """Pictures in a row of the contact sheet."""
    width: int = 640
    """Width of the video in pixels."""
    height: int = 480
    """Height of the video in pixels."""
    stride: int = 1
    """Film every n-th frame; the video keeps its speed."""


def show_clip(args: ShowArgs) -> None:
    """Write OUT/CLIP.png, OUT/CLIP-feet.png and OUT/CLIP.mp4, and print their names.

    Without an OpenGL library the contact sheet has stick figures and one line on stderr says what
    to install for the video.

    Raises:
        InputError: there is no such clip, or an option is out of range.
    """
    from questsim.viewing.contact_sheet import contact_sheet
    from questsim.viewing.feet_sheet import feet_sheet

    at_least(1, columns=args.columns, stride=args.stride)
    at_least(64, width=args.width, height=args.height)
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
