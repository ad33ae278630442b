"""Synthetic clips with random parameters, in any number, each generated independently.

``random_clips`` implements ``synthetic:random``, for training. ``held_out_clips`` implements
``synthetic:held-out``, for validation on kinds that are not used in training.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from questsim.body import DEFAULT_HEIGHT_M
from questsim.errors import InputError
from questsim.motion.clip import Clip
from questsim.motion.synthesis.action_kinds import ACTIONS, HELD_OUT
from questsim.motion.synthesis.gestures import WALKABLE
from questsim.motion.synthesis.synthetic import KINDS, SEATED, synthesise

TRAINED: tuple[str, ...] = tuple(kind for kind in (*KINDS, *ACTIONS) if kind not in HELD_OUT)
"""Kinds of ``random_clips``: all that need only a floor and are not held out."""
HEIGHTS_M = (1.55, 1.6, 1.65, 1.7, 1.75, 1.8, 1.85, 1.9)
"""A few statures only, since each needs its own body; every second clip is of 1.75 m."""
EACH = 4
"""Number of clips of a kind that is requested by name."""
SECONDS = (5.0, 9.0)


def random_clips(count: int, seed: int = 0, kinds: Sequence[str] = TRAINED) -> list[Clip]:
    """Clips with random kind, parameters, duration and stature.

    Kinds alternate, so that ``count`` clips have equally many of each. A clip depends only on the
    seed, its number and its kind.

    Args:
        count: how many.
        seed: same seed, same bits.
        kinds: of ``KINDS`` and ``ACTIONS``.

    Raises:
        InputError: the count or the seed is below zero, or a kind unknown or seated.
    """
    if count < 0 or seed < 0:
        what = f"count {count}" if count < 0 else f"seed {seed}"
        raise InputError(f"{what} is below zero")
    for kind in kinds:
        if kind not in (*KINDS, *ACTIONS):
            needs = " needs a chair" if kind in SEATED else " is not a kind of synthetic motion"
            raise InputError(f"{kind!r}{needs}", fix=f"choose from {', '.join(TRAINED)}")
    return [_random(kinds[number % len(kinds)], seed, number) for number in range(count)]


def held_out_clips(count: int, seed: int = 0) -> list[Clip]:
    """Like ``random_clips``, with the kinds in ``HELD_OUT``."""
    return random_clips(count, seed, HELD_OUT)


def action_clips(kinds: Sequence[str], seed: int = 0) -> list[Clip]:
    """Four clips of 7 s and 1.75 m of each of these actions."""
    return [
        synthesise(
            kind, duration=7.0, seed=EACH * seed + number, name=f"synthetic-{kind}-{number + 1}"
        )
        for kind in kinds
        for number in range(EACH)
    ]


def _random(kind: str, seed: int, number: int) -> Clip:
    rng = np.random.default_rng([seed, number, zlib.crc32(kind.encode())])
    tall = DEFAULT_HEIGHT_M if number % 2 == 0 else float(rng.choice(HEIGHTS_M))
    pace = float(np.sqrt(tall / DEFAULT_HEIGHT_M))
    return synthesise(
        kind,
        duration=float(rng.uniform(*SECONDS)) * pace,
        height_m=tall,
        seed=int(rng.integers(2**31)),
        name=f"synthetic-{kind}-random-{seed}-{number}",
        **_parameters(kind, pace, rng),
    )


def _parameters(kind: str, pace: float, rng: np.random.Generator) -> dict[str, Any]:
    """Random speed, turn, start and stop for kinds that travel; other kinds draw their own."""
    start, stop = (bool(rng.random() < 0.5) for _ in range(2))
    if kind in ("walk", "backwards") or kind.startswith("side-"):
        low, high = {"walk": (0.5, 2.1), "backwards": (0.3, 1.1)}.get(kind, (0.2, 0.55))
        speed = max(float(rng.uniform(low, high)) * pace, 0.5 if kind == "walk" else 0.0)
        return {"speed": speed, "start": start, "stop": stop}
    if kind == "jog":
        return {"speed": min(float(rng.uniform(1.65, 3.4)) * pace, 3.5)}
    if kind.startswith("turn-"):
        # Half of the turns are on the spot.
        speed = 0.0 if rng.random() < 0.5 else float(rng.uniform(0.4, 1.5))
        rate = float(rng.uniform(0.3, 1.4 if speed == 0.0 else min(1.2, 1.5 / speed)))
        turn: dict[str, Any] = {"speed": speed * pace, "turn_rate": rate / pace}
        return turn | {"start": start or speed == 0.0, "stop": stop or speed == 0.0}
    if kind in WALKABLE and rng.random() < 0.4:
        return {"speed": max(float(rng.uniform(0.6, 1.5)) * pace, 0.5)}
    return {}
