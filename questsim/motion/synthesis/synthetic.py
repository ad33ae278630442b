"""Synthetic motion: clips of the avatar that need no download, made from published gait data.

``synthesise`` makes one clip of any kind, speed and height. ``synthetic_clips`` makes the library
of the motion argument ``synthetic``. docs/synthetic.md describes the method.

A body of another height moves as the default body does in slower or faster time: all lengths
scale with the height, all times with its square root (equal Froude number; Alexander 1989), so
that free fall stays free fall.
"""

from __future__ import annotations

import zlib
from collections.abc import Container
from dataclasses import replace
from functools import lru_cache

import numpy as np

from questsim.body import DEFAULT_HEIGHT_M, build_body
from questsim.motion.clip import Clip
from questsim.motion.kinematics import clips_from_qpos
from questsim.motion.synthesis.action_kinds import ACTIONS
from questsim.motion.synthesis.balance import jogging_height, settle, walking_height
from questsim.motion.synthesis.feet import feet_paths
from questsim.motion.synthesis.footwork import perform
from questsim.motion.synthesis.gait_curves import Gait, gait_at
from questsim.motion.synthesis.gestures import GESTURES, WALKABLE, Gesture
from questsim.motion.synthesis.kept import kept_clip
from questsim.motion.synthesis.plan import Path, loads, plan_steps, smoothstep, standing
from questsim.motion.synthesis.posture import add_gesture, idle, locomotion, sway
from questsim.motion.synthesis.seat import seated_poses
from questsim.motion.synthesis.wish import (
    KINDS,
    MAX_SPEED,
    MAX_WALK,
    MIN_SPEED,
    SEATED,
    Wish,
    check_seed,
    checked,
)

MARGIN_S = 2.5
"""A clip that begins or ends in mid-walk is generated this many seconds longer and cropped."""
SHUFFLE_STRIDE_S, SHUFFLE_WIDTH_M = 1.1, 0.16
"""Side steps and turns on the spot: duration of a stride, and minimum distance of the feet."""
MAX_STRIDE_TURN = 1.05
"""Maximum turn of the heading in a stride, in radians."""


def synthesise(
    kind: str,
    *,
    speed: float | None = None,
    turn_rate: float | None = None,
    duration: float = 6.0,
    height_m: float = DEFAULT_HEIGHT_M,
    seed: int = 0,
    start: bool = False,
    stop: bool = False,
    name: str | None = None,
) -> Clip:
    """One clip of synthetic motion at 36 Hz, starting at the origin and facing +x.

    Args:
        kind: one of ``KINDS``, ``ACTIONS`` or ``SEATED``.
        speed: m/s on the path; by default the kind's usual speed. Waving and raising hands are
            done walking when a speed is given.
        turn_rate: rad/s of ``turn-left`` and ``turn-right``, 0.1 to 1.5; 0.8 by default.
        duration: seconds, 2 to 60.
        height_m: stature, 1.4 to 2.0 m.
        seed: of the small differences between people and days; same seed, same bits.
        start: whether the clip begins standing (not when jogging).
        stop: whether it ends standing (not when jogging).
        name: the clip's name; made of the arguments by default.

    Raises:
        InputError: unknown kind, or a value out of range.
    """
    wish = checked(kind, speed, turn_rate, duration, height_m, start, stop)
    check_seed(seed)
    qpos = _poses(wish, np.random.default_rng([seed, zlib.crc32(kind.encode())]))
    if name is None:
        parts = ["synthetic", kind]
        parts += [f"{speed:g}mps"] if speed is not None else []
        parts += [f"{turn_rate:g}radps"] if turn_rate is not None else []
        parts += [word for word, on in (("start", start), ("stop", stop)) if on]
        name = "-".join([*parts, f"{height_m:g}m", f"{duration:g}s", f"seed{seed}"])
    return _clips([(name, kind, qpos, height_m)])[0]


def _clips(made: list[tuple[str, str, np.ndarray, float]]) -> list[Clip]:
    """Clips of (name, kind, poses of the default body, height)."""
    scaled = []
    for _, _, qpos, height in made:
        qpos = qpos.copy()
        qpos[:, :3] *= height / DEFAULT_HEIGHT_M
        scaled.append(qpos)
    about = [_about(kind) for _, kind, _, _ in made]
    return clips_from_qpos([m[0] for m in made], scaled, [m[3] for m in made], about)


