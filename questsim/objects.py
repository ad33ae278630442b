"""Objects of a scene for rendering and recording: shapes and poses."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from questsim import rotations as rot

NEAR_M = 1.0
"""Objects up to this distance from the pelvis are kept in the picture."""
_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))


@dataclass(frozen=True)
class ObjectShape:
    """One part of an object.

    Attributes:
        shape: ``"ball"`` or ``"box"``.
        size: radius, or half of each edge, in metres.
        place: its centre in the object's frame, metres.
    """

    shape: str
    size: tuple[float, ...]
    place: tuple[float, ...]


@dataclass(frozen=True)
class ObjectTrack:
    """An object over ``F`` frames.

    Attributes:
        parts: its shapes.
        position: ``(F, 3)`` metres, in the world.
        quat: ``(F, 4)`` orientations, quaternions wxyz.
    """

    parts: tuple[ObjectShape, ...]
    position: np.ndarray
    quat: np.ndarray

    def corners(self) -> np.ndarray:
        """Corners ``(F, 8 parts, 3)`` of boxes around its parts, in the world."""
        own = [np.array(p.place) + _CORNERS * np.array(p.size) for p in self.parts]
        return self.position[:, None] + rot.quat_rotate(self.quat[:, None], np.concatenate(own))

    def corners_near(self, root: np.ndarray) -> np.ndarray:
        """Its corners in frames in which it is near the root; in other frames the root.

        Args:
            root: ``(F, 3)`` position of the pelvis.
        """
        near = np.linalg.norm((self.position - root)[:, :2], axis=-1) < NEAR_M
        return np.where(near[:, None, None], self.corners(), root[:, None])
