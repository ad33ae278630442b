"""Actions in which the feet leave the floor: lunges, side steps, dances, kicks, jumps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy  # it imports its parts on first use

from questsim.motion.synthesis.actions import pulse
from questsim.motion.synthesis.feet import Feet
from questsim.motion.synthesis.footwork import (
    HIP_M,
    STRAIGHT_M,
    Action,
    Footfall,
    Jump,
    footfalls,
    jumping_feet,
    jumping_height,
    raise_heel,
    stand,
)
from questsim.motion.synthesis.gait_curves import gait_at
from questsim.motion.synthesis.gestures import DOWN_OUT, Gesture, reach
from questsim.motion.synthesis.plan import Path, Steps, plan_steps, smoothstep
from questsim.motion.synthesis.posture import REST_ABDUCTION, arm

_LEG_M = 0.86


def _rest(time: np.ndarray, crouch: np.ndarray | None = None) -> Gesture:
    none = np.zeros((len(time), 3))
    low = np.zeros(len(time)) if crouch is None else crouch
    return Gesture((None, None), np.zeros(len(time)), none, none.copy(), low)


def _places(start: Steps) -> list[np.ndarray]:
    return [start.stances[foot][0].ankle.copy() for foot in range(2)]


def _yaws(start: Steps) -> list[float]:
    return [start.stances[foot][0].yaw for foot in range(2)]


def _hands_ready(time: np.ndarray, rng: np.random.Generator, weight: np.ndarray) -> Gesture:
    """Hands held ready in front of the body."""
    gesture = _rest(time)
    height, ahead = rng.uniform(-0.7, 0.0), rng.uniform(0.4, 0.6)
    hand = np.tile([ahead, 0.0, height], (len(time), 1))
    gesture.arms = (reach(hand, 0, DOWN_OUT, 0.5), reach(hand, 1, DOWN_OUT, 0.5))
    gesture.weight = weight
    return gesture


def lunge(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Action:
    """Lunges forward or to a side: a long step, down, and back to the start."""
    start = stand(0.2, 0.0, len(time))
    places, yaws = _places(start), _yaws(start)
    falls, low = [], np.zeros(len(time))
    heel = [np.zeros(len(time)) for _ in range(2)]
    foot, deep = int(rng.random() < 0.5), rng.uniform(0.14, 0.30)
    aside = rng.random() < 0.3
    at = 0.6
    while at + 3.2 < seconds or not falls:
        out = 1.0 if foot == 0 else -1.0
        far = rng.uniform(0.32, 0.44) if aside else rng.uniform(0.5, 0.72)
        step = np.array([0.0, out * far]) if aside else np.array([far, 0.02 * out])
        hold = rng.uniform(0.4, 0.9)
        touch = at + 0.6
        leave = touch + 0.6 + hold + 0.5
        falls.append(Footfall(foot, at, touch, places[foot] + step, yaws[foot]))
        falls.append(Footfall(foot, leave, leave + 0.55, places[foot], yaws[foot]))
        sunk = pulse(time, touch - 0.15, leave - touch + 0.1, 0.65)
        low = np.maximum(low, sunk)
        if not aside:
            heel[1 - foot] = np.maximum(heel[1 - foot], sunk)
        at = leave + 1.25
        foot = 1 - foot if rng.random() < 0.7 else foot

    def change(feet: Feet) -> None:
        for side in range(2):
            raise_heel(feet, side, np.deg2rad(130.0) * deep * heel[side])

    gesture = _hands_ready(time, rng, 0.8 * low)
    gesture.crouch = (deep + 0.02) * low
    gesture.chest[:, 1] = np.deg2rad(rng.uniform(2.0, 22.0)) * low
    return Action(footfalls(start, falls, len(time)), gesture, shift_s=0.3, change=change)


def _sidewards(
    time: np.ndarray, seconds: float, rng: np.random.Generator, crossing: bool
) -> Action:
    start = stand(0.18, 0.0, len(time))
    places, yaws = _places(start), _yaws(start)
    falls, bumps = [], []
    way, left = (1.0 if rng.random() < 0.5 else -1.0), int(rng.integers(2, 4))
    beat = rng.uniform(0.42, 0.6) if not crossing else rng.uniform(0.55, 0.75)
    far = rng.uniform(0.22, 0.38) if not crossing else rng.uniform(0.2, 0.3)
    front = 1.0 if rng.random() < 0.5 else -1.0
    at = 0.7
    while at + 2.0 * beat < seconds - 0.8:
        leading = 0 if way > 0.0 else 1
        trailing = 1 - leading
        steps = [(leading, far), (trailing, far)]
        if crossing:
            # The trailing foot crosses over, then the other foot uncrosses.
            steps = [(trailing, 0.18 + far), (leading, 0.18 + far)]
        for foot, length in steps:
            places[foot] = places[foot] + np.array([0.0, way * length])
            place = places[foot].copy()
            crossed = crossing and foot == trailing
            if crossed:
                place[0] += front * 0.17
                bumps.append((foot, at, at + 0.72 * beat, 0.10 * front))
            elif crossing:
                bumps.append((foot, at, at + 0.72 * beat, -0.06 * front))
            falls.append(Footfall(foot, at, at + 0.72 * beat, place, yaws[foot]))
            at += beat
        if crossing:
            # Side by side again before the next crossing.
            places[trailing] = places[leading] - np.array([0.0, way * 0.18])
            falls.append(Footfall(trailing, at, at + 0.72 * beat, places[trailing], yaws[trailing]))
            bumps.append((trailing, at, at + 0.72 * beat, 0.08 * front))
            at += beat
        left -= 1
        if left == 0:
            way, left = -way, int(rng.integers(2, 4))
            at += rng.uniform(0.5, 1.0)

    def change(feet: Feet) -> None:
        for foot, lift, touch, size in bumps:
            share = np.clip((time - lift) / (touch - lift), 0.0, 1.0)
            feet.ankle[foot, :, 0] += size * (4.0 * share * (1.0 - share)) ** 2

    ready = smoothstep((time - 0.1) / 0.5) * smoothstep((seconds - 0.1 - time) / 0.5)
    gesture = _hands_ready(time, rng, rng.uniform(0.0, 1.0) * ready)
    gesture.crouch = 0.012 + rng.uniform(0.02, 0.1) * ready
    gesture.chest[:, 1] = np.deg2rad(rng.uniform(0.0, 16.0)) * ready
    return Action(footfalls(start, falls, len(time)), gesture, shift_s=0.16, change=change)


def shuffle(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Action:
    """Shuffles to one side and back, knees bent."""
    return _sidewards(time, seconds, rng, crossing=False)


def cross_step(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Action:
    """Side steps in which one foot crosses before or behind the other."""
    return _sidewards(time, seconds, rng, crossing=True)


def step_back(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Action:
    """A few steps back, a pause, and a few steps forward again."""
    start = stand(0.18, 0.0, len(time))
    places, yaws = _places(start), _yaws(start)
    falls, at, way = [], 0.7, -1.0
    moving = np.zeros(len(time))
    beat = rng.uniform(0.5, 0.75)
    while at + 2.0 * beat < seconds - 0.6:
        count, far = int(rng.integers(1, 4)), rng.uniform(0.2, 0.38)
        foot, begin = int(rng.random() < 0.5), at
        for number in range(count + 1):
            # The first and the last step are half as long: the feet end side by side.
            length = far if number in (0, count) else 2.0 * far
            if count == 1 and number == 1:
                length = far
            if at + beat > seconds - 0.5 and number == 0:
                break
            places[foot] = places[foot] + np.array([way * length, 0.0])
            falls.append(Footfall(foot, at, at + 0.7 * beat, places[foot].copy(), yaws[foot]))
            at += beat
            foot = 1 - foot
        moving = np.maximum(moving, pulse(time, begin - 0.2, at - begin + 0.2, 0.4))
        at += rng.uniform(0.5, 1.2)
        way = -way
    gesture = _hands_ready(time, rng, rng.uniform(0.0, 1.0) * moving)
    gesture.crouch = 0.012 + 0.02 * moving
    gesture.chest[:, 1] = np.deg2rad(rng.uniform(-3.0, 8.0)) * moving
    return Action(footfalls(start, falls, len(time)), gesture, shift_s=0.2)


def step_touch(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Action:
    """A dance: step to a side, the other foot touches beside, and back; the arms swing along."""
    start = stand(0.16, 0.0, len(time))
    places, yaws = _places(start), _yaws(start)
    beat, far = rng.uniform(0.5, 0.72), rng.uniform(0.2, 0.36)
    falls, at, way = [], 0.7, 1.0 if rng.random() < 0.5 else -1.0
    sides: list[tuple[float, float]] = []
    while at + 2.0 * beat < seconds - 0.5:
        leading = 0 if way > 0.0 else 1
        for foot in (leading, 1 - leading):
            places[foot] = places[foot] + np.array([0.0, way * far])
            falls.append(Footfall(foot, at, at + 0.68 * beat, places[foot].copy(), yaws[foot]))
            at += beat
        sides.append((at, way))
        way = -way
    dancing = smoothstep((time - 0.3) / 0.8) * smoothstep((seconds - 0.1 - time) / 0.6)
    swing = np.zeros(len(time))
    for when, side in sides:
        swing = swing + side * np.exp(-(((time - when + 0.6 * beat) / (0.8 * beat)) ** 2))
    bounce = 0.5 - 0.5 * np.cos(2.0 * np.pi * (time - 0.7) / beat)
    gesture = _rest(time, 0.012 + (0.02 + rng.uniform(0.01, 0.035) * bounce) * dancing)
    high = rng.uniform(-0.6, 0.1)
    arms = []
    for side in range(2):
        out = swing if side == 0 else -swing
        hand = np.column_stack(
            [0.5 + 0.0 * swing, 0.1 + 0.4 * out, high + 0.12 * bounce + 0.1 * np.abs(swing)]
        )
        arms.append(reach(hand, side, DOWN_OUT, 0.4))
    gesture.arms, gesture.weight = (arms[0], arms[1]), dancing * rng.uniform(0.6, 1.0)
    gesture.chest[:, 0] = np.deg2rad(rng.uniform(4.0, 14.0)) * swing * dancing
    gesture.chest[:, 2] = -np.deg2rad(rng.uniform(0.0, 6.0)) * swing * dancing
    return Action(footfalls(start, falls, len(time)), gesture, shift_s=0.2)


def kick(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Action:
    """Slow kicks forward, sideways or back, on one leg; the arms keep the balance."""
    start = stand(0.16, 0.0, len(time))
    places, yaws = _places(start), _yaws(start)
    falls, kicks = [], []
    foot, at = int(rng.random() < 0.5), 0.9
    while at + 2.4 < seconds - 0.4 or not falls:
        lasts = rng.uniform(1.6, 2.4)
        kind = rng.choice(3)
        high = np.deg2rad(rng.uniform(35.0, 75.0) if kind == 0 else rng.uniform(25.0, 45.0))
        falls.append(Footfall(foot, at, at + lasts, places[foot], yaws[foot]))
        kicks.append((foot, at, lasts, int(kind), float(high)))
        at += lasts + rng.uniform(1.1, 1.6)
        foot = 1 - foot if rng.random() < 0.6 else foot

    lifted, lean = np.zeros(len(time)), np.zeros((len(time), 3))
    for own, begin, lasts, kind, high in kicks:
        share = pulse(time, begin, lasts, 0.45 * lasts)
        lifted = np.maximum(lifted, share)
        out = 1.0 if own == 0 else -1.0
        lean[:, 1] += share * high * ((-0.2, 0.0, 0.7)[kind])
        lean[:, 2] += share * high * ((0.0, 0.35, 0.0)[kind]) * out

    def change(feet: Feet) -> None:
        for own, begin, lasts, kind, high in kicks:
            share = pulse(time, begin, lasts, 0.45 * lasts)
            angle = high * share
            out = 1.0 if own == 0 else -1.0
            along = ((1.0, 0.0), (0.25, out), (-1.0, 0.0))[kind]
            leg = _LEG_M * (1.0 - 0.06 * 4.0 * share * (1.0 - share) - 0.03 * share)
            off = leg * np.sin(angle)
            feet.ankle[own, :, 0] += off * along[0]
            feet.ankle[own, :, 1] += off * along[1]
            feet.ankle[own, :, 2] += _LEG_M - leg * np.cos(angle)
            feet.pitch[own] += share * (
                -0.8 * high if kind == 0 else 0.5 * high if kind == 2 else 0.0
            )
            if kind != 1:
                # A foot aligned with the leg would flip where the leg is horizontal.
                feet.hanging[own] *= 1.0 - smoothstep(share / 0.3)

    gesture = _rest(time, 0.02 + 0.0 * lifted)
    hand = np.tile([0.3, 0.62, -0.25], (len(time), 1))
    gesture.arms = (reach(hand, 0, DOWN_OUT), reach(hand, 1, DOWN_OUT))
    gesture.weight = rng.uniform(0.4, 1.0) * lifted
    gesture.chest = lean
    gesture.head[:, 1] = 0.4 * lean[:, 1]
    # In a long swing even a small push would carry the foot's pitch far.
    steps = footfalls(start, falls, len(time), push_pitch=0.0)
    return Action(steps, gesture, shift_s=0.35, change=change)


def jump(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Action:
    """Jumps on the spot with both feet: a few small hops or single high ones."""
    small = rng.random() < 0.5
    flight, depth = (
        (rng.uniform(0.20, 0.28), rng.uniform(0.08, 0.13))
        if small
        else (rng.uniform(0.28, 0.42), rng.uniform(0.16, 0.28))
    )
    jumps, at = [], 1.2
    while True:
        one = Jump(at, flight * rng.uniform(0.95, 1.05), depth)
        if jumps and one.end > seconds - 0.1:
            break
        jumps.append(one)
        pause = rng.uniform(0.0, 0.3) if small else rng.uniform(0.2, 0.8)
        at = one.end + pause + Jump.PUSH_S + Jump.SINK_S
    rise = jumping_height(jumps, time)
    steps = stand(rng.uniform(0.16, 0.28), rng.normal(0.0, 0.03), len(time))
    sunk = np.maximum(-rise, 0.0) / depth
    gesture = _rest(time)
    gesture.chest[:, 1] = np.deg2rad(rng.uniform(16.0, 30.0)) * sunk * min(depth / 0.2, 1.2)
    # Arms go back with the crouch and forward and up with the push.
    lead = np.interp(time + 0.12, time, rise)
    up = np.clip(scipy.ndimage.gaussian_filter1d(lead, 3.0) / 0.12, -1.2, 1.0)
    flexion = np.deg2rad(rng.uniform(20.0, 60.0)) * up
    even = np.ones(len(time))
    arms = [
        arm(flexion, REST_ABDUCTION * even * 1.5, 0.2 * even, 0.4 * even + 0.3 * np.abs(up), side)
        for side in range(2)
    ]
    gesture.arms = (arms[0], arms[1])
    gesture.weight = smoothstep((time - 0.1) / 0.4) * smoothstep((seconds - 0.1 - time) / 0.4)
    # The pressure goes to the balls of the feet before a take-off and after a landing.
    ahead = np.zeros(len(time))
    for one in jumps:
        ahead = np.maximum(ahead, pulse(time, one.takeoff - 0.3, one.flight + 0.6, 0.28))
    pressure = np.column_stack([0.07 * ahead, 0.0 * ahead])
    return Action(
        steps,
        gesture,
        pressure=pressure,
        change=lambda feet: jumping_feet(feet, jumps, rise, time),
        height=STRAIGHT_M + rise,
        flies=True,
        on_balls=True,
    )


def crouch_walk(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Action:
    """Walking with bent knees and a bowed trunk, straight or in a curve."""
    speed, deep = rng.uniform(0.4, 0.9), rng.uniform(0.09, 0.22)
    turn = rng.normal(0.0, 0.2)
    begin, end = rng.uniform(0.9, 1.2), seconds - rng.uniform(1.1, 1.4)
    share = smoothstep((time - begin) / 1.2) * smoothstep((end - time) / 1.2)
    path = Path(time, share[:, None] * np.array([speed, 0.0]), share * turn)
    gait = replace(
        gait_at(speed, HIP_M, False), step_width_m=0.15, strike_pitch=np.deg2rad(-4.0),
        push_pitch=np.deg2rad(26.0), lift=0.5,
    )  # fmt: skip
    steps = plan_steps(path, gait, begin, end, 0.0, int(rng.random() < 0.5))
    low = smoothstep((time - 0.1) / 1.0) * smoothstep((seconds - 0.1 - time) / 1.0)
    gesture = _hands_ready(time, rng, rng.uniform(0.2, 1.0) * low)
    gesture.crouch = deep * low + 0.008
    gesture.chest[:, 1] = np.deg2rad(rng.uniform(12.0, 38.0)) * low
    gesture.head[:, 1] = 0.25 * gesture.chest[:, 1]
    shift = (gait.duty - 0.5) * gait.stride_s
    return Action(steps, gesture, shift_s=shift, heading=path.heading, gait=gait)
