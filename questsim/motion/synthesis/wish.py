"""Requests for synthetic motion: kinds, their speeds, and checks of what is asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from questsim.body import DEFAULT_HEIGHT_M
from questsim.errors import InputError
from questsim.motion.clip import FPS
from questsim.motion.synthesis.action_kinds import ACTIONS, LEAST_ACTION_S
from questsim.motion.synthesis.gestures import GESTURES, WALKABLE
from questsim.motion.synthesis.seat import LEAST_SECONDS

MIN_SPEED, MAX_SPEED = 0.5, 3.5
MAX_WALK, MIN_JOG = 2.2, 1.6
"""m/s at 1.75 m; people change from walking to running near 2 m/s (Hreljac 1993)."""
MIN_SYNTHETIC_HEIGHT_M, MAX_SYNTHETIC_HEIGHT_M = 1.4, 2.0
MIN_SECONDS, MAX_SECONDS = 2.0, 60.0
MAX_TURN, MAX_CENTRIPETAL = 1.5, 2.5
"""rad/s at 1.75 m, and m/s^2 on a curve."""

_SPEEDS: dict[str, tuple[float, float, float]] = {
    "walk": (MIN_SPEED, 1.3, MAX_WALK),
    "jog": (MIN_JOG, 2.6, MAX_SPEED),
    "turn-left": (0.0, 1.0, 2.5),
    "turn-right": (0.0, 1.0, 2.5),
    "backwards": (0.3, 0.7, 1.1),
    "side-left": (0.2, 0.4, 0.55),
    "side-right": (0.2, 0.4, 0.55),
}
"""Kinds that travel: minimum, usual and maximum speed in m/s at 1.75 m."""

KINDS: tuple[str, ...] = ("stand", *_SPEEDS, *GESTURES)
"""Every kind of motion that needs only a floor."""
SEATED: tuple[str, ...] = ("sit",)
"""Kinds that need a chair; they are not in the library of ``synthetic_clips``."""


@dataclass(frozen=True)
class Wish:
    """A clip to make: of the default body, in its own time (see ``synthetic``'s docstring)."""

    kind: str
    seconds: float
    rate: float
    speed: float
    turn_rate: float
    start: bool
    stop: bool


def checked(
    kind: str,
    speed: float | None,
    turn_rate: float | None,
    duration: float,
    height_m: float,
    start: bool,
    stop: bool,
) -> Wish:
    """The request in the default body's own time, with defaults filled in; see ``synthesise``."""
    if kind not in (*KINDS, *ACTIONS, *SEATED):
        known = ", ".join((*KINDS, *ACTIONS, *SEATED))
        raise InputError(f"unknown kind of synthetic motion {kind!r}", fix=f"choose from {known}")
    _within("height", height_m, MIN_SYNTHETIC_HEIGHT_M, MAX_SYNTHETIC_HEIGHT_M, "m")
    _within("duration", duration, MIN_SECONDS, MAX_SECONDS, "s")
    pace = float(np.sqrt(height_m / DEFAULT_HEIGHT_M))
    if kind in SEATED or kind in ACTIONS:
        least_s = LEAST_SECONDS if kind in SEATED else LEAST_ACTION_S
        _within("duration", duration, least_s * pace, MAX_SECONDS, "s")
        if start or stop:
            raise InputError(f"{kind} begins and ends standing", fix="leave start and stop out")
    if speed is not None and kind not in (*_SPEEDS, *WALKABLE):
        raise InputError(f"{kind} has no speed", fix="leave the speed out")
    least, usual, most = _SPEEDS.get(kind, _SPEEDS["walk"])
    if speed is None:
        speed = usual * pace if kind in _SPEEDS else 0.0
    elif kind == "walk":
        _within("walking speed", speed, MIN_SPEED, most * pace, "m/s")
    elif kind == "jog":
        _within("jogging speed", speed, least * pace, MAX_SPEED, "m/s")
    else:
        _within(f"speed of {kind}", speed, least * pace, most * pace, "m/s")
    if kind.startswith("turn"):
        turn_rate = 0.8 if turn_rate is None else turn_rate
        _within("turn rate", turn_rate, 0.1, MAX_TURN / pace, "rad/s")
        _within("speed times turn rate", speed * turn_rate, 0.0, MAX_CENTRIPETAL, "m/s^2")
    elif turn_rate is not None:
        raise InputError(f"{kind} has no turn rate", fix="use turn-left or turn-right")
    if (start or stop) and (kind == "jog" or speed > MAX_WALK * pace):
        raise InputError("a jog neither starts nor stops", fix="leave start and stop out")
    return Wish(
        kind=kind,
        seconds=duration / pace,
        rate=FPS * pace,
        speed=speed / pace,
        turn_rate=(turn_rate or 0.0) * pace,
        start=start,
        stop=stop,
    )


def check_seed(seed: int) -> None:
    """Reject a negative seed."""
    if seed < 0:
        raise InputError(f"seed {seed} is below zero")


def _within(what: str, value: float, least: float, most: float, unit: str) -> None:
    if not least - 1e-9 <= value <= most + 1e-9:
        raise InputError(f"{what} {value:g} {unit} is outside {least:g}-{most:g} {unit}")
