"""Plans the path, the steps and their timing for a synthetic motion.

Everything is for the default body, in metres and seconds; ``synthetic.py`` scales.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy  # it imports its parts on first use

from questsim.motion.synthesis.gait_curves import Gait

FOREVER = np.inf
COP_HEEL_M, COP_MID_M, COP_BALL_M = 0.04, 0.125, 0.145
"""Centre of pressure ahead of the ankle at touch-down, in mid-stance and at toe-off."""
COP_STANDING_M = 0.05
"""The same when standing (Winter 1995, "Human balance and posture control")."""
STANDING_WIDTH_M = 0.17
"""Distance in metres between the ankles when standing before or after walking."""
LAST_STEP_M, LAST_TURN = 0.03, np.deg2rad(6.0)
"""A foot this close to where the path ends takes no further step."""


@dataclass(frozen=True)
class Stance:
    """One foot on the floor from touch-down to toe-off.

    Attributes:
        touch, lift: times in seconds; minus or plus infinity if outside the clip.
        ankle: ``(2,)`` the ankle's place on the floor while the foot is flat.
        yaw: direction of the foot in radians.
        strike_pitch, push_pitch: of the foot at touch-down and toe-off, heel up is positive.
        flat_s, rise_s: seconds until the foot is flat, and from heel-rise to toe-off.
    """

    touch: float
    lift: float
    ankle: np.ndarray
    yaw: float
    strike_pitch: float = 0.0
    push_pitch: float = 0.0
    flat_s: float = 0.1
    rise_s: float = 0.3


@dataclass(frozen=True)
class Path:
    """Where the body goes, at the times ``time`` ``(T,)``.

    Attributes:
        time: seconds.
        velocity: ``(T, 2)`` forward and leftward, along the heading, in m/s.
        turn_rate: ``(T,)`` rad/s.
        heading: ``(T,)`` radians.
        position: ``(T, 2)`` in metres on the floor.
    """

    time: np.ndarray
    velocity: np.ndarray
    turn_rate: np.ndarray
    heading: np.ndarray = field(init=False)
    position: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        heading = scipy.integrate.cumulative_trapezoid(self.turn_rate, self.time, initial=0.0)
        cos, sin = np.cos(heading), np.sin(heading)
        forward, left = self.velocity.T
        world = np.stack([cos * forward - sin * left, sin * forward + cos * left], axis=-1)
        position = scipy.integrate.cumulative_trapezoid(world, self.time, axis=0, initial=0.0)
        # The clip's first frame, at time zero, lies at the origin and faces +x.
        start = np.searchsorted(self.time, -1e-9)
        turn = -heading[start]
        back = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        object.__setattr__(self, "heading", heading + turn)
        object.__setattr__(self, "position", (position - position[start]) @ back.T)

    def at(self, time: float) -> tuple[np.ndarray, float]:
        """Position ``(2,)`` and heading at a time; the ends hold."""
        position = [np.interp(time, self.time, p) for p in self.position.T]
        return np.array(position), float(np.interp(time, self.time, self.heading))

    def amount(self) -> np.ndarray:
        """Share ``(T,)`` of the clip's top speed (a turn on the spot counts as speed)."""
        speed = np.linalg.norm(self.velocity, axis=-1) + 0.5 * np.abs(self.turn_rate)
        return speed / max(float(speed.max()), 1e-9)


@dataclass(frozen=True)
class Steps:
    """The stances of both feet and the phase of the left foot's stride.

    Attributes:
        stances: for the left and the right foot, in order of time.
        phase: ``(T,)`` strides; whole at the left foot's touch-down.
        amount: ``(T,)`` 0 at rest to 1 at full speed, smooth.
    """

    stances: tuple[list[Stance], list[Stance]]
    phase: np.ndarray
    amount: np.ndarray


def standing(ankles: np.ndarray, yaws: np.ndarray, frames: int) -> Steps:
    """Both feet stay: ankles ``(2, 2)``, yaws ``(2,)``."""
    stances = tuple([Stance(-FOREVER, FOREVER, ankles[i], float(yaws[i]))] for i in range(2))
    return Steps((stances[0], stances[1]), np.zeros(frames), np.zeros(frames))


