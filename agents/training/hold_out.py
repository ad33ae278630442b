"""``--hold-out``: styles that a training does not learn, and on which it compares checkpoints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from questsim.errors import InputError
from questsim.motion.clip import Clip
from questsim.motion.motion import Motion

T = TypeVar("T", Clip, Motion)


def without_styles(motions: Sequence[T], hold_out: str) -> tuple[list[T], list[T]]:
    """Clips or motions to learn, and those held out.

    Args:
        motions: all of them.
        hold_out: styles to hold out, separated by commas.

    Raises:
        InputError: no such style, or nothing is left to learn.
    """
    styles = {style.strip() for style in hold_out.split(",") if style.strip()}
    if hold_out and not styles:
        raise InputError("names no style", "--hold-out", "name one, or leave it out")
    unknown = styles - {motion.style for motion in motions}
    if unknown:
        known = ", ".join(sorted({motion.style for motion in motions if motion.style}))
        what = f"no clip has style {sorted(unknown)[0]!r}"
        raise InputError(what, "--hold-out", f"choose from {known or 'none'}")
    learnt = [motion for motion in motions if motion.style not in styles]
    if not learnt:
        raise InputError("no clips are left to train on", "--hold-out", "hold out fewer styles")
    return learnt, [motion for motion in motions if motion.style in styles]