def _about(kind: str) -> dict[str, str]:
    return {"source": "synthetic (questsim.motion.synthesis)", "licence": "MIT", "kind": kind}


def _poses(wish: Wish, rng: np.random.Generator) -> np.ndarray:
    """Poses ``(T, 40)`` of the default body."""
    kind = wish.kind
    gesture = GESTURES.get(kind)
    if kind in SEATED:
        time, shown = _frames(wish, 1.0)
        gait = gait_at(MIN_SPEED, _hip_height(), False)
        return seated_poses(time, wish.seconds, _hip_height(), gait, rng)[shown]
    if kind in ACTIONS:
        time, shown = _frames(wish, 1.0)
        return perform(ACTIONS[kind](time, wish.seconds, rng), time, rng, shown)[shown]
    if kind == "stand" or (gesture is not None and wish.speed == 0.0):
        return _stand(wish, rng)
    if kind == "backwards":
        # Walking backwards is close to walking forward run in reverse (Winter, Pluck & Yang,
        # J. Motor Behavior 21, 1989), and so are the laws of balance.
        forward = replace(wish, start=wish.stop, stop=wish.start)
        return _at_origin(_travel(forward, rng, wish.speed, 0.0, 0.0)[::-1])
    if kind.startswith("side"):
        return _travel(wish, rng, 0.0, wish.speed if kind == "side-left" else -wish.speed, 0.0)
    turn = wish.turn_rate if kind == "turn-left" else -wish.turn_rate
    return _travel(wish, rng, wish.speed, 0.0, turn)


def _at_origin(qpos: np.ndarray) -> np.ndarray:
    qpos = qpos.copy()
    qpos[:, :2] -= qpos[0, :2]
    return qpos


@lru_cache(maxsize=1)
def _hip_height() -> float:
    """Of the default body standing straight, metres."""
    return float(build_body().model.body("pelvis").pos[2])


def _frames(wish: Wish, margin_s: float) -> tuple[np.ndarray, slice]:
    """Times ``(T,)`` with a margin around the clip, and the clip among them."""
    frames = int(np.floor(wish.seconds * wish.rate + 1e-6)) + 1
    margin = int(np.ceil(margin_s * wish.rate))
    return np.arange(-margin, frames + margin) / wish.rate, slice(margin, margin + frames)


def _personal(gait: Gait, rng: np.random.Generator) -> Gait:
    """The same gait as a slightly different person's."""

    def vary(value: float, by: float) -> float:
        return float(value * np.clip(1.0 + by * rng.standard_normal(), 0.5, 1.5))

    return replace(
        gait,
        stride_s=vary(gait.stride_s, 0.02),
        step_width_m=vary(gait.step_width_m, 0.12),
        toe_out=vary(gait.toe_out, 0.3),
        lift=vary(gait.lift, 0.06),
        pelvis_turn=vary(gait.pelvis_turn, 0.2),
        pelvis_list=vary(gait.pelvis_list, 0.2),
        chest_turn=vary(gait.chest_turn, 0.2),
        lean=vary(gait.lean, 0.15),
        shoulder_swing=vary(gait.shoulder_swing, 0.15),
        elbow_mean=vary(gait.elbow_mean, 0.06),
        elbow_swing=vary(gait.elbow_swing, 0.2),
        abduction=vary(gait.abduction, 0.15),
    )


