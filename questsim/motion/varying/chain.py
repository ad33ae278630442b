"""Chains: clips one after the other, as a user of a headset performs them.

The user stands still, goes over to the first pose of a clip in about a second, performs it from
rest to rest, goes over to the next, and often stands in between. Feet that have to move step, one
after the other. Whoever follows a headset meets these moments between recorded motions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M
from questsim.errors import InputError
from questsim.licences import of_parts
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import clip_from_qpos, standing_clip
from questsim.motion.synthesis.plan import smoothstep
from questsim.motion.synthesis.synthetic import SEATED
from questsim.motion.varying.figure import Figure, check_bodies, figure_of, solve
from questsim.motion.varying.stances import move_pressure
from questsim.skeleton import DOFS

KIND = "chain"
EASED_FRAMES = 18
"""A clip's first and last half second take a second each: users do not start at full speed."""
REST_M_S = 0.3
"""A clip whose pelvis is slower in its first and last frame can be performed from rest."""
LONGEST_S = 10.0
"""Longer clips are not chained: a chain has several."""
LIMITS = (
    f"begin and end at rest, last {3 * EASED_FRAMES / FPS:g} to {LONGEST_S:g} s and need no chair"
)
"""What the clips of a chain do, for messages."""

_STILL_S, _BETWEEN_S, _OVER_S = (0.8, 2.5), (0.5, 1.4), (0.9, 1.6)
"""Ranges of the time of standing at first and in between, and of going over to the next pose."""
_STANDS = 0.4
"""Share of the clips after which the user stands."""
_STRAIGHT = 0.3
"""Share of the chains whose user stands like the avatar's default pose, arms along the body."""
_FIXED_M = 0.03
"""A foot that is this near its next place slides there."""
_STEPS = ((0.12, 0.45), (0.55, 0.88))
"""Times of the two steps as shares of the time of going over."""
_STEP_M = 0.07
"""Height of these steps."""
_LOADED = 0.06
"""The other foot bears all weight from this share of the time before a step until after it."""


def can_be_chained(clip: Clip) -> bool:
    """Whether a clip begins and ends at rest without a chair, and is neither short nor long."""
    speed = np.linalg.norm(clip.qvel[[0, -1], :2], axis=-1)
    long_enough = 3 * EASED_FRAMES < len(clip) <= LONGEST_S * FPS
    return bool(long_enough and speed.max() < REST_M_S and clip.kind not in SEATED)


def chains(clips: Sequence[Clip], count: int, each: int = 2, seed: int = 0) -> Iterator[Clip]:
    """Chains of random clips; number and seed determine each.

    Args:
        clips: to choose from.
        count: number of chains.
        each: clips of a chain, all different.
        seed: of the choice and of the times.

    Raises:
        InputError: fewer than ``each`` clips can be chained, or one has other proportions than the
            default body.
    """
    check_bodies(clips, "chains")
    pool = [clip for clip in clips if can_be_chained(clip)]
    if len(pool) < each:
        what = f"{len(pool)} of {len(clips)} clips {LIMITS}"
        raise InputError(what, "chains", f"a chain needs {each}: name more motions")
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        chosen = rng.choice(len(pool), each, replace=False)
        yield chain(f"{KIND}-{seed}-{number}", [pool[i] for i in chosen], rng)


def chain(name: str, clips: Sequence[Clip], rng: np.random.Generator) -> Clip:
    """One clip of a user who stands, and then performs these in their order.

    Args:
        name: of the chain.
        clips: each begins where and with the heading with which the one before ended.
        rng: draws the arms of the standing user, the times, and which foot steps first.

    Raises:
        InputError: a clip has other proportions than the default body.
    """
    check_bodies(clips, "chains")
    still = _standing(rng)
    qpos = np.repeat(still[None], _frames(_STILL_S, rng), axis=0)
    for clip in clips:
        last = qpos[-1]
        clip = placed(clip.scaled(DEFAULT_HEIGHT_M), float(rot.heading(last[3:7])), last[:2])
        done = interpolated(clip.qpos, eased_frames(len(clip)))
        qpos = np.concatenate([qpos, going_over(last, done[0], _frames(_OVER_S, rng), rng), done])
        if rng.random() < _STANDS:
            last, there = qpos[-1], still.copy()
            there[:2], there[3:7] = last[:2], rot.yaw_quat(rot.heading(last[3:7]))
            qpos = np.concatenate(
                [
                    qpos,
                    going_over(last, there, _frames(_OVER_S, rng), rng),
                    np.repeat(there[None], _frames(_BETWEEN_S, rng), axis=0),
                ]
            )
    source = "chain of " + ", ".join(clip.name for clip in clips)
    made = clip_from_qpos(name, qpos, DEFAULT_HEIGHT_M, kind=KIND, source=source)
    return replace(made, licence=of_parts(clip.licence for clip in clips))