def plan_steps(
    path: Path,
    gait: Gait,
    start: float | None,
    stop: float | None,
    phase: float = 0.0,
    first: int = 1,
) -> Steps:
    """Footfalls along a path.

    The ankle is placed beside the point of the path that the body passes in mid-stance, so that
    turning, side steps and changes of speed need no separate rules.

    Args:
        path: the body's path; at rest before ``start`` and after ``stop``.
        gait: the gait at full speed.
        start: when the first foot leaves the floor, or None: walking from the beginning.
        stop: when the path ends, or None: walking to the end.
        phase: initial phase of the stride, 0 to 1, for a clip that begins in mid-walk.
        first: the foot that takes the first step, 0 left, 1 right.
    """
    strides = _phase(path, gait, start) + (phase if start is None else 0.5 * (first - 1))
    left, right = (_foot_stances(path, gait, strides, foot, start, stop) for foot in range(2))
    return Steps((left, right), strides, path.amount())


def _phase(path: Path, gait: Gait, start: float | None) -> np.ndarray:
    """Strides since the left foot's touch-down; slower steps at lower speed (Grieve 1968)."""
    rate = np.maximum(path.amount(), 0.6) ** 0.58 / gait.stride_s
    phase = scipy.integrate.cumulative_trapezoid(rate, path.time, initial=0.0)
    if start is None:
        return phase - np.interp(0.0, path.time, phase)
    # At the start the right foot, which came down half a stride before zero, lifts.
    return phase - np.interp(start, path.time, phase) + gait.duty - 0.5


def _foot_stances(
    path: Path,
    gait: Gait,
    phase: np.ndarray,
    foot: int,
    start: float | None,
    stop: float | None,
) -> list[Stance]:
    swings = _swings(path, gait, phase, foot, start)
    if stop is not None:
        earlier = [-FOREVER] + [touch for _, touch in swings]
        still = [
            _arrived(path, touch, lift) for touch, (lift, _) in zip(earlier, swings, strict=False)
        ]
        swings = swings[: still.index(True)] if True in still else swings
    lifts = [lift for lift, _ in swings] + [FOREVER]
    touches = [-FOREVER] + [touch for _, touch in swings]
    if start is None:
        touches[0] = lifts[0] - gait.duty * gait.stride_s
    if stop is None:
        lifts[-1] = touches[-1] + gait.duty * gait.stride_s
    return [
        _place(path, gait, foot, touch, lift) for touch, lift in zip(touches, lifts, strict=True)
    ]


def _swings(
    path: Path, gait: Gait, phase: np.ndarray, foot: int, start: float | None
) -> list[tuple[float, float]]:
    """(toe-off, touch-down) times of every swing that lies within the path's times."""
    shift = 0.5 * foot
    swings = []
    for stride in range(int(np.floor(phase[0])) - 1, int(np.ceil(phase[-1])) + 1):
        lift, touch = stride + shift + gait.duty, stride + shift + 1.0
        if lift < phase[0] or touch > phase[-1]:
            continue
        lift_s, touch_s = np.interp([lift, touch], phase, path.time)
        if start is None or lift_s > start - 1e-6:
            swings.append((float(lift_s), float(touch_s)))
    return swings


def _arrived(path: Path, touch: float, lift: float) -> bool:
    """Whether a foot that stands from touch to lift is at the end of the path."""
    position, heading = path.at(max(0.5 * (touch + lift), path.time[0]))
    gap = np.linalg.norm(path.position[-1] - position)
    return bool(gap < LAST_STEP_M and abs(path.heading[-1] - heading) < LAST_TURN)


