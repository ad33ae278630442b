"""The upper body of a synthetic motion: trunk, head and arm swing in time with the steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy  # it imports its parts on first use

from questsim import rotations as rot
from questsim.motion.synthesis.gait_curves import Gait
from questsim.motion.synthesis.gestures import Gesture
from questsim.motion.synthesis.plan import Path, Steps
from questsim.motion.synthesis.pose import Arm, Posture

REST_ELBOW = np.deg2rad(14.0)
REST_ABDUCTION = np.deg2rad(7.0)
GAZE_AHEAD_S = 0.35
"""The head turns before the body (Grasso et al., Neuroscience Letters 253, 1998)."""


def arm(flexion: np.ndarray, abduction: np.ndarray, twist: np.ndarray, elbow: np.ndarray,
        side: int) -> Arm:  # fmt: skip
    """An arm from anatomical angles ``(T,)`` in radians; ``twist`` turns the forearm inward."""
    sign = 1.0 if side == 0 else -1.0
    upper = rot.from_euler("YXZ", np.stack([-flexion, sign * abduction, -sign * twist], axis=-1))
    return Arm(rot.as_quat(upper), elbow, np.zeros((len(elbow), 2)))


def locomotion(path: Path, steps: Steps, gait: Gait) -> Posture:
    """Trunk and arms of a steady or changing gait.

    At the left foot's touch-down (phase 0) the left hip and the right shoulder are forward; in
    left single support the right hip drops (Perry & Burnfield 2010).
    """
    frames = len(path.time)
    wave = 2.0 * np.pi * steps.phase
    amount, forward = steps.amount, _forward_share(path)
    swing = amount * forward
    late = 2.0 * np.pi * 0.5 * gait.duty
    turn = gait.pelvis_turn * swing * -np.cos(wave)
    sink = gait.pelvis_list * amount * -np.cos(wave - late)
    bank = _bank(path)
    pelvis = np.column_stack([turn, 0.4 * gait.lean * swing + np.deg2rad(2.0), sink + bank])
    chest = np.column_stack(
        [gait.chest_turn * swing * np.cos(wave), gait.lean * swing, -0.3 * sink + bank]
    )
    ahead = np.interp(path.time + GAZE_AHEAD_S, path.time, path.heading) - path.heading
    head = np.column_stack([0.7 * ahead, np.full(frames, np.deg2rad(2.0)), 0.3 * bank])
    arms = tuple(_swinging(gait, amount, swing, wave + np.pi * side, side) for side in range(2))
    return Posture(path.heading, pelvis, chest, head, (arms[0], arms[1]))


def _forward_share(path: Path) -> np.ndarray:
    """1 when walking forward, towards 0 for side steps and turns on the spot."""
    forward = np.abs(path.velocity[:, 0])
    other = np.abs(path.velocity[:, 1]) + 0.2 * np.abs(path.turn_rate)
    return np.maximum(forward, 1e-3) / (forward + other + 1e-3)


def _bank(path: Path) -> np.ndarray:
    """Lean of the trunk into a curve, in addition to the balanced path of the centre of mass."""
    pull = path.velocity[:, 0] * path.turn_rate / 9.81
    frames = 0.15 / (path.time[1] - path.time[0])
    return scipy.ndimage.gaussian_filter1d(-0.6 * np.arctan(pull), frames, mode="nearest")


def _swinging(
    gait: Gait, amount: np.ndarray, swing: np.ndarray, wave: np.ndarray, side: int
) -> Arm:
    """An arm that is farthest back at its own foot's touch-down."""
    ready = amount if gait.jog else swing
    flexion = gait.shoulder_mean * ready - gait.shoulder_swing * swing * np.cos(wave - 0.2)
    rest = REST_ELBOW * (1.0 - ready)
    elbow = rest + gait.elbow_mean * ready - gait.elbow_swing * swing * np.cos(wave - 0.5)
    abduction = REST_ABDUCTION + (gait.abduction - REST_ABDUCTION) * ready
    inward = np.deg2rad(12.0) + (np.deg2rad(10.0) * ready if gait.jog else 0.0)
    return arm(flexion, abduction, inward + np.zeros_like(elbow), elbow, side)


