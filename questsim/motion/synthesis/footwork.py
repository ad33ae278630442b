"""Feet and root height in actions that are neither walking nor standing.

An action defines when each foot steps where (``footfalls``). Rolling, swinging and balance are
computed as for gaits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from questsim.motion.synthesis.balance import lowering, settle
from questsim.motion.synthesis.feet import Feet, feet_paths, quintic, roll
from questsim.motion.synthesis.gait_curves import GRAVITY, Gait, gait_at
from questsim.motion.synthesis.gestures import Gesture
from questsim.motion.synthesis.plan import (
    COP_STANDING_M,
    FOREVER,
    Stance,
    Steps,
    loads,
    pressure_ahead,
    smoothstep,
    standing,
)
from questsim.motion.synthesis.pose import dof
from questsim.motion.synthesis.posture import add_gesture, idle

HIP_M = 0.9275
"""Height of the default body's root standing straight."""
STRAIGHT_M = HIP_M - 0.006
_MOST_DORSIFLEXION = np.deg2rad(34.5)
"""Ankles bend up to 35 degrees; in deeper crouches the heels leave the floor."""
_MOST_POINTED = np.deg2rad(56.0)
_HEEL_ROUNDS = 6
_BALL_M = 0.125
"""Centre of pressure with raised heels, ahead of the flat foot's ankle."""
_ANKLES = [7 + dof("left_ankle_y"), 7 + dof("right_ankle_y")]


@dataclass(frozen=True)
class Footfall:
    """One step of an action: foot 0 (left) or 1, in the air from ``lift`` to ``touch`` (s).

    It comes down at ``place`` ``(2,)`` metres, turned by ``yaw`` radians.
    """

    foot: int
    lift: float
    touch: float
    place: np.ndarray
    yaw: float = 0.0


@dataclass
class Action:
    """An action of the default body over time.

    Attributes:
        steps: of the feet.
        gesture: of the upper body, and how far the pelvis sinks.
        shift_s: seconds in which the weight passes from foot to foot.
        heading: ``(T,)`` radians, or None: forward.
        pressure: ``(T, 2)`` offset of the centre of pressure in metres.
        change: changes the feet's paths in place.
        height: ``(T,)`` of the root; None: standing height minus the gesture's crouch.
        flies: whether the height has flights.
        on_balls: whether the pressure moves to the balls of the feet automatically.
        gait: parameters of the swing.
    """

    steps: Steps
    gesture: Gesture
    shift_s: float = 0.2
    heading: np.ndarray | None = None
    pressure: np.ndarray | None = None
    change: Callable[[Feet], None] | None = None
    height: np.ndarray | None = None
    flies: bool = False
    on_balls: bool = False
    gait: Gait = field(default_factory=lambda: gait_at(0.5, HIP_M, False))


def perform(action: Action, time: np.ndarray, rng: np.random.Generator, shown: slice) -> np.ndarray:
    """Poses ``(T, 40)`` of an action, balanced over its feet."""
    gait = replace(action.gait, stride_s=1.0, duty=0.5 + action.shift_s)
    feet = feet_paths(action.steps, gait, time)
    if action.change is not None:
        action.change(feet)
    load, pressure = loads(action.steps, gait, time)
    if action.pressure is not None:
        pressure = pressure + action.pressure
    posture = idle(time, rng, looking=False)
    if action.heading is not None:
        posture = replace(posture, heading=action.heading)
    posture = add_gesture(posture, action.gesture)
    height = action.height
    if height is None:
        height = STRAIGHT_M - action.gesture.crouch
    qpos = np.empty(0)
    lifted = np.zeros((2, len(time)))
    for _ in range(_HEEL_ROUNDS):
        ahead = _over_the_balls(action, gait, feet, lifted, load, time)
        qpos = settle(
            posture, feet, height, pressure + ahead, time, action.flies, shown, moments=True
        )
        short = _ankles_short(qpos, time)
        if np.abs(short[:, shown]).max() < np.deg2rad(0.5):
            break
        lifted += short
        for foot in range(2):
            add_pitch(feet, foot, short[foot])
    return qpos


def _ankles_short(qpos: np.ndarray, time: np.ndarray) -> np.ndarray:
    """``(2, T)`` radians, smooth, by which heels must rise (or sink) for ankles within range."""
    bent = np.maximum(-_MOST_DORSIFLEXION - qpos[:, _ANKLES], 0.0)
    pointed = np.maximum(qpos[:, _ANKLES] - _MOST_POINTED, 0.0)
    return np.stack(
        [1.1 * (lowering(bent[:, f], time) - lowering(pointed[:, f], time)) for f in range(2)]
    )


def _over_the_balls(
    action: Action, gait: Gait, feet: Feet, lifted: np.ndarray, load: np.ndarray, time: np.ndarray
) -> np.ndarray:
    """``(T, 2)`` forward shift of the pressure in metres while heels are off the floor."""
    out = np.zeros((len(time), 2))
    if action.on_balls or not lifted.any():
        return out
    for foot in range(2):
        up = load[foot] * smoothstep(np.maximum(lifted[foot], 0.0) / np.deg2rad(8.0))
        for s in action.steps.stances[foot]:
            on = (time >= s.touch) & (time <= s.lift)
            ahead = np.maximum(_BALL_M - pressure_ahead(s, gait, time), 0.0)
            way = np.array([np.cos(s.yaw), np.sin(s.yaw)])
            out += np.where(on, up * ahead, 0.0)[:, None] * way
    return out


