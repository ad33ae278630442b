"""Motion of arms, trunk and knees in a gesture, added to standing or walking.

The hands follow paths in the chest's frame, given as shares of the arm's length from the
shoulder; two-bone inverse kinematics finds the arm. Timing and extent are those of unhurried
everyday movement: waving near 1.6 Hz, writing strokes near 2 Hz (Viviani & Terzuolo,
Neuroscience 7, 1982), punches of about 0.3 s (Piorkowski et al., J. Sports Sci. 29, 2011).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from questsim import rotations as rot
from questsim.motion.kinematics import link_offsets
from questsim.motion.synthesis.plan import smoothstep
from questsim.motion.synthesis.pose import Arm
from questsim.skeleton import LINKS

DOWN_OUT = np.array([-0.25, 0.45, -1.0])
"""Default direction of an elbow: down, a little out and back (x, outward, z)."""


@dataclass
class Gesture:
    """A gesture over time, of the default body.

    Attributes:
        arms: left and right; None leaves an arm to the gait.
        weight: ``(T,)`` blend of the arms from the gait (0) to the gesture (1).
        chest, head: ``(T, 3)`` yaw, pitch, roll in radians, added to the trunk's.
        crouch: ``(T,)`` metres by which the pelvis sinks.
        width, stagger: of the standing feet in metres: apart, and left before right.
    """

    arms: tuple[Arm | None, Arm | None]
    weight: np.ndarray
    chest: np.ndarray
    head: np.ndarray
    crouch: np.ndarray
    width: float = 0.20
    stagger: float = 0.0


def arm_lengths() -> tuple[float, float]:
    """Upper arm and forearm of the default body in metres."""
    offsets = link_offsets()
    return (
        float(-offsets[LINKS.index("left_forearm"), 2]),
        float(-offsets[LINKS.index("left_hand"), 2]),
    )


def reach(target: np.ndarray, side: int, elbow_to: np.ndarray = DOWN_OUT, turn: float = 0.0) -> Arm:
    """The arm whose wrist is at a point.

    Args:
        target: ``(T, 3)`` forward, outward and up from the shoulder, in arm's lengths.
        side: 0 left, 1 right.
        elbow_to: ``(3,)`` where the elbow points, in the same axes.
        turn: of the hand about the forearm, inward is positive, in radians.
    """
    upper, fore = arm_lengths()
    mirror = np.array([1.0, 1.0 if side == 0 else -1.0, 1.0])
    wrist = target * mirror * (upper + fore)
    distance = np.linalg.norm(wrist, axis=-1, keepdims=True)
    along = wrist / distance
    distance = np.clip(distance, 0.35 * (upper + fore), 0.985 * (upper + fore))
    aside = elbow_to * mirror - along * (along @ (elbow_to * mirror))[:, None]
    aside /= np.linalg.norm(aside, axis=-1, keepdims=True)
    cos = (upper**2 + distance**2 - fore**2) / (2.0 * upper * distance)
    sin = np.sqrt(1.0 - cos**2)
    up = -(along * cos + aside * sin)
    forward = along * sin - aside * cos
    matrix = np.stack([forward, np.cross(up, forward), up], axis=-1)
    bend = np.arccos((distance[:, 0] ** 2 - upper**2 - fore**2) / (2.0 * upper * fore))
    wrist_angles = np.zeros((len(target), 2))
    wrist_angles[:, 0] = -mirror[1] * turn
    return Arm(rot.continuous(rot.matrix_to_quat(matrix)), bend, wrist_angles)


def _hold(time: np.ndarray, seconds: float, ease: float = 0.9) -> np.ndarray:
    """Weight from 0 to 1 to 0 over a clip, with a short rest at both ends."""
    return smoothstep((time - 0.3) / ease) * smoothstep((seconds - 0.3 - time) / ease)


def _still(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.zeros((len(time), 3)), np.zeros((len(time), 3)), np.zeros(len(time))


def _points(*xyz: np.ndarray | float, frames: int) -> np.ndarray:
    return np.stack([np.broadcast_to(np.asarray(v, float), frames) for v in xyz], axis=-1)


def wave(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Gesture:
    """The right hand waves beside the head."""
    weight = _hold(time, seconds)
    beat = 2.0 * np.pi * rng.uniform(1.4, 1.8) * time
    hand = _points(
        0.28, 0.42 + 0.15 * weight * np.sin(beat), 0.36 - 0.05 * np.cos(2 * beat), frames=len(time)
    )
    chest, head, crouch = _still(time)
    chest[:, 2] += np.deg2rad(2.0) * weight
    right = reach(hand, 1, np.array([-0.1, 0.6, -1.0]), np.deg2rad(60.0))
    return Gesture((None, right), weight, chest, head, crouch)


def raise_right_hand(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Gesture:
    """The right hand goes up, as for a question, and down again."""
    weight = _hold(time, seconds, 1.1)
    sway = 0.02 * np.sin(2.0 * np.pi * rng.uniform(0.4, 0.7) * time)
    hand = _points(0.22 + sway, 0.22 + sway, 0.88, frames=len(time))
    chest, head, crouch = _still(time)
    chest[:, 2] -= np.deg2rad(4.0) * weight
    head[:, 1] -= np.deg2rad(6.0) * weight
    return Gesture((None, reach(hand, 1, np.array([0.3, 1.0, -0.3]))), weight, chest, head, crouch)


def raise_both_hands(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Gesture:
    """Both hands go up, stay, and come down."""
    weight = _hold(time, seconds, 1.2)
    sway = 0.02 * np.sin(2.0 * np.pi * rng.uniform(0.4, 0.7) * time)
    hand = _points(0.18 + sway, 0.30 - sway, 0.86, frames=len(time))
    chest, head, crouch = _still(time)
    chest[:, 1] -= np.deg2rad(3.0) * weight
    head[:, 1] -= np.deg2rad(8.0) * weight
    hint = np.array([0.3, 1.0, -0.3])
    return Gesture((reach(hand, 0, hint), reach(hand, 1, hint)), weight, chest, head, crouch)


def whiteboard(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Gesture:
    """The right hand writes lines on a board at shoulder height; the eyes follow."""
    weight = _hold(time, seconds)
    line = rng.uniform(2.4, 3.0)
    share = np.mod(time / line, 1.0)
    # Four fifths of the time writes a line, one fifth moves back to the next one.
    along = np.where(share < 0.8, share / 0.8, 1.0 - smoothstep((share - 0.8) / 0.2))
    stroke = 2.0 * np.pi * rng.uniform(1.7, 2.1) * time
    writing = weight * np.clip(10.0 * np.minimum(share, 0.8 - share), 0.0, 1.0)
    row = np.interp(time / line, np.arange(9) + 0.9, 0.12 - 0.08 * np.arange(9))
    hand = _points(
        0.72 - 0.03 * np.cos(stroke) * writing,
        0.22 - 0.45 * (1.0 - along) + 0.02 * np.sin(stroke) * writing,
        row + 0.05 * np.sin(2.0 * stroke + 0.5) * writing,
        frames=len(time),
    )
    chest, head, crouch = _still(time)
    chest[:, 0] += np.deg2rad(6.0) * weight * (1.0 - 2.0 * along)
    head[:, 0] += np.deg2rad(10.0) * weight * (1.0 - 2.0 * along) - np.deg2rad(8.0) * weight
    hint = np.array([-0.1, 0.6, -1.0])
    return Gesture((None, reach(hand, 1, hint, np.deg2rad(70.0))), weight, chest, head, crouch)


def boxing(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Gesture:
    """A guard with the left foot forward, and punches left and right."""
    weight = _hold(time, seconds, 0.7)
    out = np.zeros((2, len(time)))
    at = 1.5
    while at < seconds - 1.8:
        side = int(rng.random() < 0.5)
        for hand in (side, 1 - side):
            out[hand] += smoothstep((time - at) / 0.30) * smoothstep((at + 0.72 - time) / 0.38)
            at += rng.uniform(0.50, 0.60)
        at += rng.uniform(0.3, 0.7)
    guard, punch = np.array([0.44, -0.12, -0.02]), np.array([0.96, -0.24, 0.02])
    arms = []
    for side in range(2):
        hand = guard + out[side][:, None] * (punch - guard)
        arms.append(reach(hand, side, np.array([-0.2, 0.4, -1.0]), np.deg2rad(50.0)))
    chest, head, _ = _still(time)
    chest[:, 0] = np.deg2rad(22.0) * (out[1] - out[0]) - np.deg2rad(8.0) * weight
    chest[:, 1] = np.deg2rad(5.0) * weight
    bounce = 0.008 * np.sin(2.0 * np.pi * 1.1 * time) * weight
    return Gesture((arms[0], arms[1]), weight, chest, head, 0.06 * weight + bounce, 0.26, 0.30)


def squat(time: np.ndarray, seconds: float, rng: np.random.Generator) -> Gesture:
    """Squats with the arms stretched forward."""
    count = max(int((seconds - 0.6) // 2.6), 1)
    period = (seconds - 0.6) / count
    share = np.mod((time - 0.3) / period, 1.0)
    inside = (time > 0.3) & (time < seconds - 0.3)
    down = smoothstep(share / 0.42) * smoothstep((1.0 - share) / 0.42)
    depth = np.where(inside, down, 0.0)
    hand = _points(0.93, -0.05, -0.12, frames=len(time))
    arms = (reach(hand, 0, turn=0.3), reach(hand, 1, turn=0.3))
    chest, head, _ = _still(time)
    chest[:, 1] = np.deg2rad(36.0) * depth
    head[:, 1] = np.deg2rad(8.0) * depth
    return Gesture(arms, depth, chest, head, rng.uniform(0.24, 0.32) * depth, 0.30)


GESTURES: dict[str, Callable[[np.ndarray, float, np.random.Generator], Gesture]] = {
    "wave": wave,
    "raise-both-hands": raise_both_hands,
    "raise-right-hand": raise_right_hand,
    "whiteboard": whiteboard,
    "boxing": boxing,
    "squat": squat,
}
"""Maps a kind of motion to the function that generates it."""

WALKABLE = ("wave", "raise-both-hands", "raise-right-hand")
"""Gestures that people also make while walking."""
