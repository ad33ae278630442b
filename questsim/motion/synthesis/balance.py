"""The path of the body over its feet: balance in the plane, height and flight.

The centre of mass obeys the equation of a point mass above its centre of pressure,
``c'' = (z'' + g) / z (c - p)`` (Kajita et al., "Biped walking pattern generation by using preview
control of zero-moment point", ICRA 2003, eq. 9, with a height that varies): solved for a whole
clip it gives sway, changes of speed, the shift of weight before a first step and the lean into a
turn; in flight, where ``z'' = -g``, a straight line.
"""

from __future__ import annotations

import numpy as np
import scipy  # it imports its parts on first use

from questsim.motion.synthesis.feet import Feet
from questsim.motion.synthesis.gait_curves import GRAVITY, Gait
from questsim.motion.synthesis.plan import Steps
from questsim.motion.synthesis.pose import (
    FULL_STRETCH,
    JOGGING_STRETCH,
    Posture,
    highest_root,
    link_centers,
    solve,
    world,
)

_ROUNDS = 3
"""Iterations after which the centre of mass's offset from the root is settled to below 1 mm."""


def balanced_path(cop: np.ndarray, height: np.ndarray, time: np.ndarray) -> np.ndarray:
    """``(T, 2)`` path of a point mass at heights ``(T,)`` over centres of pressure ``(T, 2)``.

    At both ends the mass is above the centre of pressure.
    """
    step = time[1] - time[0]
    support = (np.gradient(np.gradient(height, step), step) + GRAVITY).clip(0.0) / height * step**2
    support[[0, -1]] = 1.0
    diagonal, beside = 2.0 + support, -np.ones(len(time))
    diagonal[[0, -1]] = 1.0
    above, below = beside.copy(), beside.copy()
    above[[0, 1]], below[[-1, -2]] = 0.0, 0.0
    return scipy.linalg.solve_banded(
        (1, 1), np.stack([above, diagonal, below]), support[:, None] * cop
    )


def settle(
    posture: Posture,
    feet: Feet,
    height: np.ndarray,
    cop: np.ndarray,
    time: np.ndarray,
    jog: bool,
    shown: slice = slice(None),
    moments: bool | None = None,
) -> np.ndarray:
    """The poses ``(T, 40)`` whose centre of mass balances over the centres of pressure.

    Args:
        posture: the upper body.
        feet: where the feet are.
        height: ``(T,)`` desired height of the root in metres; lowered where a leg is too short.
        cop: ``(T, 2)`` centre of pressure.
        time: ``(T,)`` seconds.
        jog: whether the height is ballistic and may only be lowered as a whole.
        shown: the frames that are kept.
        moments: whether swinging limbs move the pressure; by default unless jogging.
    """
    moments = not jog if moments is None else moments
    pelvis = world(posture.heading, posture.pelvis)
    offset = np.zeros((len(time), 3))
    offset[:, 2] = 0.07
    root = np.column_stack([cop, height])
    stretch = JOGGING_STRETCH if jog else FULL_STRETCH
    qpos, wanted = np.empty(0), cop
    for _ in range(_ROUNDS):
        root[:, :2] = balanced_path(wanted, root[:, 2] + offset[:, 2], time) - offset[:, :2]
        root[:, 2] = height
        excess = root[:, 2] - highest_root(feet, root, pelvis, stretch)
        root[:, 2] -= max(excess[shown].max(), 0.0) if jog else lowering(excess, time)
        qpos = solve(posture, root, feet)
        centers, share = link_centers(qpos)
        offset = np.einsum("l,tlk->tk", share, centers) - root
        if moments:
            wanted = cop - _swing_moment(centers, share, time[1] - time[0])
    return qpos


def _swing_moment(centers: np.ndarray, share: np.ndarray, step: float) -> np.ndarray:
    """Shift ``(T, 2)`` of the pressure by the links ``(T, 16, 3)``, relative to a point mass.

    The second stage of Kajita et al. 2003, eq. 16: legs that swing push the body back.
    """

    def pressure(points: np.ndarray, share: np.ndarray) -> np.ndarray:
        push = np.gradient(np.gradient(points, step, axis=0), step, axis=0)
        along, up = push[..., :2], push[..., 2:] + GRAVITY
        moment = np.einsum("l,tlk->tk", share, up * points[..., :2] - along * points[..., 2:])
        force = np.einsum("l,tl->t", share, up[..., 0])
        return moment / np.maximum(force, 0.3 * GRAVITY)[:, None]

    middle = np.einsum("l,tlk->tk", share, centers)[:, None]
    return scipy.ndimage.gaussian_filter1d(
        pressure(centers, share) - pressure(middle, np.ones(1)), 0.03 / step, axis=0
    )


def lowering(excess: np.ndarray, time: np.ndarray) -> np.ndarray:
    """A smooth upper bound of the excess height ``(T,)``."""
    frames = 0.03 / (time[1] - time[0])
    wide = -scipy.ndimage.minimum_filter1d(-excess.clip(0.0), 2 * int(np.ceil(3.0 * frames)) + 1)
    return scipy.ndimage.gaussian_filter1d(wide, frames, truncate=3.0)


def walking_height(gait: Gait, steps: Steps, standing: float) -> np.ndarray:
    """Desired height ``(T,)`` of the root: highest in the middle of each single support."""
    wave = np.cos(4.0 * np.pi * (steps.phase - 0.5 * gait.duty))
    return standing - 0.004 * steps.amount + gait.bob_m * steps.amount * (wave - 1.0)


def jogging_height(gait: Gait, steps: Steps, standing: float) -> np.ndarray:
    """Height ``(T,)`` of the root when each foot pushes as a half sine and then flies.

    Twice integrated from ``z'' = a sin(pi s / contact) - g``, the half sine's size such that
    pushes balance the weight over a step (Alexander 1989, "Optimization and gaits", eq. 3).
    """
    step = 0.5 * gait.stride_s
    contact = gait.duty * gait.stride_s
    flight = step - contact
    s = np.mod(2.0 * steps.phase, 1.0) * step
    size = GRAVITY * np.pi * step / (2.0 * contact)
    speed = -0.5 * GRAVITY * flight
    w = np.pi / contact
    # In contact: rate = speed + size / w (1 - cos w s) - g s.
    push = speed * s + size / w * (s - np.sin(w * s) / w) - 0.5 * GRAVITY * s * s
    fly = s - contact
    flying = 0.5 * GRAVITY * fly * (flight - fly)
    bounce = np.where(s < contact, push, flying)
    return standing + bounce
