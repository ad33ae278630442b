"""Checks that the root travels as far as the legs step, against wrong units of the root's path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from questsim.motion.motion import Motion
from questsim.skeleton import JOINTS

FEET = ("left_ankle", "left_toe", "right_ankle", "right_toe")
MIN_S, OVER_S = 0.6, 1.0 / 30.0
MIN_STRIDE = 0.5
"""Leg lengths a second, relative to the root, from which the lowest point of the feet steps."""
MIN_SHARE, MIN_AGREEMENT = 0.5, 0.95
"""Share of frames in which someone steps, and cosine between the root's velocity and the steps'."""
SCALE = (0.6, 1.6)
"""Accepted ratio of the legs' steps to the root's travel. In 30 walks measured it is 0.87-1.06."""


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
