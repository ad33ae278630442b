"""Objects beside an avatar as pictures and records know them: shapes, and where they were."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from questsim import rotations as rot

NEAR_M = 1.0
"""Pictures of somebody have room for an object that is no further than this from the pelvis."""
_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))


@dataclass(frozen=True)
class ObjectShape:
    """A shape of which an object is made.

    Attributes:
        shape: ``"ball"`` or ``"box"``.
        size: radius, or half of each edge, in metres.
        place: of its middle in the object's frame, metres.
    """

    shape: str
    size: tuple[float, ...]
    place: tuple[float, ...]


@dataclass(frozen=True)
class ObjectTrack:
    """An object while something happened.

    Attributes:
        parts: what it is made of.
        position: ``(F, 3)`` metres, in the world.
        quat: ``(F, 4)`` orientations, quaternions wxyz.
    """

    parts: tuple[ObjectShape, ...]
    position: np.ndarray
    quat: np.ndarray

    def corners(self) -> np.ndarray:
        """The corners ``(F, 8 parts, 3)`` of boxes around its parts, in the world."""
        own = [np.array(p.place) + _CORNERS * np.array(p.size) for p in self.parts]
        return self.position[:, None] + rot.quat_rotate(self.quat[:, None], np.concatenate(own))

    def corners_near(self, root: np.ndarray) -> np.ndarray:
        """Its corners in the frames in which it is near, in others the root itself.

        Args:
            root: ``(F, 3)`` where somebody's pelvis is.
        """
        near = np.linalg.norm((self.position - root)[:, :2], axis=-1) < NEAR_M
        return np.where(near[:, None, None], self.corners(), root[:, None])