def _travel(
    wish: Wish, rng: np.random.Generator, forward: float, left: float, turn: float
) -> np.ndarray:
    """Poses of a body that travels at a velocity (m/s) and a turn rate (rad/s)."""
    time, shown = _frames(wish, MARGIN_S)
    pace = max(float(np.hypot(forward, left)), 0.3 * abs(turn))
    # Turning at a jog is jogging; side steps and turns on the spot are short walking steps.
    jog = wish.kind == "jog" or (turn != 0.0 and forward > MAX_WALK)
    gait = _personal(gait_at(pace, _hip_height(), jog), rng)
    if abs(forward) < 0.2:
        # Side steps and turns on the spot: quick, short and flat-footed.
        gait = replace(
            gait,
            stride_s=SHUFFLE_STRIDE_S,
            step_width_m=SHUFFLE_WIDTH_M,
            push_pitch=np.deg2rad(35.0),
            bob_m=0.008,
        )
    if turn != 0.0:
        # The hips' outward rotation is limited, so quick turns need quick steps.
        most = max(MAX_STRIDE_TURN / abs(turn), 0.7)
        width = gait.step_width_m + 0.06 * min(abs(turn), 1.0)
        gait = replace(gait, stride_s=min(gait.stride_s, most), step_width_m=width)
    first = int(rng.random() < 0.5)
    if left != 0.0 or forward == 0.0:
        first = 0 if left + turn > 0.0 else 1
    begin = rng.uniform(0.45, 0.7) if wish.start else None
    end = wish.seconds - rng.uniform(0.8, 1.0) if wish.stop else None
    ramp = 0.7 + 0.85 * pace
    share = np.ones(len(time))
    if begin is not None:
        share = share * smoothstep((time - begin) / ramp)
    if end is not None:
        share = share * smoothstep((end - time) / ramp)
    path = Path(time, share[:, None] * np.array([forward, left]), share * turn)
    steps = plan_steps(path, gait, begin, end, float(rng.random()), first)
    feet = feet_paths(steps, gait, time)
    _, cop = loads(steps, gait, time)
    posture = locomotion(path, steps, gait)
    straight = _hip_height() - 0.003
    height = (jogging_height if jog else walking_height)(gait, steps, straight)
    if wish.kind in GESTURES:
        posture = add_gesture(posture, GESTURES[wish.kind](time, wish.seconds, rng))
    return settle(posture, feet, height, cop, time, jog, shown)[shown]


def _stand(wish: Wish, rng: np.random.Generator) -> np.ndarray:
    """Poses of a body that stands, sways and gestures."""
    time, shown = _frames(wish, 1.0)
    frames = len(time)
    gesture = _rest(frames)
    if wish.kind in GESTURES:
        gesture = GESTURES[wish.kind](time, wish.seconds, rng)
    width = gesture.width * rng.uniform(0.9, 1.1)
    half = np.array([0.5 * gesture.stagger, 0.5 * width])
    ankles = np.array([half, -half]) - [0.05, 0.0]
    toe_out = np.deg2rad(rng.uniform(5.0, 12.0))
    steps = standing(ankles, np.array([toe_out, -toe_out]), frames)
    gait = gait_at(MIN_SPEED, _hip_height(), False)
    feet = feet_paths(steps, gait, time)
    _, cop = loads(steps, gait, time)
    calm = wish.kind == "stand"
    cop = cop + sway(time, rng, lateral_m=0.02 if calm else 0.006, forward_m=0.006)
    posture = add_gesture(idle(time, rng, looking=calm), gesture)
    height = _hip_height() - 0.004 - gesture.crouch
    return settle(posture, feet, height, cop, time, False, shown)[shown]


def _rest(frames: int) -> Gesture:
    none = np.zeros((frames, 3))
    return Gesture((None, None), np.zeros(frames), none, none, np.zeros(frames))


def synthetic_clips(
    seed: int = 0,
    heights: tuple[float, ...] = (DEFAULT_HEIGHT_M,),
    kinds: Container[str] = KINDS,
) -> list[Clip]:
    """The default library: clips of 4 to 10 s of every kind, the same bits for the same seed.

    Args:
        seed: of the differences between the clips' people.
        heights: statures in metres; every clip is made at each, at speeds that scale with the
            root of the height.
        kinds: make only these; a clip's bits do not depend on it.

    Raises:
        InputError: a height is outside 1.4 to 2.0 m, or the seed is below zero.
    """
    check_seed(seed)
    clips = []
    for height in heights:
        pace = float(np.sqrt(height / DEFAULT_HEIGHT_M))
        for number, (label, kind, seconds, options) in enumerate(_catalogue()):
            if kind not in kinds:
                continue
            given = dict(options)
            if "speed" in given:
                speed = float(given["speed"]) * pace
                given["speed"] = max(min(speed, MAX_SPEED), MIN_SPEED if kind == "walk" else 0.0)
            if "turn_rate" in given:
                given["turn_rate"] = float(given["turn_rate"]) / pace
            wish = checked(
                kind,
                given.get("speed"),
                given.get("turn_rate"),
                seconds,
                height,
                bool(given.get("start")),
                bool(given.get("stop")),
            )
            suffix = f"-{height:g}m" if len(heights) > 1 else ""
            clips.append(_kept_clip(f"synthetic-{label}{suffix}", wish, height, (seed, number)))
    return [_copied(clip) for clip in clips]


