"""Actions with both feet on the floor: bows, picking up, pointing, dodging, punches, throws.

Each draws its own parameters: depth, distance, repetitions, hand. Durations are those of
unhurried movement; punches and throws take about 0.3 s (see ``gestures``).
"""

from __future__ import annotations

import numpy as np

from questsim.motion.synthesis.footwork import Action, stand
from questsim.motion.synthesis.gestures import DOWN_OUT, Gesture, reach
from questsim.motion.synthesis.plan import smoothstep
from questsim.motion.synthesis.pose import Arm
from questsim.motion.synthesis.posture import REST_ABDUCTION, arm

_LEAD_S = 0.4
"""Seconds between the start of the clip and the action, and between its end and the clip's."""


def events(
    seconds: float, rng: np.random.Generator, takes: tuple[float, float], gap: tuple[float, float]
) -> list[tuple[float, float]]:
    """(begin, duration) of as many events as fit into a clip, at least one."""
    found, at = [], _LEAD_S + rng.uniform(0.0, 0.4)
    while True:
        lasts = rng.uniform(*takes)
        if found and at + lasts > seconds - _LEAD_S:
            return found
        found.append((at, min(lasts, seconds - _LEAD_S - at)))
        at += lasts + rng.uniform(*gap)


def pulse(time: np.ndarray, begin: float, lasts: float, ease: float) -> np.ndarray:
    """``(T,)`` pulse: rises from 0 to 1 in ``ease`` seconds, holds, is 0 at ``begin + lasts``."""
    return smoothstep((time - begin) / ease) * smoothstep((begin + lasts - time) / ease)


def _empty(time: np.ndarray) -> np.ndarray:
    return np.zeros((len(time), 3))


def _hanging(flexion: np.ndarray, side: int, elbow: float = 0.25, abduct: float = 0.0) -> Arm:
    """A hanging arm, flexed ``(T,)`` radians forward from the chest's axis."""
    even = np.ones(len(flexion))
    return arm(flexion, (REST_ABDUCTION + abduct) * even, 0.2 * even, elbow * even, side)


def _target(time: np.ndarray, azimuth: float, elevation: float, distance: float) -> np.ndarray:
    """``(T, 3)`` forward, outward and up from the shoulder, in arm's lengths."""
    level = np.cos(elevation)
    place = [level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)]
    return np.tile(distance * np.array(place), (len(time), 1))