def going_over(
    before: np.ndarray, after: np.ndarray, frames: int, rng: np.random.Generator
) -> np.ndarray:
    """Poses ``(frames, 40)`` between two poses ``(40,)`` of the default body, without the two.

    A foot that has to move makes one step, while the weight is over the other.
    """
    share = np.arange(frames + 2) / (frames + 1)
    ends = np.stack([before, after])
    figure = figure_of(interpolated(ends, smoothstep(share)))
    first = int(rng.integers(2))
    weight = np.zeros((len(share), 2))
    for foot, span in zip((first, 1 - first), _STEPS, strict=True):
        if _step(figure, foot, np.clip((share - span[0]) / (span[1] - span[0]), 0.0, 1.0)):
            middle = figure_of(ends).ankle[0, :, :2].mean(axis=0)
            bears = (share > span[0] - _LOADED) & (share < span[1] + _LOADED)
            smooth = np.convolve(np.pad(bears.astype(float), 2), np.full(5, 0.2), mode="valid")
            weight += smooth[:, None] * (figure.ankle[:, 1 - foot, :2] - middle)
    if weight.any():
        weight[[0, -1]] = 0.0
        move_pressure(figure, weight)
    return solve(figure)[1:-1]


def _step(figure: Figure, foot: int, progress: np.ndarray) -> bool:
    """Move a foot from its first to its last place as ``(T,)`` says; whether it was lifted."""
    place, turned = figure.ankle[[0, -1], foot].copy(), figure.foot[[0, -1], foot].copy()
    moved = smoothstep(progress)
    figure.ankle[:, foot] = place[0] + moved[:, None] * (place[1] - place[0])
    figure.foot[:, foot] = rot.resample_quat(rot.continuous(turned), np.arange(2.0), moved)
    lifted = bool(np.linalg.norm(place[1] - place[0]) > _FIXED_M)
    if lifted:
        figure.ankle[:, foot, 2] += _STEP_M * np.sin(np.pi * progress) ** 1.5
    return lifted


def placed(clip: Clip, heading_rad: float, spot: np.ndarray) -> Clip:
    """The clip, turned and moved so that it begins at a place ``(2,)`` with a heading."""
    yaw = heading_rad - float(rot.heading(clip.qpos[0, 3:7]))
    turn = rot.yaw_quat(np.array(yaw))
    qpos = clip.qpos.copy()
    qpos[:, 3:7] = rot.quat_multiply(turn, qpos[:, 3:7])
    start = rot.quat_rotate(turn, qpos[0, :3])
    qpos[:, :3] = rot.quat_rotate(turn, qpos[:, :3])
    qpos[:, :2] += spot - start[:2]
    about = {"kind": clip.kind, "style": clip.style, "source": clip.source}
    return replace(
        clip_from_qpos(clip.name, qpos, clip.height_m, clip.proportions, **about),
        licence=clip.licence,
    )


def eased_frames(frames: int) -> np.ndarray:
    """Fractional frames ``(T,)`` that play a clip from rest to full speed and back to rest."""
    last = frames - 1
    ramp = np.arange(2 * EASED_FRAMES) ** 2 / (4.0 * EASED_FRAMES)
    whole = np.arange(EASED_FRAMES, last - EASED_FRAMES + 1)
    return np.concatenate([ramp, whole, (last - ramp)[::-1]])


def interpolated(qpos: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Poses ``(T, 40)`` at fractional frames ``(T,)`` of poses ``(N, 40)``."""
    frames = np.arange(len(qpos), dtype=float)
    poses = rot.resample_points(qpos, frames, at)
    poses[:, 3:7] = rot.resample_quat(rot.continuous(qpos[:, 3:7]), frames, at)
    return poses


def _standing(rng: np.random.Generator) -> np.ndarray:
    """Pose ``(40,)`` of a user who stands with hanging arms."""
    qpos = standing_clip(DEFAULT_HEIGHT_M).qpos[0].copy()
    if rng.random() < _STRAIGHT:
        return qpos
    for number, name in enumerate(DOFS, start=7):
        if name.endswith("shoulder_x"):
            qpos[number] = rng.uniform(0.0, 0.3) * (1.0 if name.startswith("left") else -1.0)
        elif name.endswith("shoulder_y"):
            qpos[number] = rng.normal(0.0, 0.08)
        elif name.endswith("elbow_y"):
            qpos[number] = -abs(rng.normal(0.0, 0.08))
    return qpos


def _frames(seconds: tuple[float, float], rng: np.random.Generator) -> int:
    return round(float(rng.uniform(*seconds)) * FPS)