def add_pitch(feet: Feet, foot: int, more: np.ndarray) -> None:
    """Raise a heel by another ``(T,)`` radians, rolling the foot over its ball; in place."""
    before, after = roll(feet.pitch[foot]), roll(feet.pitch[foot] + more)
    way = np.stack([np.cos(feet.yaw[foot]), np.sin(feet.yaw[foot])], axis=-1)
    feet.ankle[foot, :, :2] += (after[0] - before[0])[:, None] * way
    feet.ankle[foot, :, 2] += after[1] - before[1]
    feet.pitch[foot] += more


def stand(width: float, stagger: float, frames: int, toe_out: float = 0.12) -> Steps:
    """Feet that stay ``width`` apart, the left one ``stagger`` metres ahead."""
    half = np.array([0.5 * stagger, 0.5 * width])
    ankles = np.array([half, -half]) - [COP_STANDING_M, 0.0]
    return standing(ankles, np.array([toe_out, -toe_out]), frames)


def footfalls(
    start: Steps, falls: list[Footfall], frames: int, push_pitch: float = np.deg2rad(18.0)
) -> Steps:
    """The steps of a person who stands as in ``start`` and then steps.

    Heels rise by ``push_pitch`` radians before a foot leaves.
    """
    feet: list[list[Stance]] = [[], []]
    for foot in range(2):
        current = start.stances[foot][0]
        for fall in sorted((f for f in falls if f.foot == foot), key=lambda f: f.lift):
            feet[foot].append(replace(current, lift=fall.lift))
            current = Stance(
                fall.touch, FOREVER, fall.place, fall.yaw,
                strike_pitch=0.0, push_pitch=push_pitch, flat_s=0.1, rise_s=0.15,
            )  # fmt: skip
        feet[foot].append(current)
    zero = np.zeros(frames)
    return Steps((feet[0], feet[1]), zero, zero)


def raise_heel(feet: Feet, foot: int, pitch: np.ndarray) -> None:
    """Roll a foot on the floor over its ball by ``(T,)`` radians, in place."""
    on = pitch > 1e-6
    ahead, up = roll(pitch)
    yaw = feet.yaw[foot]
    way = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    flat = feet.ankle[foot, :, :2]
    feet.ankle[foot, :, :2] = np.where(on[:, None], flat + ahead[:, None] * way, flat)
    feet.ankle[foot, :, 2] = np.where(on, up, feet.ankle[foot, :, 2])
    feet.pitch[foot] = np.where(on, pitch, feet.pitch[foot])


@dataclass(frozen=True)
class Jump:
    """One jump.

    Attributes:
        takeoff: seconds.
        flight: seconds in the air; the root rises by ``g flight^2 / 8``.
        depth: metres by which the pelvis sinks before and after.
    """

    takeoff: float
    flight: float
    depth: float

    SINK_S = 0.45
    PUSH_S = 0.30
    LAND_S = 0.24
    RISE_S = 0.55
    EXTENSION_M = 0.045
    """Rise of the root above standing height when the balls of the feet leave the floor."""

    @property
    def begin(self) -> float:
        """When the pelvis begins to sink."""
        return self.takeoff - self.PUSH_S - self.SINK_S

    @property
    def landing(self) -> float:
        """When the feet touch the floor again."""
        return self.takeoff + self.flight

    @property
    def end(self) -> float:
        """When the body stands again."""
        return self.landing + self.LAND_S + self.RISE_S


def jumping_height(jumps: list[Jump], time: np.ndarray) -> np.ndarray:
    """``(T,)`` metres of the root above its place in standing; -g in flight."""
    out = np.zeros(len(time))
    for jump in jumps:
        speed = 0.5 * GRAVITY * jump.flight
        low, high = -jump.depth, jump.EXTENSION_M
        knots = [
            (jump.begin, (0.0, 0.0, 0.0)),
            (jump.takeoff - jump.PUSH_S, (low, 0.0, 0.0)),
            (jump.takeoff, (high, speed, -GRAVITY)),
            (jump.landing, (high, -speed, -GRAVITY)),
            (jump.landing + jump.LAND_S, (low, 0.0, 0.0)),
            (jump.end, (0.0, 0.0, 0.0)),
        ]
        for (a, start), (b, end) in pairwise(knots):
            on = (time >= a) & (time <= b)
            share = (time[on] - a) / (b - a)
            out[on] = quintic(np.array(start), np.array(end), b - a, share)
    return out


def jumping_feet(feet: Feet, jumps: list[Jump], rise: np.ndarray, time: np.ndarray) -> None:
    """Heels up before a take-off, feet off the floor in flight, balls first on landing."""
    pitch, off = np.zeros(len(time)), np.zeros(len(time))
    for jump in jumps:
        up = smoothstep((time - jump.takeoff + 0.16) / 0.16)
        down = smoothstep((jump.landing + 0.14 - time) / 0.14)
        pitch = np.maximum(pitch, np.deg2rad(38.0) * up * down)
        flies = (time > jump.takeoff) & (time < jump.landing)
        off[flies] = 1.1 * np.maximum(rise[flies] - jump.EXTENSION_M, 0.0)
    for foot in range(2):
        grounded = feet.ankle[foot, :, 2] < 0.2
        rolled = np.where(grounded, pitch, 0.0)
        raise_heel(feet, foot, rolled)
        feet.ankle[foot, :, 2] += off