def bow(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Action:
    """Bows of 20 to 85 degrees, the arms at the sides, hanging, or on the thighs."""
    pitch, deepest = np.zeros(len(time)), np.deg2rad(rng.uniform(20.0, 85.0))
    for begin, lasts in events(seconds, rng, (2.4, 4.0), (0.3, 1.2)):
        ease = min(rng.uniform(0.9, 1.4) * (0.6 + 0.4 * deepest), 0.45 * lasts)
        pitch = np.maximum(pitch, pulse(time, begin, lasts, ease) * deepest)
    chest, head = _empty(time), _empty(time)
    chest[:, 1] = pitch
    head[:, 1] = rng.uniform(0.6, 0.95) * pitch
    hang = rng.choice([0.0, 0.35, 1.0])
    arms = tuple(_hanging(0.05 + hang * pitch, side, rng.uniform(0.1, 0.4)) for side in range(2))
    gesture = Gesture((arms[0], arms[1]), np.ones(len(time)), chest, head, 0.03 * pitch)
    return Action(stand(rng.uniform(0.1, 0.24), rng.normal(0.0, 0.03), len(time)), gesture)


def pick_up(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Action:
    """Picks something up from the floor with one or both hands, holds it and puts it down."""
    deep = rng.uniform(0.26, 0.40)
    # With less bend in the knees the trunk bows more.
    pitch = np.deg2rad(rng.uniform(58.0, 66.0)) + 1.6 * (0.40 - deep)
    low, held = np.zeros(len(time)), np.zeros(len(time))
    for number, (begin, lasts) in enumerate(events(seconds, rng, (2.2, 3.0), (0.6, 1.2))):
        low = np.maximum(low, pulse(time, begin, lasts, min(rng.uniform(0.8, 1.1), 0.45 * lasts)))
        step = smoothstep((time - begin - 0.5 * lasts) / (0.5 * lasts))
        held = held + (step if number % 2 == 0 else -step)
    chest, head = _empty(time), _empty(time)
    way = rng.normal(0.0, np.deg2rad(10.0))
    chest[:, 0], chest[:, 1], head[:, 1] = way * low, pitch * low, 0.9 * pitch * low
    both, hand = rng.random() < 0.5, int(rng.random() < 0.7)
    arms: list[Arm | None] = [None, None]
    for side in range(2):
        if both or side == hand:
            flexion = 0.1 + (pitch + 0.05) * low + 0.35 * held * (1.0 - low)
            even = np.ones(len(time))
            elbow = 0.25 - 0.1 * low + 1.2 * held * (1.0 - low)
            inward = 0.2 + 0.25 * held * (1.0 - low)
            arms[side] = arm(flexion, REST_ABDUCTION * even, inward, elbow, side)
        else:
            arms[side] = _hanging(0.3 * pitch * low, side)
    gesture = Gesture((arms[0], arms[1]), np.ones(len(time)), chest, head, deep * low)
    steps = stand(rng.uniform(0.2, 0.34), rng.uniform(-0.12, 0.12), len(time))
    # The weight moves to the heels while the trunk is low, since ankle flexion is limited.
    return Action(steps, gesture, pressure=np.column_stack([-0.04 * low, 0.0 * low]))


def guide(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Action:
    """A hand points or gestures in a direction; trunk and head turn towards it."""
    side = int(rng.random() < 0.5)
    out = 1.0 if side == 0 else -1.0
    azimuth, point = np.deg2rad(rng.uniform(-10.0, 85.0)), rng.random() < 0.5
    elevation = np.deg2rad(rng.uniform(-10.0, 45.0) if point else rng.uniform(-35.0, -5.0))
    share = np.zeros(len(time))
    for begin, lasts in events(seconds, rng, (1.8, 3.6), (0.3, 1.0)):
        share = np.maximum(share, pulse(time, begin, lasts, min(0.8, 0.4 * lasts)))
    beat = 0.04 * np.sin(2.0 * np.pi * rng.uniform(0.5, 1.0) * time)
    target = _target(time, azimuth, elevation, 0.97 if point else rng.uniform(0.7, 0.9))
    target[:, 2] += beat
    hand = reach(target, side, DOWN_OUT, rng.uniform(-0.8, 0.4))
    arms: list[Arm | None] = [None, None]
    arms[side] = hand
    chest, head = _empty(time), _empty(time)
    chest[:, 0] = out * (azimuth * rng.uniform(0.1, 0.35)) * share
    chest[:, 1] = np.deg2rad(rng.uniform(0.0, 14.0)) * share
    head[:, 0] = out * azimuth * rng.uniform(0.3, 0.7) * share
    gesture = Gesture((arms[0], arms[1]), share, chest, head, 0.0 * share)
    return Action(stand(rng.uniform(0.12, 0.26), rng.normal(0.0, 0.04), len(time)), gesture)


def duck(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Action:
    """Quickly ducks below something or dodges to a side."""
    low, aside = np.zeros(len(time)), np.zeros(len(time))
    for begin, lasts in events(seconds, rng, (0.9, 1.5), (0.2, 0.9)):
        share = pulse(time, begin, lasts, rng.uniform(0.38, 0.5))
        low = low + rng.uniform(0.3, 1.0) * share
        aside = aside + rng.choice([-1.0, 0.0, 1.0]) * share
    deep, bent = rng.uniform(0.18, 0.34), np.deg2rad(rng.uniform(15.0, 40.0))
    chest, head = _empty(time), _empty(time)
    chest[:, 1], head[:, 1] = bent * low, 0.5 * bent * low
    chest[:, 2] = np.deg2rad(14.0) * aside
    arms = []
    for side in range(2):
        guard = np.array([0.42, -0.08, rng.uniform(-0.25, 0.1)])
        hand = guard + 0.05 * low[:, None] * np.array([0.0, 0.0, 1.0])
        arms.append(reach(hand, side, np.array([-0.2, 0.5, -1.0]), 0.6))
    ready = smoothstep((time - 0.1) / 0.5) * smoothstep((seconds - 0.1 - time) / 0.5)
    gesture = Gesture(
        (arms[0], arms[1]), rng.uniform(0.5, 1.0) * ready, chest, head, deep * low + 0.03 * ready
    )
    width = rng.uniform(0.28, 0.42)
    # When leaning to the right, the weight also moves to the right foot.
    pressure = np.column_stack([0.0 * aside, -0.28 * width * aside])
    return Action(stand(width, rng.uniform(-0.1, 0.1), len(time)), gesture, pressure=pressure)


def punches(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Action:
    """Straight punches, hooks and uppercuts from a guard, either foot ahead."""
    lead = 1.0 if rng.random() < 0.6 else -1.0
    ready = smoothstep((time - 0.2) / 0.7) * smoothstep((seconds - 0.2 - time) / 0.7)
    guard = np.array([0.44, -0.12, -0.02])
    ends = {
        "straight": np.array([0.95, -0.2, 0.05]),
        "hook": np.array([0.62, 0.25, 0.05]),
        "uppercut": np.array([0.62, -0.15, 0.32]),
    }
    hands = [np.tile(guard, (len(time), 1)) for _ in range(2)]
    twist = np.zeros(len(time))
    at = 1.0
    while at < seconds - 1.4:
        side, kind = int(rng.random() < 0.5), str(rng.choice(list(ends)))
        out = smoothstep((time - at) / 0.30) * smoothstep((at + 0.75 - time) / 0.40)
        hands[side] = hands[side] + out[:, None] * (ends[kind] - guard)
        if kind == "hook":
            round_ = smoothstep((time - at - 0.16) / 0.26) * smoothstep((at + 0.85 - time) / 0.40)
            hands[side] = hands[side] + round_[:, None] * np.array([0.15, -0.55, 0.0])
        twist = twist + np.deg2rad(24.0) * out * (1.0 if side else -1.0)
        at += rng.uniform(0.55, 1.2)
    arms = [reach(hands[s], s, np.array([-0.2, 0.45, -1.0]), 0.9) for s in range(2)]
    chest, head = _empty(time), _empty(time)
    chest[:, 0] = twist - lead * np.deg2rad(10.0) * ready
    chest[:, 1] = np.deg2rad(6.0) * ready
    gesture = Gesture((arms[0], arms[1]), ready, chest, head, rng.uniform(0.03, 0.1) * ready)
    steps = stand(rng.uniform(0.22, 0.32), lead * rng.uniform(0.22, 0.36), len(time))
    return Action(steps, gesture)


def swing(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Action:
    """Swings of a racket, a bat or a sword: the trunk turns, the hand follows."""
    side, both = int(rng.random() < 0.75), rng.random() < 0.4
    back, through = _swung(time, seconds, rng, rng.uniform(0.3, 0.42))
    high = rng.uniform(-0.4, 0.5)
    arms: list[Arm | None] = [None, None]
    for own in range(2):
        if both or own == side:
            # Both hands hold the same thing: the other one reaches across.
            turn = 1.0 if own == side else -1.0
            rest = np.array([0.5, 0.05 * turn, -0.35])
            wound = np.array([0.05, 0.75, 0.3 + high])
            ended = np.array([0.55, -0.45, 0.05 - 0.6 * high])
            if own != side:
                wound, ended = np.array([0.5, -0.4, 0.1 + 0.4 * high]), np.array([0.45, 0.5, -0.1])
            met = np.array([0.85, 0.1 * turn, -0.15])
            bell = 4.0 * through * (1.0 - through)
            path = rest + back[:, None] * (1.0 - through[:, None]) * (wound - rest)
            path = path + (back * through)[:, None] * (ended - rest)
            path = path + 0.7 * (back * bell)[:, None] * (met - 0.5 * (wound + ended))
            arms[own] = reach(path, own, DOWN_OUT, rng.uniform(0.2, 0.8))
    out = 1.0 if side == 0 else -1.0
    chest, head = _empty(time), _empty(time)
    turn = back * (1.0 - 2.0 * through)
    chest[:, 0] = out * np.deg2rad(rng.uniform(24.0, 40.0)) * turn
    head[:, 0] = 0.1 * chest[:, 0]
    chest[:, 1] = np.deg2rad(rng.uniform(4.0, 14.0)) * back
    gesture = Gesture((arms[0], arms[1]), back, chest, head, rng.uniform(0.02, 0.1) * back)
    width = rng.uniform(0.28, 0.42)
    pressure = np.column_stack([0.0 * turn, 0.22 * width * out * turn])
    return Action(stand(width, rng.uniform(-0.12, 0.12), len(time)), gesture, pressure=pressure)


def throw(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Action:
    """Overarm throws; the weight goes from the back foot to the front one."""
    side = int(rng.random() < 0.75)
    back, through = _swung(time, seconds, rng, rng.uniform(0.36, 0.46))
    rest, wound = np.array([0.4, 0.1, -0.5]), np.array([-0.1, 0.5, 0.5])
    over, ended = np.array([0.5, 0.15, 0.75]), np.array([0.75, -0.35, -0.35])
    first, second = np.clip(2.0 * through, 0.0, 1.0), np.clip(2.0 * through - 1.0, 0.0, 1.0)
    path = wound + smoothstep(first)[:, None] * (over - wound)
    path = path + smoothstep(second)[:, None] * (ended - over)
    path = rest + back[:, None] * (path - rest)
    arms: list[Arm | None] = [None, None]
    arms[side] = reach(path, side, np.array([0.0, 1.0, -0.5]), 0.3)
    aim = np.array([0.75, 0.1, 0.1]) - 0.5 * through[:, None] * np.array([0.7, 0.0, 0.6])
    arms[1 - side] = reach(aim, 1 - side, DOWN_OUT, 0.3)
    out = 1.0 if side == 0 else -1.0
    turn = back * (1.0 - 2.0 * through)
    chest, head = _empty(time), _empty(time)
    chest[:, 0] = out * np.deg2rad(rng.uniform(24.0, 36.0)) * turn
    chest[:, 1] = np.deg2rad(22.0) * back * through - np.deg2rad(6.0) * back * (1.0 - through)
    head[:, 0] = 0.1 * chest[:, 0]
    stagger = -out * rng.uniform(0.24, 0.36)
    gesture = Gesture((arms[0], arms[1]), back, chest, head, 0.05 * back)
    pressure = np.column_stack([-0.25 * abs(stagger) * turn, 0.0 * turn])
    return Action(stand(rng.uniform(0.2, 0.3), stagger, len(time)), gesture, pressure=pressure)


def _swung(
    time: np.ndarray, seconds: float, rng: np.random.Generator, takes: float
) -> tuple[np.ndarray, np.ndarray]:
    """Progress of the wind-up and of the swing, ``(T,)`` each, 0 to 1."""
    back, through = np.zeros(len(time)), np.zeros(len(time))
    for begin, lasts in events(seconds, rng, (2.2, 2.8), (0.2, 0.8)):
        own = pulse(time, begin, lasts, min(0.7, 0.35 * lasts))
        back = np.maximum(back, own)
        struck = begin + 0.45 * lasts
        inside = (time >= begin) & (time <= begin + lasts)
        through = np.where(inside, smoothstep((time - struck) / takes), through)
    return back, through