def _place(path: Path, gait: Gait, foot: int, touch: float, lift: float) -> Stance:
    middle = float(np.clip(0.5 * (touch + lift), path.time[0], path.time[-1]))
    position, heading = path.at(middle)
    side = 1.0 if foot == 0 else -1.0
    offset = np.array(
        [-_middle_pressure(touch, lift), side * _apart(path, gait, touch, lift) / 2.0]
    )
    cos, sin = np.cos(heading), np.sin(heading)
    ankle = position + np.array([[cos, -sin], [sin, cos]]) @ offset
    return Stance(
        touch=touch,
        lift=lift,
        ankle=ankle,
        yaw=heading + side * gait.toe_out,
        strike_pitch=gait.strike_pitch * _forward_share(path, touch),
        push_pitch=gait.push_pitch * (0.25 + 0.75 * _forward_share(path, lift)),
        flat_s=gait.flat_share * gait.stride_s,
        rise_s=gait.rise_share * gait.stride_s,
    )


def _apart(path: Path, gait: Gait, touch: float, lift: float) -> float:
    """Distance of the feet's paths in metres around a stance."""
    if np.isinf(lift - touch):
        return max(STANDING_WIDTH_M, gait.step_width_m)
    # Side steps need room for the trailing foot to close without crossing.
    aside = abs(np.interp(0.5 * (touch + lift), path.time, path.velocity[:, 1]))
    return gait.step_width_m + aside * gait.stride_s / 2.0


def _forward_share(path: Path, time: float) -> float:
    """Forward speed at a time over the clip's maximum; 0 if the clip only stands."""
    if np.isinf(time):
        return 0.0
    greatest = max(np.abs(path.velocity[:, 0]).max(), 0.3)
    return float(abs(np.interp(time, path.time, path.velocity[:, 0])) / greatest)


def smoothstep(x: np.ndarray | float) -> np.ndarray:
    """0 below zero, 1 above one, with two continuous derivatives between."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * x * (x * (6.0 * x - 15.0) + 10.0)


def loads(steps: Steps, gait: Gait, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Share of the weight on each foot ``(2, T)`` and the centre of pressure ``(T, 2)``.

    Weight passes from foot to foot over the double support, or within 0.5 s before a step from
    standing; the pressure rolls from heel to ball (Perry & Burnfield 2010). Shares are zero in
    flight.
    """
    shift = 0.5 if gait.duty <= 0.5 else (gait.duty - 0.5) * gait.stride_s
    weight = np.zeros((2, len(time)))
    place = np.zeros((2, len(time), 2))
    for foot in range(2):
        for s in steps.stances[foot]:
            on = (time >= s.touch) & (time <= s.lift)
            load = np.ones(len(time))
            if not gait.jog:
                slow = 0.5 if np.isinf(s.lift - s.touch) else shift
                load = smoothstep((time - s.touch) / shift) * smoothstep((s.lift - time) / slow)
            weight[foot] += np.where(on, load, 0.0)
            place[foot][on] = (
                s.ankle + pressure_ahead(s, gait, time)[:, None] * _direction(s.yaw)
            )[on]
    total = weight.sum(axis=0)
    share = weight / np.maximum(total, 1e-9)
    cop = np.einsum("ft,ftk->tk", share, place)
    missing = total < 1e-6
    if missing.any() and not missing.all():
        for k in range(2):
            cop[missing, k] = np.interp(time[missing], time[~missing], cop[~missing, k])
    return share, cop


def pressure_ahead(s: Stance, gait: Gait, time: np.ndarray) -> np.ndarray:
    """Centre of pressure ahead of the ankle in metres, along the foot."""
    half = 0.5 * gait.duty * gait.stride_s
    middle = _middle_pressure(s.touch, s.lift)
    early = 1.0 - smoothstep((time - s.touch) / half)
    late = 1.0 - smoothstep((s.lift - time) / half)
    return middle + (COP_HEEL_M - middle) * early + (COP_BALL_M - middle) * late


def _middle_pressure(touch: float, lift: float) -> float:
    return COP_STANDING_M if np.isinf(lift - touch) else COP_MID_M


def _direction(yaw: float) -> np.ndarray:
    return np.array([np.cos(yaw), np.sin(yaw)])
