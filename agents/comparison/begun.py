"""Clips from the moment at which the avatar begins, see ``conditions.Start``."""

from __future__ import annotations

from collections.abc import Sequence

from agents.comparison.conditions import Start
from agents.kinematic.first_answers import first_answers, settled_after, settled_answers
from questsim.motion.clip import Clip


def begun(clip: Clip, start: Start) -> Clip:
    """The clip from the moment at which the avatar begins."""
    return clip.after(settled_after(clip)) if start == "estimate" else clip


def begun_in_estimates(
    clips: Sequence[Clip], start: Start
) -> tuple[Sequence[Clip], dict[str, Clip] | None]:
    """The clips from then on, and HMD-Poser's estimates in which avatars begin, if they do."""
    if start == "estimate":
        return settled_answers(clips)
    return clips, first_answers(clips) if start == "first-estimate" else None
