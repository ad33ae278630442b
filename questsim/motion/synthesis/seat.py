"""Sitting down on a chair, sitting, and standing up again.

Until the seat bears it, the body balances over its feet as in any crouch (``synth_balance``): the
trunk leans forward so that the hips can go back (Schenkman et al., "Whole-body movements during
rising to standing from sitting", Physical Therapy 70, 1990). The seat is
placed where the balanced hips end; the root rests on it and the trunk rises.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from questsim.motion.synthesis.balance import settle
from questsim.motion.synthesis.feet import Feet, feet_paths
from questsim.motion.synthesis.gait_curves import Gait
from questsim.motion.synthesis.plan import COP_STANDING_M, STANDING_WIDTH_M, smoothstep, standing
from questsim.motion.synthesis.pose import Posture, solve
from questsim.motion.synthesis.posture import REST_ABDUCTION, REST_ELBOW, arm, drift, idle

SEAT_HEIGHT_M = 0.45
"""Height of the seat for a person of 1.75 m; chairs scale with the person."""
SEAT_BEHIND_M = 0.12
"""Distance of the seat's centre behind the hips."""
LEAST_SECONDS = 6.0
"""Minimum duration of a seated clip at 1.75 m: sitting down, sitting and standing up."""

SEATED_ROOT_M = SEAT_HEIGHT_M + 0.084
"""Root height when seated: the seat plus half the thickness of thighs that slope to the knees."""
_DOWN_S, _UP_S = 1.7, 1.6
_TRUNK_S = 0.9
"""Seconds in which the trunk rises after sitting down and bows before standing up."""
_BOW_PELVIS, _BOW_CHEST = np.deg2rad(26.0), np.deg2rad(56.0)
_PRESSURE_BACK_M = 0.055
"""Shift of the pressure from its standing position towards the heels."""
_WIDTH_M = 1.25 * STANDING_WIDTH_M


def seated_poses(
    time: np.ndarray, seconds: float, hip_m: float, gait: Gait, rng: np.random.Generator
) -> np.ndarray:
    """Poses ``(T, 40)`` of the default body sitting down from standing and standing up again.

    Args:
        time: ``(T,)`` seconds, with margins; the clip's first frame is at zero.
        seconds: of the clip.
        hip_m: root height when standing straight.
        gait: any, since the feet do not move.
        rng: of small differences between people.
    """
    begin = rng.uniform(0.5, 0.8)
    touch = begin + _DOWN_S * rng.uniform(0.92, 1.08)
    leave = seconds - rng.uniform(0.6, 0.9) - _UP_S * rng.uniform(0.95, 1.05)
    stood = leave + _UP_S
    down = smoothstep((time - begin) / (touch - begin))
    up = smoothstep((time - leave) / (stood - leave))
    low = down * (1.0 - up)
    # The bow starts before the hips move and ends before the body stands.
    bow = smoothstep((time - begin) / (0.8 * (touch - begin)))
    bow *= 1.0 - smoothstep((time - leave - 0.15) / (0.85 * (stood - leave)))
    toe_out = np.deg2rad(rng.uniform(6.0, 12.0))
    half = 0.5 * _WIDTH_M * rng.uniform(0.92, 1.08)
    ankles = np.array([[-COP_STANDING_M, half], [-COP_STANDING_M, -half]])
    feet = feet_paths(standing(ankles, np.array([toe_out, -toe_out]), len(time)), gait, time)
    pressure = np.column_stack([-_PRESSURE_BACK_M * low, np.zeros(len(time))])
    height = (hip_m - 0.004) + low * (SEATED_ROOT_M - hip_m + 0.004)
    upright = idle(time, rng, looking=False)
    bowed = _bent(upright, bow)
    qpos = settle(_with_arms(bowed, time, low, low, rng=None), feet, height, pressure, time, False)
    return _on_the_seat(qpos, upright, bow, low, (touch, leave), time, feet, rng)


def _on_the_seat(
    qpos: np.ndarray,
    upright: Posture,
    bow: np.ndarray,
    low: np.ndarray,
    seated: tuple[float, float],
    time: np.ndarray,
    feet: Feet,
    rng: np.random.Generator,
) -> np.ndarray:
    """The crouch, with the root at rest and the trunk upright while the seat carries the body."""
    touch, leave = seated
    first, last = np.searchsorted(time, touch), np.searchsorted(time, leave)
    root = qpos[:, :3].copy()
    share = smoothstep((time[first:last] - touch) / (leave - touch))[:, None]
    root[first:last] = (1.0 - share) * root[first] + share * root[last]
    risen = smoothstep((time - touch) / _TRUNK_S) * smoothstep((leave - time) / _TRUNK_S)
    posture = _bent(upright, bow * (1.0 - risen))
    return solve(_with_arms(posture, time, low, low * (1.0 - risen), rng), root, feet)


def _bent(upright: Posture, bow: np.ndarray) -> Posture:
    """The posture with the trunk bowed by shares ``(T,)``; the head looks less far down."""
    pelvis, chest, head = upright.pelvis.copy(), upright.chest.copy(), upright.head.copy()
    pelvis[:, 1] += _BOW_PELVIS * bow
    chest[:, 1] += _BOW_CHEST * bow
    head[:, 1] += 0.45 * _BOW_CHEST * bow
    return replace(upright, pelvis=pelvis, chest=chest, head=head)


def _with_arms(
    posture: Posture,
    time: np.ndarray,
    low: np.ndarray,
    reach: np.ndarray,
    rng: np.random.Generator | None,
) -> Posture:
    """Arms that reach forward while sitting down or standing up and rest in the lap between."""
    lap = low - reach
    arms = []
    for side in range(2):
        talk = np.zeros(len(time))
        if rng is not None:
            talk = lap * np.clip(1.6 * drift(time, rng, 0.15, 0.5), 0.0, 1.0) ** 2
        flexion = np.deg2rad(2.0) + np.deg2rad(50.0) * reach + np.deg2rad(16.0) * lap
        flexion += np.deg2rad(18.0) * talk
        elbow = REST_ELBOW + np.deg2rad(12.0) * reach + np.deg2rad(46.0) * lap
        elbow += np.deg2rad(40.0) * talk
        inward = np.deg2rad(12.0) + np.deg2rad(14.0) * lap
        arms.append(arm(flexion, np.full(len(time), REST_ABDUCTION), inward, elbow, side))
    return replace(posture, arms=(arms[0], arms[1]))
