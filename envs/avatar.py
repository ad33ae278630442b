"""The avatar of a task: our humanoid, or a body of the user's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from questsim import bodies
from questsim.body import DEFAULT_HEIGHT_M, build_body
from questsim.heightfield import HeightField
from questsim.motion.clip import Clip
from questsim.motion.kinematics import sole_positions
from questsim.skeleton import DOFS, FOOT_LINKS, LINKS

if TYPE_CHECKING:
    from questsim.bodies import BodyMap, OwnBody

_LEG_AND_TRUNK_JOINTS = ("hip", "knee", "ankle", "spine", "chest")


@dataclass(frozen=True)
class Avatar:
    """Names and numbers of a body; ``L`` links, ``D`` hinges.

    Attributes:
        links, dofs: names in the order of the physics.
        joint_range: ``(D, 2)`` rad.
        upright: ``(D,)`` rad of the pose upright, arms hanging.
        base_m: stature that reference lengths are of.
        strong: ``(D,)`` bool, hinges of legs and trunk.
        own: the map of a body of the user's own; None for our humanoid.
    """

    links: tuple[str, ...]
    dofs: tuple[str, ...]
    joint_range: np.ndarray
    upright: np.ndarray
    base_m: float
    strong: np.ndarray
    own: BodyMap | None = None

    def clips(self, clips: Sequence[Clip], body: OwnBody | None) -> list[Clip]:
        """Clips of our avatar as clips of this one, on the body of ``base_m``."""
        if body is not None:
            return bodies.clips_for(body, clips)
        return [clip.scaled(self.base_m) for clip in clips]

    def link(self, name: str) -> int:
        """Index of a link of this body, or of the link that is ours of that name."""
        if self.own is not None and name in LINKS and name not in self.links:
            return int(self.own.role_link[LINKS.index(name)])
        return self.links.index(name)

    def our_links(
        self, position: np.ndarray, quat: np.ndarray, height_m: np.ndarray | float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Poses ``(..., 16, 3 | 4)`` of the links of our avatar on this body.

        Args:
            position, quat: ``(..., L, 3)``, ``(..., L, 4)`` of the links.
            height_m: stature, or one for each row.
        """
        return (position, quat) if self.own is None else self.own.roles(position, quat, height_m)

    def soles(self, position: np.ndarray, quat: np.ndarray, height_m: float) -> np.ndarray:
        """Points ``(m, 2, k, 3)`` of the soles of our humanoid's links ``(m, 16, 3 | 4)``."""
        feet = list(FOOT_LINKS)
        return sole_positions(position[:, feet], quat[:, feet], height_m)

    def clearance(
        self,
        position: np.ndarray,
        quat: np.ndarray,
        heights: np.ndarray,
        field: HeightField | None,
    ) -> np.ndarray:
        """Height ``(m, 2)`` in metres of each foot's lowest sole point above the ground below it.

        Args:
            position, quat: ``(m, L, 3)``, ``(m, L, 4)`` of the links.
            heights: ``(m,)`` statures in metres.
            field: the ground; None for a plane.
        """
        clearance = np.empty((len(heights), 2))
        for height in np.unique(heights):
            these = heights == height
            links = position[these], quat[these]
            if self.own is not None:
                clearance[these] = self.own.support.lowest(*links, field, height / self.base_m)
                continue
            soles = self.soles(*links, float(height))
            above = soles[..., 2] - (0.0 if field is None else field.height_at(soles))
            clearance[these] = above.min(axis=-1)
        return clearance


def avatar_of(body: OwnBody | None) -> Avatar:
    """The avatar of a task with this body; None is our humanoid."""
    return _ours() if body is None else _own(body)


@lru_cache(maxsize=1)
def _ours() -> Avatar:
    strong = np.array([any(part in name for part in _LEG_AND_TRUNK_JOINTS) for name in DOFS])
    ranges = build_body().model.jnt_range[1 : 1 + len(DOFS)]
    return Avatar(LINKS, DOFS, ranges, np.zeros(len(DOFS)), DEFAULT_HEIGHT_M, strong)


@lru_cache(maxsize=16)
def _own(body: OwnBody) -> Avatar:
    own = bodies.map_of(body)
    return Avatar(
        own.links, own.dofs, own.joint_range, own.rest[7:], own.body.height_m, own.strong, own
    )
