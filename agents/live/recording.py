"""A live session without viewers for a film: several clips with a push in each."""

from __future__ import annotations

from agents.live.session import DemoSession
from questsim.motion.clip import FPS
from questsim.viewing.live import Snapshot
from questsim.viewing.live_film import Take

PUSH_AFTER = 0.45
"""Time of the push as a share of the clip."""


def record(session: DemoSession, seconds: float, push_n: float = 0.0) -> list[Take]:
    """Takes of a given total length: the session's clip, then clips of the other kinds of motion.

    Args:
        session: must not be advanced by anyone else.
        seconds: total length of all takes.
        push_n: push force in newtons, alternating between the sides; agents without physics are
            not pushed.
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
    """A clip from its first frame until its end, when the avatar has settled."""
    moments = [session.snapshot()]
    push_at = round(PUSH_AFTER * moments[0].duration_s * FPS)
    while len(moments) < most:
        if push_n and moments[0].physics and len(moments) == push_at:
            session.push(push_n, side)
        session.advance()
        moment = session.snapshot()
        if moment.time_s < moments[-1].time_s:  # the clip restarts
            break
        moments.append(moment)
    return moments
