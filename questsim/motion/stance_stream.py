"""Streaming ``stance.plant``: puts stance feet on the floor frame by frame, without lookahead.

The soles are measured from a recording. Where ``plant`` interpolates between two stances, the
stream holds the value until the next one begins. Two-sided filters are replaced by first-order
ones.
"""

from __future__ import annotations

import numpy as np

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M
from questsim.motion.clip import FPS
from questsim.motion.kinematics import sole_positions
from questsim.motion.stance import (
    LONGEST_GLIDE_S,
    ON_FLOOR_M,
    SLOW_M_S,
    STILL_M_S,
    TOUCH_M,
    Soles,
    flat_turn,
    from_lean,
    lacking_reach,
    lean,
    low_ankles,
    lowest_point,
)

FOOT_SHARE, ROOT_SHARE, RELEASE_SHARE = 0.5, 0.2, 0.1
"""Share of the remaining correction applied per frame at 36 Hz: for a foot, for the root, and for
the root rising again after it sank to let a leg reach."""


class StancePlanter:
    """Plants the feet of one stream of poses at 36 Hz.

    Args:
        soles: the person's soles.
        height: the avatar's stature in metres.
    """

    def __init__(self, soles: Soles, height: float) -> None:
        self._soles, self._height = soles, height
        self.reset()

    def reset(self) -> None:
        """The next pose is the first of a new stream."""
        self._centre: np.ndarray | None = None
        self._turned = np.zeros((2, 2))  # pitch and roll of each foot
        self._rise = np.zeros(2)
        self._root = 0.0
        self._sunk = 0.0
        self._bears = np.zeros(2)
        self._glided = 0  # frames since a foot stood, all with a sole near the floor

    def __call__(
        self, hips: np.ndarray, ankles: np.ndarray, feet: np.ndarray, leg_m: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Plant the next poses.

        Args:
            hips, ankles: ``(T, 2, 3)`` of the avatar, over the recording's floor.
            feet: ``(T, 2, 4)`` orientations.
            leg_m: length of a stretched leg.

        Returns:
            ankles ``(T, 2, 3)``, feet ``(T, 2, 4)``, the rise of the root ``(T,)`` in metres, and
            how far each foot is planted ``(T, 2)``, 0 to 1.
        """
        ankles, feet, rise = ankles.copy(), feet.copy(), np.empty(len(ankles))
        bears = np.empty(ankles.shape[:2])
        for row in range(len(ankles)):
            ankles[row], feet[row], rise[row] = self._next(hips[row], ankles[row], feet[row], leg_m)
            bears[row] = self._bears
        return ankles, feet, rise, bears

    def _next(
        self, hips: np.ndarray, ankles: np.ndarray, feet: np.ndarray, leg_m: float
    ) -> tuple[np.ndarray, np.ndarray, float]:
        ratio = self._height / DEFAULT_HEIGHT_M
        centre = sole_positions(ankles, feet, self._height).mean(axis=-2)
        first = self._centre is None
        moved = np.zeros((2, 3)) if self._centre is None else centre - self._centre
        speed = np.linalg.norm(moved, axis=-1) * FPS
        self._centre = centre
        feet = rot.quat_multiply(feet, self._soles.turn)
        floor = self._soles.level_m + ankles[:, :2] @ self._soles.slope
        away = lowest_point(ankles, feet, self._height) - floor
        stands = (speed < STILL_M_S) & (np.abs(away) < ON_FLOOR_M * ratio)
        if first:  # whether they move is not known yet
            stands &= away <= away.min()
        low = low_ankles(self._soles, ankles, ratio)
        feet = self._flattened(feet, stands, low, 1.0 if first else FOOT_SHARE)
        away = lowest_point(ankles, feet, self._height) - floor
        if not stands.any():
            left_over = away + self._rise
            lower = left_over <= left_over.min()
            stands = (speed < SLOW_M_S) & (left_over < TOUCH_M * ratio) & lower
            near = not stands.any() and left_over.min() < ON_FLOOR_M * ratio
            self._glided = self._glided + 1 if near else 0
            if self._glided >= LONGEST_GLIDE_S * FPS:
                stands = lower
        else:
            self._glided = 0
        self._bears = self._bears + (1.0 if first else FOOT_SHARE) * (stands - self._bears)
        lacking = np.where(stands, -away - self._rise, 0.0)
        self._rise = self._rise + (lacking if first else FOOT_SHARE * lacking)
        if stands.any():
            wanted = float((self._rise - floor)[stands].mean())
            self._root += (1.0 if first else ROOT_SHARE) * (wanted - self._root)
        ankles = ankles + np.stack([np.zeros(2), np.zeros(2), self._rise - floor], axis=-1)
        raised = hips + np.array([0.0, 0.0, self._root])
        lacks = float(lacking_reach(raised, ankles, stands, leg_m))
        self._sunk += (FOOT_SHARE if lacks > self._sunk else RELEASE_SHARE) * (lacks - self._sunk)
        return ankles, feet, self._root - self._sunk

    def _flattened(
        self, feet: np.ndarray, stands: np.ndarray, low: np.ndarray, share: float
    ) -> np.ndarray:
        yaw, pitch, roll = lean(feet)
        wanted = np.stack(flat_turn(pitch, roll, stands, low), axis=-1)
        self._turned = self._turned + share * (wanted - self._turned)
        return from_lean(yaw, pitch - self._turned[:, 0], roll - self._turned[:, 1])
