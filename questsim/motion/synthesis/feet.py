"""The paths of the feet in a synthetic motion: rolling on the floor, then swinging.

A foot on the floor rolls over its heel, lies flat, and rolls over its ball: the two round ends of
the avatar's soles turn on the floor without sliding.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
import scipy  # it imports its parts on first use

from questsim.body import build_body
from questsim.motion.kinematics import link_offsets, sole_points
from questsim.motion.synthesis.gait_curves import Gait, SwingShape, swing_shape
from questsim.motion.synthesis.plan import Stance, Steps, smoothstep
from questsim.skeleton import LINKS

LEAVING_M_S = 0.15
"""Speed with which the ball leaves the floor, so that it does not brush along it."""
FULL_STRIDE_M = 0.9
"""A foot that moves at least this far swings with the full normative shape."""
BRAKING = 4.0
"""Deceleration at touch-down, in step lengths per squared swing time (min-jerk would be 0)."""
HANG_S = 0.07
"""After toe-off and before touch-down the foot rolls in line with the leg, or level, this fast."""
_STEP = 1e-3


@dataclass(frozen=True)
class Feet:
    """Both feet over time.

    Attributes:
        ankle: ``(2, T, 3)`` in metres.
        yaw, pitch: ``(2, T)`` in radians, heel up is positive.
        hanging: ``(2, T)`` 0 where the sole stays level sideways, 1 where the foot hangs in line
            with the leg.
    """

    ankle: np.ndarray
    yaw: np.ndarray
    pitch: np.ndarray
    hanging: np.ndarray


@lru_cache(maxsize=1)
def sole_shape() -> tuple[float, float, float, float]:
    """Default body: heel's and ball's distance ahead of the ankle, height, radius; in metres."""
    points = sole_points()[0]
    radius = float(build_body().model.geom("left_heel_ball_outer").size[0])
    return (
        float(points[:, 0].min()),
        float(points[:, 0].max()),
        float(-points[:, 2].mean()),
        radius,
    )


@lru_cache(maxsize=1)
def leg_lengths() -> tuple[float, float, float]:
    """Lengths of thigh and shank and half the hip distance of the default body in metres."""
    offsets = link_offsets()
    return (
        float(-offsets[LINKS.index("left_shin"), 2]),
        float(-offsets[LINKS.index("left_foot"), 2]),
        float(offsets[LINKS.index("left_thigh"), 1]),
    )


def feet_paths(steps: Steps, gait: Gait, time: np.ndarray) -> Feet:
    """Positions and attitudes of both feet at the times ``(T,)``."""
    level = np.zeros((2, len(time)))
    feet = Feet(np.zeros((2, len(time), 3)), level.copy(), level.copy(), level)
    shape = swing_shape(gait.jog)
    for foot in range(2):
        stances = steps.stances[foot]
        for s in stances:
            on = (time >= s.touch) & (time <= s.lift)
            ankle, pitch = stance_pose(s, time[on])
            feet.ankle[foot, on], feet.pitch[foot, on], feet.yaw[foot, on] = ankle, pitch, s.yaw
        for a, b in pairwise(stances):
            on = (time > a.lift) & (time < b.touch)
            ankle, yaw, pitch = _swing(a, b, shape, gait, time[on])
            feet.ankle[foot, on], feet.yaw[foot, on], feet.pitch[foot, on] = ankle, yaw, pitch
            to_end = np.minimum(time[on] - a.lift, b.touch - time[on])
            feet.hanging[foot, on] = smoothstep(to_end / HANG_S)
        _hold_ends(feet, stances, time, foot)
    return feet


def _hold_ends(feet: Feet, stances: list[Stance], time: np.ndarray, foot: int) -> None:
    """Holds the foot still before the first and after the last stance (in the cropped margin)."""
    for s, outside in (
        (stances[0], time < stances[0].touch),
        (stances[-1], time > stances[-1].lift),
    ):
        if outside.any():
            edge = np.array([np.clip(time[outside][0], s.touch, s.lift)])
            ankle, pitch = stance_pose(s, edge)
            feet.ankle[foot, outside], feet.pitch[foot, outside] = ankle, pitch
            feet.yaw[foot, outside] = s.yaw


def stance_pose(s: Stance, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ankle ``(T, 3)`` and pitch ``(T,)`` of a standing foot."""
    strike = s.strike_pitch * (1.0 - smoothstep((time - s.touch) / s.flat_s))
    rise = np.clip(1.0 - (s.lift - time) / s.rise_s, 0.0, None)
    pitch = strike + s.push_pitch * rise**2.4
    ahead, up = roll(pitch)
    direction = np.array([np.cos(s.yaw), np.sin(s.yaw)])
    ankle = np.concatenate([s.ankle + ahead[:, None] * direction, up[:, None]], axis=-1)
    return ankle, pitch