def seated_clips(seed: int = 0) -> list[Clip]:
    """Clips of 8 s of a person sitting down on a chair and standing up again.

    They are not part of ``synthetic_clips``, since they cannot be tracked without a chair.

    Args:
        seed: of the differences between the clips' people.

    Raises:
        InputError: the seed is below zero.
    """
    check_seed(seed)
    clips = []
    for kind in SEATED:
        for number in range(4):
            wish = checked(kind, None, None, 8.0, DEFAULT_HEIGHT_M, False, False)
            seeds = (seed, zlib.crc32(kind.encode()), number)
            name = f"synthetic-{kind}-{number + 1}"
            clips.append(_kept_clip(name, wish, DEFAULT_HEIGHT_M, seeds))
    return [_copied(clip) for clip in clips]


@lru_cache(maxsize=512)
def _kept_clip(name: str, wish: Wish, height_m: float, seeds: tuple[int, ...]) -> Clip:
    """A cached clip of the library; callers get writable copies."""

    def make() -> Clip:
        poses = _poses(wish, np.random.default_rng(list(seeds)))
        return _clips([(name, wish.kind, poses, height_m)])[0]

    about = {"name": name, "height_m": height_m, **_about(wish.kind)}
    return kept_clip(f"{wish} {seeds} {height_m}", about, make)


def _copied(clip: Clip) -> Clip:
    arrays = {name: value for name, value in vars(clip).items() if isinstance(value, np.ndarray)}
    return replace(clip, **{name: array.copy() for name, array in arrays.items()})


def _catalogue() -> list[tuple[str, str, float, dict[str, float | bool]]]:
    """(label, kind, seconds, options) of every clip of the library."""
    clips: list[tuple[str, str, float, dict[str, float | bool]]] = []
    for speed in (0.5, 0.7, 0.9, 1.1, 1.3, 1.5, 1.7, 1.9, 2.1):
        clips.append((f"walk-{speed:g}", "walk", 6.0, {"speed": speed}))
    for speed in (0.8, 1.2, 1.6):
        both: dict[str, float | bool] = {"speed": speed, "start": True, "stop": True}
        clips.append((f"walk-{speed:g}-start-stop", "walk", 8.0, both))
    for speed in (1.7, 2.0, 2.3, 2.6, 2.9, 3.2, 3.5):
        clips.append((f"jog-{speed:g}", "jog", 5.0, {"speed": speed}))
    for side in ("left", "right"):
        for speed, rate in ((0.0, 1.0), (0.7, 0.5), (1.0, 0.9), (1.4, 0.5), (2.4, 0.6)):
            stop = speed < 1.2
            turn: dict[str, float | bool] = {"speed": speed, "turn_rate": rate}
            turn |= {"start": stop, "stop": stop}
            clips.append((f"turn-{side}-{speed:g}-{rate:g}", f"turn-{side}", 6.0, turn))
        for speed in (0.3, 0.5):
            steps: dict[str, float | bool] = {"speed": speed, "start": True, "stop": True}
            clips.append((f"side-{side}-{speed:g}", f"side-{side}", 6.0, steps))
    for speed, both_ends in ((0.5, True), (0.7, False), (1.0, False)):
        back: dict[str, float | bool] = {"speed": speed, "start": both_ends, "stop": both_ends}
        clips.append((f"backwards-{speed:g}", "backwards", 6.0, back))
    for number in range(3):
        clips.append((f"stand-{number + 1}", "stand", 8.0, {}))
    for kind in GESTURES:
        for number in range(2):
            clips.append((f"{kind}-{number + 1}", kind, 7.0, {}))
    for kind in WALKABLE:
        clips.append((f"walk-{kind}", kind, 6.0, {"speed": 1.1}))
    return clips