def blend(a: Arm, b: Arm, weight: np.ndarray) -> Arm:
    """From arm ``a`` (weight 0) to ``b`` (weight 1), the shorter way round."""
    w = weight[:, None]
    near = np.sign(np.sum(a.upper * b.upper, axis=-1, keepdims=True))
    upper = (1.0 - w) * a.upper + w * near * b.upper
    upper /= np.linalg.norm(upper, axis=-1, keepdims=True)
    return replace(
        a,
        upper=upper,
        elbow=(1.0 - weight) * a.elbow + weight * b.elbow,
        wrist=(1.0 - w) * a.wrist + w * b.wrist,
    )


def idle(time: np.ndarray, rng: np.random.Generator, looking: bool) -> Posture:
    """Standing at ease. With ``looking``, the head turns around and the trunk follows a little."""
    frames = len(time)
    size = 1.0 if looking else 0.15
    gaze = np.deg2rad(22.0) * size * drift(time, rng, 0.08, 0.25)
    nod = np.deg2rad(5.0) * size * drift(time, rng, 0.1, 0.3)
    lean = np.deg2rad(1.2) * drift(time, rng, 0.1, 0.4)
    tilt = np.full(frames, np.deg2rad(2.0))
    pelvis = np.column_stack([0.08 * gaze, tilt, 0.3 * lean])
    chest = np.column_stack([0.25 * gaze, 0.5 * tilt + 0.3 * lean, lean])
    head = np.column_stack([gaze, np.deg2rad(3.0) + nod, 0.5 * lean])
    arms = []
    for side in range(2):
        flexion = np.deg2rad(2.0) + np.deg2rad(3.0) * drift(time, rng, 0.1, 0.5)
        elbow = REST_ELBOW + np.deg2rad(4.0) * (1.0 + drift(time, rng, 0.1, 0.4))
        rest = np.full(frames, REST_ABDUCTION)
        arms.append(arm(flexion, rest, np.full(frames, np.deg2rad(12.0)), elbow, side))
    return Posture(np.zeros(frames), pelvis, chest, head, (arms[0], arms[1]))


def sway(
    time: np.ndarray, rng: np.random.Generator, lateral_m: float, forward_m: float
) -> np.ndarray:
    """Sway ``(T, 2)`` of the centre of pressure under a standing person (Winter 1995)."""
    return np.column_stack(
        [forward_m * drift(time, rng, 0.1, 0.5), lateral_m * drift(time, rng, 0.06, 0.35)]
    )


def drift(time: np.ndarray, rng: np.random.Generator, low_hz: float, high_hz: float) -> np.ndarray:
    """A smooth random wave ``(T,)`` within -1 to 1, of frequencies between the two."""
    total = np.zeros(len(time))
    for hertz in np.geomspace(low_hz, high_hz, 4):
        hertz = hertz * rng.uniform(0.85, 1.15)
        total += np.sin(2.0 * np.pi * (hertz * time + rng.random()))
    return total / 4.0


def add_gesture(posture: Posture, gesture: Gesture) -> Posture:
    """The posture with a gesture's arms and trunk on top."""
    arms = tuple(
        own if new is None else blend(own, new, gesture.weight)
        for own, new in zip(posture.arms, gesture.arms, strict=True)
    )
    pelvis = posture.pelvis.copy()
    # A deep bend of the trunk begins at the hips.
    pelvis[:, :2] += [0.35, 0.6] * gesture.chest[:, :2]
    return replace(
        posture,
        pelvis=pelvis,
        chest=posture.chest + gesture.chest,
        head=posture.head + gesture.head,
        arms=(arms[0], arms[1]),
    )