def roll(pitch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ankle offset from its flat-foot position, forward and up, for a foot rolled to ``pitch``."""
    heel, ball, height, radius = sole_shape()
    pivot = np.where(pitch > 0, ball, heel)
    below = height - radius
    cos, sin = np.cos(pitch), np.sin(pitch)
    # The centre of the round end moves on by radius * angle; the ankle turns about it.
    ahead = pivot + radius * pitch - (cos * pivot - sin * below)
    up = radius + sin * pivot + cos * below
    return ahead, up


def _swing(
    a: Stance, b: Stance, shape: SwingShape, gait: Gait, time: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ankle ``(T, 3)``, yaw and pitch ``(T,)`` between two stances, joined smoothly to both."""
    span = b.touch - a.lift
    u = (time - a.lift) / span
    distance = float(np.linalg.norm(b.ankle - a.ankle))
    full = min(distance / FULL_STRIDE_M, 1.0)
    leave, arrive = _motion_at(a, a.lift, -_STEP), _motion_at(b, b.touch, _STEP)
    # As in people, the foot still moves at touch-down; it does not hover above its target.
    stride = (b.ankle - a.ankle) / max(distance, 1e-6)
    arrive[1, :2] += gait.impact[0] * full * stride
    arrive[1, 2] -= gait.impact[1] * (0.5 + 0.5 * full)
    leave[1, 2] += LEAVING_M_S
    arrive[2, :2] = -BRAKING * (b.ankle - a.ankle) / span**2
    ankle = np.empty((len(time), 3))
    for k in range(2):
        ankle[:, k] = quintic(leave[:, k], arrive[:, k], span, u)
    template = gait.lift * sum(leg_lengths()[:2]) * (0.35 + 0.65 * full)
    ankle[:, 2] = _shaped(template, shape.height, leave[:, 2], arrive[:, 2], span, u)
    pitch = _shaped(full, shape.pitch, leave[:, 3], arrive[:, 3], span, u)
    low = _lowest(ankle[:, 2], pitch)
    bell = (4.0 * u * (1.0 - u)) ** 2
    short = np.max((gait.clearance_m - low) * (bell > 0.3), initial=0.0)
    ankle[:, 2] += short * bell
    return ankle, a.yaw + (b.yaw - a.yaw) * smoothstep(u), pitch


def _lowest(height: np.ndarray, pitch: np.ndarray) -> np.ndarray:
    """Clearance of the sole below the lower end of a foot with this ankle height."""
    return height - roll(pitch)[1]


def _motion_at(s: Stance, time: float, step: float) -> np.ndarray:
    """``(3, 4)`` value, rate and second rate of ankle and pitch, differences within the stance."""
    times = time + step * np.arange(3.0)
    ankle, pitch = stance_pose(s, times)
    p = np.concatenate([ankle, pitch[:, None]], axis=-1)
    second = (p[0] - 2.0 * p[1] + p[2]) / step**2
    rate = (p[1] - p[0]) / step - 0.5 * step * second
    return np.stack([p[0], rate, second])


def _shaped(
    scale: float,
    curve: scipy.interpolate.CubicSpline,
    leave: np.ndarray,
    arrive: np.ndarray,
    span: float,
    u: np.ndarray,
) -> np.ndarray:
    """A normative curve, bent by a quintic so that it joins both stances."""
    ends = []
    for at, end in ((0.0, leave), (1.0, arrive)):
        own = np.array([curve(at, n) / span**n for n in range(3)]) * scale
        ends.append((end - own) * [1.0, 1.0, 0.0])
    return scale * curve(u) + quintic(ends[0], ends[1], span, u)


def quintic(start: np.ndarray, end: np.ndarray, span: float, u: np.ndarray) -> np.ndarray:
    """The quintic with the given (value, rate, second rate) at ``u = 0`` and ``u = 1``."""
    p0, v0, a0 = start * [1.0, span, span**2]
    p1, v1, a1 = end * [1.0, span, span**2]
    d = p1 - p0 - v0 - 0.5 * a0
    e, f = v1 - v0 - a0, a1 - a0
    c3 = 10.0 * d - 4.0 * e + 0.5 * f
    c4 = -15.0 * d + 7.0 * e - f
    c5 = 6.0 * d - 3.0 * e + 0.5 * f
    return p0 + u * (v0 + u * (0.5 * a0 + u * (c3 + u * (c4 + u * c5))))
