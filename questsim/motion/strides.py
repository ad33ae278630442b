"""Checks that the root travels as the legs step, against wrong units and wrong orders of rotations.

A foot that bears the body stands still. If it slides with what a file declares, but would stand
with another scale of the root's path, another order of the rotation channels or other angles, the
declaration is wrong. Someone who stays in place shows nothing of this.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from questsim import rotations as rot
from questsim.motion.convert import axis_vector, global_pose
from questsim.motion.families import Family
from questsim.motion.motion import Motion
from questsim.motion.recording import Recording
from questsim.skeleton import JOINTS

FEET = ("left_ankle", "left_toe", "right_ankle", "right_toe")
MIN_S, OVER_S = 0.6, 1.0 / 30.0
MAX_FRAMES = 600
MIN_STRIDE = 0.5
"""Leg lengths a second, relative to the root, from which the lowest point of the feet steps."""
MIN_SHARE, MIN_AGREEMENT = 0.5, 0.95
"""Share of frames in which someone steps, and cosine between the root's velocity and the steps'."""
SCALE = (0.6, 1.6)
"""Accepted ratio of the legs' steps to the root's travel. In 30 walks measured it is 0.87-1.06."""
SLIDES, TRAVELS = 0.2, 0.25
"""Leg lengths a second of the slower foot, and of the root, from which other orders are tried."""
MUCH_BETTER = 0.4
"""Another declaration is right if the feet slide by less than this share; of 8 alternatives to
what 150 real files declare, none that is wrong comes below it."""
UPRIGHT = 1.1
"""Leg lengths of the head above the feet."""


@dataclass(frozen=True)
class _Steps:
    """Velocities in leg lengths a second.

    Attributes:
        root: ``(T, 3)``.
        feet: ``(T, n, 3)`` of points of both feet.
        lowest: ``(T,)`` which of the points is the lowest.
    """

    root: np.ndarray
    feet: np.ndarray
    lowest: np.ndarray

    @property
    def slide(self) -> float:
        """Median speed of the slowest point."""
        return float(np.median(np.linalg.norm(self.feet, axis=-1).min(axis=1)))


def _steps(root: np.ndarray, feet: np.ndarray, up: np.ndarray, leg: float, fps: float) -> _Steps:
    over = max(1, round(OVER_S * fps))

    def velocity(place: np.ndarray) -> np.ndarray:
        return (place[over:] - place[:-over]) * (fps / over / leg)

    return _Steps(velocity(root), velocity(feet), (feet[over:] @ up).argmin(axis=1))


def _leg(motion: Motion) -> float:
    bones = [JOINTS.index(f"left_{joint}") for joint in ("knee", "ankle")]
    return max(float(np.linalg.norm(motion.offsets[bones], axis=-1).sum()), 1e-9)


def _of(motion: Motion, position: np.ndarray) -> _Steps:
    feet = position[:, [JOINTS.index(joint) for joint in FEET]]
    return _steps(position[:, 0], feet, np.array([0.0, 0.0, 1.0]), _leg(motion), motion.fps)


def path_problem(motion: Motion, position: np.ndarray) -> str:
    """Says that the root's path has another scale than the steps; empty if not.

    Args:
        motion: the motion.
        position: its joints ``(T, 22, 3)``.
    """
    if motion.duration < MIN_S:
        return ""
    steps = _of(motion, position)
    lowest = steps.feet[np.arange(len(steps.lowest)), steps.lowest]
    back, path = (steps.root - lowest)[:, :2], steps.root[:, :2]
    go = np.linalg.norm(back, axis=-1) > MIN_STRIDE
    if go.mean() < MIN_SHARE:
        return ""
    back, path = back[go], path[go]
    along, travel, stride = np.sum(back * path), np.sum(path**2), np.sum(back**2)
    if along < MIN_AGREEMENT * np.sqrt(travel * stride) or travel < 1e-12 * stride:
        return ""
    scale = float(along / travel)
    if SCALE[0] < scale < SCALE[1]:
        return ""
    return (
        f"the legs step {scale:.3g} times as far as the root travels: the root's positions have "
        "other units than the bones, or the angles are scaled"
    )


def order_problem(recording: Recording, family: Family, motion: Motion, up: str) -> str:
    """Says that the feet would stand with another order or scale of the rotations; empty if not.

    Args:
        recording: the motion on its own joints.
        family: the mapping of its joints.
        motion: the motion as declared.
        up: the file's up axis.
    """
    if len(recording.order) != 3 or motion.duration < MIN_S:
        return ""
    declared = _of(motion, motion.forward_kinematics()[0])
    speed = float(np.median(np.linalg.norm(declared.root, axis=-1)))
    if declared.slide < SLIDES or speed < TRAVELS:
        return ""
    start = max(0, (len(recording.positions) - MAX_FRAMES) // 2)
    some = replace(
        recording,
        positions=recording.positions[start : start + MAX_FRAMES],
        rotations=recording.rotations[start : start + MAX_FRAMES],
    )
    best, slide = "", MUCH_BETTER * declared.slide
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # gimbal lock: any solution will do
        angles = rot.as_rotation(some.rotations).as_euler(some.order)
    for what, order, scale in _alternatives(recording.order):
        turns = rot.from_euler(order, angles * scale)
        other = replace(some, rotations=rot.as_quat(turns, some.rotations.shape[:2]))
        found = _slide(other, family, up)
        if found < slide:
            best, slide = what, found
    if not best:
        return ""
    leg = _leg(motion)
    return (
        f"the feet slide at {declared.slide * leg:.1f} m/s, but {best} they would at "
        f"{slide * leg:.1f} m/s: the rotations are not as the file declares them"
    )


def _alternatives(order: str) -> list[tuple[str, str, float]]:
    orders = ["".join(letters) for letters in permutations("XYZ")]
    out = [(f"with channels in the order {o}", o, 1.0) for o in orders if o != order]
    return [*out, ("with angles twice as large", order, 2.0), ("with half the angles", order, 0.5)]


def _slide(recording: Recording, family: Family, up: str) -> float:
    """How fast the feet slide, in leg lengths a second; infinite if the body is not upright."""
    position, _ = global_pose(recording)

    def at(joint: str) -> np.ndarray:
        return position[:, recording.names.index(family.joints[joint])]

    feet = np.stack([at(joint) for joint in FEET if joint in family.joints], axis=1)
    leg = 2.0 * float(np.median(np.linalg.norm(at("left_knee") - at("left_hip"), axis=-1)))
    vertical = axis_vector(up)
    tall = np.median((at("head") - feet.mean(axis=1)) @ vertical)
    if tall < UPRIGHT * leg:
        return np.inf
    return _steps(at("root"), feet, vertical, leg, recording.fps).slide
