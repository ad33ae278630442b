"""Stance and swing phases of each foot of a clip.

On uneven ground a stance foot is at the height of the ground, and a swing foot moves from one
height to the next. So the reference needs, for each frame, the stances before and after it. They
are found once for each clip, from the height and speed of the soles.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from questsim.body import DEFAULT_HEIGHT_M
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import sole_positions
from questsim.skeleton import FOOT_LINKS

STANDING_M = 0.04
"""In stance a sole point is lower than this ..."""
STANDING_M_S = 0.5
"""... and slower than this."""
STAYS_S = 0.8
"""A stance of twice this duration counts as standing, one shorter than this as a step."""
SLIDES_M = 0.08
"""A foot that slides this far during a stance begins a new stance."""


class Footsteps(NamedTuple):
    """Phases of ``F`` frames of all clips and two feet, all ``(F, 2)``; rows as in ``Reference``.

    Attributes:
        before, after: rows of the stances before and after; the same while a foot stands still.
        first, last: rows between which the foot moves from the one to the other.
        swings: whether it is in the air in between.
        stays: 0 for the stance of a step, 1 for a stance long enough to count as standing.
    """

    before: np.ndarray
    after: np.ndarray
    first: np.ndarray
    last: np.ndarray
    swings: np.ndarray
    stays: np.ndarray


def footsteps_of(clips: Sequence[Clip]) -> Footsteps:
    """The steps of clips of the 1.75 m body, one clip after the other."""
    parts, begin = [np.zeros((6, 0, 2))], 0
    for clip in clips:
        columns = [steps_of_foot(*_soles(clip, foot)) for foot in range(2)]
        parts.append(np.stack(columns, axis=-1))
        parts[-1][:4] += begin
        begin += len(clip)
    rows = np.concatenate(parts, axis=1)
    before, after, first, last = rows[:4].astype(np.int64)
    return Footsteps(before, after, first, last, rows[4].astype(bool), rows[5])


def _soles(clip: Clip, foot: int) -> tuple[np.ndarray, np.ndarray]:
    """Whether a foot is in stance ``(F,)``, and the centre of its sole ``(F, 2)``."""
    feet = list(FOOT_LINKS)
    soles = sole_positions(clip.link_position[:, feet], clip.link_quat[:, feet], DEFAULT_HEIGHT_M)
    points = soles[:, foot]
    frames = np.arange(len(points))
    speed = np.linalg.norm(np.gradient(points, axis=0), axis=-1) * FPS
    lowest = points[..., 2].argmin(axis=-1)
    low = points[frames, lowest, 2] < STANDING_M
    return low & (speed[frames, lowest] < STANDING_M_S), points[..., :2].mean(axis=1)


def steps_of_foot(stands: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Fields of ``Footsteps`` ``(6, F)`` of one foot of one clip, rows counted from its first."""
    count = len(stands)
    if not stands.any():  # never in stance: use the ground below the foot
        rows = np.arange(count)
        return np.stack([rows, rows, rows, rows, np.zeros(count), np.zeros(count)])
    out = np.zeros((6, count))
    edges = np.flatnonzero(np.diff(np.r_[False, stands, False].astype(int)))
    earlier: tuple[int, int] | None = None  # the last stance's row, and its last frame
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        places = _places(middle[begin:end]) + begin
        share = np.clip((end - begin) / FPS / STAYS_S - 1.0, 0.0, 1.0)
        out[5, begin:end] = share * share * (3.0 - 2.0 * share)
        first, last = places[0], places[-1]
        if earlier is None:
            _fill(out, 0, first + 1, first, first)
        else:
            row, left = earlier
            _fill(out, left + 1, begin, row, first, left, begin, True)
            _fill(out, begin, first + 1, first, first)
        for one, other in pairwise(places):
            _fill(out, one + 1, other + 1, one, other, one, other)
        _fill(out, last + 1, end, last, last)
        earlier = (last, end - 1)
    assert earlier is not None
    _fill(out, earlier[1] + 1, count, earlier[0], earlier[0])
    return out


def _fill(
    out: np.ndarray,
    begin: int,
    end: int,
    before: int,
    after: int,
    first: int = 0,
    last: int = 0,
    swings: bool = False,
) -> None:
    out[:5, begin:end] = np.array([before, after, first, last, int(swings)])[:, None]


def _places(middle: np.ndarray) -> np.ndarray:
    """Frames at which a stance is placed: one, or several if the foot slides."""
    places, begin = [], 0
    for frame in range(1, len(middle) + 1):
        over = frame == len(middle)
        if over or np.linalg.norm(middle[frame] - middle[begin]) > SLIDES_M:
            places.append((begin + frame - 1) // 2)
            begin = frame
    return np.array(places)
