"""A live session without viewers: clip after clip, with a push in each, for a film."""

from __future__ import annotations

from agents.live.session import DemoSession
from questsim.motion.clip import FPS
from questsim.viewing.live import Snapshot
from questsim.viewing.live_film import Take

PUSH_AFTER = 0.45
"""The push comes after this part of a clip."""


def record(session: DemoSession, seconds: float, push_n: float = 0.0) -> list[Take]:
    """Takes that fill a time: the session's clip, then one of every other kind of motion, and on.

    Args:
        session: nobody else may advance it.
        seconds: length of all takes together.
        push_n: force in newtons of a push from one side, then from the other; none of them where
            the agent has no physics.
    """
    takes: list[Take] = []
    left, side = round(seconds * FPS), 90.0
    for name in session.playlist():
        session.change(clip=name)
        session.restart()
        moments = _take(session, left, push_n, side)
        takes.append(Take(session.settings, moments))
        left, side = left - len(moments), -side
        if left <= 0:
            break
    return takes


def _take(session: DemoSession, most: int, push_n: float, side: float) -> list[Snapshot]:
    """A clip from its first frame until it is over and the avatar has settled."""
    moments = [session.snapshot()]
    push_at = round(PUSH_AFTER * moments[0].duration_s * FPS)
    while len(moments) < most:
        if push_n and moments[0].physics and len(moments) == push_at:
            session.push(push_n, side)
        session.advance()
        moment = session.snapshot()
        if moment.time_s < moments[-1].time_s:  # it begins again
            break
        moments.append(moment)
    return moments
