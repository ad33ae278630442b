"""The lowest points of a body's feet, whatever shapes they are made of."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from questsim import rotations as rot
from questsim.heightfield import HeightField

_GEOM = mujoco.mjtGeom
_AROUND = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)


@dataclass(frozen=True)
class Support:
    """Balls whose lowest points are those of the feet; a corner is a ball of radius zero.

    Attributes:
        foot: ``(K,)`` 0 for the left foot and what hangs on it, 1 for the right.
        link: ``(K,)`` the link that carries the ball.
        point: ``(K, 3)`` its centre in the link's frame, metres.
        radius: ``(K,)`` metres.
    """

    foot: np.ndarray
    link: np.ndarray
    point: np.ndarray
    radius: np.ndarray

    def bottoms(self, position: np.ndarray, quat: np.ndarray, scale: float = 1.0) -> np.ndarray:
        """Lowest points ``(..., K, 3)`` of links at ``(..., L, 3)`` turned by ``(..., L, 4)``.

        ``scale``: size of the body over that of its MJCF.
        """
        turn = np.asarray(quat, float)[..., self.link, :]
        offset = rot.quat_rotate(turn, scale * self.point)
        points = np.asarray(position, float)[..., self.link, :] + offset
        points[..., 2] -= scale * self.radius
        return points

    def lowest(
        self,
        position: np.ndarray,
        quat: np.ndarray,
        field: HeightField | None = None,
        scale: float = 1.0,
    ) -> np.ndarray:
        """Height in metres ``(..., 2)`` of each foot's lowest point above the ground.

        Args:
            position, quat, scale: as of ``bottoms``.
            field: the ground; None for a plane at zero.
        """
        points = self.bottoms(position, quat, scale)
        height = points[..., 2] - (0.0 if field is None else field.height_at(points))
        return np.stack([height[..., self.foot == foot].min(axis=-1) for foot in (0, 1)], axis=-1)


def support_of(model: mujoco.MjModel, feet: tuple[int, ...]) -> Support:
    """The support of a model's feet, whose links are ``feet`` (left, right).

    Feet without colliding geoms are supported by their other geoms, or by their origins.
    """
    foot, link, point, radius = [], [], [], []
    for index, first in enumerate(feet):
        below = _below(model, first + 1)
        geoms = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in below]
        touching = [g for g in geoms if model.geom_contype[g]]
        balls = [ball for g in touching or geoms for ball in _balls(model, g)]
        for owner, centre, size in balls or [(first + 1, np.zeros(3), 0.0)]:
            foot.append(index)
            link.append(owner - 1)
            point.append(centre)
            radius.append(size)
    return Support(np.array(foot), np.array(link), np.array(point), np.array(radius))


def _below(model: mujoco.MjModel, body: int) -> set[int]:
    found = {body}
    for other in range(body + 1, model.nbody):  # parents come first
        if int(model.body_parentid[other]) in found:
            found.add(other)
    return found


def _balls(model: mujoco.MjModel, geom: int) -> list[tuple[int, np.ndarray, float]]:
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    if kind == int(_GEOM.mjGEOM_SPHERE):
        points, radius = np.zeros((1, 3)), float(size[0])
    elif kind == int(_GEOM.mjGEOM_CAPSULE):
        points, radius = np.array([[0, 0, -size[1]], [0, 0, size[1]]]), float(size[0])
    elif kind == int(_GEOM.mjGEOM_CYLINDER):
        ring = np.stack([size[0] * np.cos(_AROUND), size[0] * np.sin(_AROUND)], axis=-1)
        points = np.array([[x, y, z] for z in (-size[1], size[1]) for x, y in ring])
        radius = 0.0
    else:  # boxes exactly; ellipsoids and meshes by their bounding box
        middle, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        points, radius = middle + signs * half, 0.0
    turned = rot.quat_rotate(model.geom_quat[geom], points) + model.geom_pos[geom]
    return [(int(model.geom_bodyid[geom]), row, radius) for row in turned]
