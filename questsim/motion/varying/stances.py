"""Changes of the feet and of the path that do not make a stance foot slide.

A change is a function of time. Each stance uses its value in mid-stance; during the swing the
foot moves to the value of the next stance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_closing, gaussian_filter1d

from questsim import rotations as rot
from questsim.motion.clip import FPS
from questsim.motion.synthesis.balance import balanced_path
from questsim.motion.synthesis.plan import smoothstep
from questsim.motion.varying.figure import Figure

GAP_FRAMES = 3
"""Contacts with a shorter interruption count as one stance."""
STEPPING_S = 0.25
"""Within this time of a step the path may drift."""


def stances(contact: np.ndarray) -> list[tuple[int, int]]:
    """(first, last) frame of every stance of one foot's contacts ``(T,)``."""
    padded = np.pad(contact, GAP_FRAMES, mode="edge")
    closed = binary_closing(padded, np.ones(GAP_FRAMES))[GAP_FRAMES:-GAP_FRAMES]
    edges = np.diff(np.concatenate([[0], closed.astype(int), [0]]))
    first, past = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return [(int(a), int(b) - 1) for a, b in zip(first, past, strict=True)]


def held_time(contact: np.ndarray) -> np.ndarray:
    """The frame ``(T,)`` whose change a foot takes: constant over each stance."""
    frames = np.arange(len(contact), dtype=float)
    found = stances(contact)
    if not found:
        return frames
    out = np.empty(len(contact))
    middles = [0.5 * (first + last) for first, last in found]
    out[: found[0][0]] = middles[0]
    out[found[-1][1] + 1 :] = middles[-1]
    for middle, (first, last) in zip(middles, found, strict=True):
        out[first : last + 1] = middle
    for number in range(len(found) - 1):
        lift, touch = found[number][1], found[number + 1][0]
        inside = slice(lift + 1, touch)
        share = smoothstep((frames[inside] - lift) / (touch - lift))
        out[inside] = middles[number] + share * (middles[number + 1] - middles[number])
    return out


def steps(figure: Figure) -> np.ndarray:
    """``(T,)`` 1 where the feet step, 0 where both stay, smooth between."""
    up = ~figure.contacts.all(axis=1)
    near = gaussian_filter1d(up.astype(float), STEPPING_S * FPS, mode="nearest")
    return smoothstep(near / 0.25)


@dataclass(frozen=True)
class Drift:
    """Deviation from the recorded path while the feet step.

    Attributes:
        sideways, forwards: in m/s of the default body.
        turning: in rad/s.
    """

    sideways: float
    forwards: float
    turning: float


def drift_path(figure: Figure, drift: Drift) -> None:
    """Move the figure along another path; every stance foot stays where it lands."""
    step = steps(figure)
    turn = np.cumsum(step) * drift.turning / FPS
    old = figure.root[:, :2].copy()
    heading = figure.heading
    aside = np.stack(
        [
            np.cos(heading) * drift.forwards - np.sin(heading) * drift.sideways,
            np.sin(heading) * drift.forwards + np.cos(heading) * drift.sideways,
        ],
        axis=-1,
    )
    moved = np.diff(old, axis=0, prepend=old[:1]) + step[:, None] * aside / FPS
    new = old[0] + np.cumsum(_turned(moved, turn), axis=0)
    figure.center = new + _turned(figure.center - old, turn)
    figure.root[:, :2] = new
    figure.pelvis = rot.quat_multiply(rot.yaw_quat(turn), figure.pelvis)
    for foot in range(2):
        at = held_time(figure.contacts[:, foot])
        there, gone, came = _at(turn, at), _at(old, at), _at(new, at)
        place = figure.ankle[:, foot, :2]
        figure.ankle[:, foot, :2] = came + _turned(place - gone, there)
        figure.foot[:, foot] = rot.quat_multiply(rot.yaw_quat(there), figure.foot[:, foot])
        figure.thigh[:, foot] = rot.quat_multiply(rot.yaw_quat(there), figure.thigh[:, foot])


def place_feet(figure: Figure, apart: float, ahead: float, toe_out: float) -> None:
    """Move both feet; the body balances over their new positions.

    Args:
        figure: changed in place.
        apart: metres by which the feet are farther apart.
        ahead: metres by which the left foot is farther ahead of the right one.
        toe_out: radians by which each foot points farther out.
    """
    shifts = np.zeros((2, len(figure), 2))
    heading = figure.heading
    for foot, side in enumerate((1.0, -1.0)):
        at = held_time(figure.contacts[:, foot])
        yaw = _at(heading, at)
        own = np.broadcast_to([0.5 * side * ahead, 0.5 * side * apart], (len(figure), 2))
        shifts[foot] = _turned(own, yaw)
        figure.ankle[:, foot, :2] += shifts[foot]
        turn = rot.yaw_quat(np.full(len(figure), side * toe_out))
        figure.foot[:, foot] = rot.quat_multiply(turn, figure.foot[:, foot])
    move_pressure(figure, _mean_under_load(figure, shifts))


def _mean_under_load(figure: Figure, shifts: np.ndarray) -> np.ndarray:
    """Mean ``(T, 2)`` of the feet's shifts ``(2, T, 2)``, weighted by their load."""
    load = gaussian_filter1d(figure.contacts.astype(float), 2.0, axis=0, mode="nearest") + 1e-3
    load /= load.sum(axis=1, keepdims=True)
    return np.einsum("tf,ftk->tk", load, shifts)


def move_pressure(figure: Figure, pressure: np.ndarray) -> None:
    """Rebalance the body over centres of pressure shifted by ``(T, 2)`` metres.

    The centre of mass obeys a linear equation, so its changes obey the same one.
    """
    height = np.full(len(figure), max(float(figure.root[:, 2].mean()), 0.3) + 0.07)
    figure.center = figure.center + balanced_path(pressure, height, figure.time)


def _turned(vector: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Vectors ``(T, 2)`` on the floor, turned by ``(T,)`` radians."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y = vector[:, 0], vector[:, 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def _at(values: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Values ``(T, ...)`` at fractional frames ``(T,)``."""
    low = np.clip(np.floor(frame).astype(int), 0, len(values) - 1)
    high = np.minimum(low + 1, len(values) - 1)
    share = (frame - low).reshape(-1, *([1] * (values.ndim - 1)))
    return (1.0 - share) * values[low] + share * values[high]
