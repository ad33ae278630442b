"""The body of a user of a kinematic system: measured bones, or a stature alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from questsim.body import MAX_HEIGHT_M, MIN_HEIGHT_M
from questsim.errors import InputError
from questsim.motion.checks import stature_of
from questsim.motion.kinematics import standing_clip
from questsim.motion.motion import Motion
from questsim.motion.retarget_back import to_motion
from questsim.skeleton import NUM_JOINTS

STATURE_TOLERANCE = 0.03
"""How far estimated bones may differ from a stature that is known, as a share of it."""


@dataclass(frozen=True)
class UserBody:
    """The user's body.

    Attributes:
        offsets: ``(22, 3)`` position of each joint in its parent's frame, as in ``Motion``.
        height_m: the user's stature, if it was measured. Systems that estimate the bones then
            scale their estimate to within ``STATURE_TOLERANCE`` of it.
    """

    offsets: np.ndarray
    height_m: float | None = None

    def __post_init__(self) -> None:
        offsets = np.asarray(self.offsets, float)
        if offsets.shape != (NUM_JOINTS, 3) or not np.isfinite(offsets).all():
            raise InputError(f"a body's offsets are not {NUM_JOINTS} x 3 finite numbers", "body")
        if not stature_of(offsets) > 0.5:
            raise InputError("a body is less than 0.5 m tall", "body", "give metres")

    @staticmethod
    def of(motion: Motion) -> UserBody:
        """The body of a recorded person."""
        return UserBody(motion.offsets)

    @staticmethod
    def of_height(height_m: float) -> UserBody:
        """The body of a person of whom only the stature is measured, with average proportions.

        Args:
            height_m: stature in metres, 1.2 to 2.2.

        Raises:
            InputError: outside that range.
        """
        if not MIN_HEIGHT_M <= height_m <= MAX_HEIGHT_M:
            limits = f"{MIN_HEIGHT_M} to {MAX_HEIGHT_M} m"
            raise InputError(f"a stature of {height_m:g} m is not within {limits}", "body")
        return UserBody(to_motion(standing_clip(height_m, 2)).offsets, height_m)

    def bounded(self, offsets: np.ndarray) -> np.ndarray:
        """Estimated bones ``(..., 22, 3)``, scaled so that their stature agrees with a known one.

        Every body is scaled as a whole. Without a known stature the bones stay as they are.
        """
        if self.height_m is None:
            return offsets
        flat = offsets.reshape(-1, NUM_JOINTS, 3)
        found = np.array([stature_of(one) for one in flat]) / self.height_m
        allowed = found.clip(1.0 - STATURE_TOLERANCE, 1.0 + STATURE_TOLERANCE)
        return (flat * (allowed / found)[:, None, None]).reshape(offsets.shape)
