"""Height fields on a square grid: lookups, and geoms of MuJoCo models."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

STANCE_M = 0.25
"""Width of the Gaussian that averages the ground under a user: half a stride."""
_BASE_M = 0.5
_LEAST_RELIEF_M = 1e-3
"""MuJoCo divides heights by their range."""


@dataclass(frozen=True, eq=False)
class HeightField:
    """Heights above the user's own floor, ``[row, column]`` along y and x.

    Between grid points the surface is MuJoCo's: two triangles per cell. Beyond the edge, lookups
    return the height of the edge, but nothing collides there.

    Attributes:
        height: ``(rows, columns)`` height of the surface in metres.
        ground: ``(rows, columns)`` height of the floor under a user at this point: the surface
            averaged over a stance, without gaps.
        cell_m: spacing of the grid.
        origin: x and y of ``height[0, 0]`` in metres.
    """

    height: np.ndarray
    ground: np.ndarray
    cell_m: float
    origin: tuple[float, float]

    @staticmethod
    def of(
        height: np.ndarray,
        cell_m: float,
        carved: np.ndarray | None = None,
        origin: tuple[float, float] | None = None,
    ) -> HeightField:
        """Make a field and compute its ground.

        Args:
            height: ``(rows, columns)`` metres, at least two of each.
            cell_m: spacing of the grid.
            carved: heights of the surface with gaps cut in, if it has any; ``height`` is then only
                used to average the ground.
            origin: x and y of ``height[0, 0]``; by default the centre is at x = y = 0.
        """
        from scipy.ndimage import gaussian_filter  # late: a plane needs none

        rows, columns = height.shape
        middle = (-0.5 * cell_m * (columns - 1), -0.5 * cell_m * (rows - 1))
        surface = height if carved is None else carved
        return HeightField(
            height=surface.astype(np.float32).astype(float),
            ground=gaussian_filter(height.astype(float), STANCE_M / cell_m, mode="nearest"),
            cell_m=cell_m,
            origin=middle if origin is None else origin,
        )

    @property
    def size(self) -> tuple[float, float]:
        """Extent along x and y in metres."""
        rows, columns = self.height.shape
        return (columns - 1) * self.cell_m, (rows - 1) * self.cell_m

    @property
    def centre(self) -> tuple[float, float]:
        """Its middle, x and y in metres."""
        return self.origin[0] + 0.5 * self.size[0], self.origin[1] + 0.5 * self.size[1]

    def around(self, points: np.ndarray, margin_m: float) -> HeightField:
        """The part of the field within ``margin_m`` of the box around points ``(..., 2 or 3)``."""
        xy = points[..., :2].reshape(-1, 2)
        low = (xy.min(axis=0) - margin_m - self.origin) / self.cell_m
        high = (xy.max(axis=0) + margin_m - self.origin) / self.cell_m
        most = np.array(self.height.shape[::-1]) - 1
        first = np.clip(np.floor(low).astype(int), 0, most - 1)
        last = np.clip(np.ceil(high).astype(int), first + 1, most)
        part = (slice(first[1], last[1] + 1), slice(first[0], last[0] + 1))
        x, y = self.origin + self.cell_m * first
        return HeightField(self.height[part], self.ground[part], self.cell_m, (float(x), float(y)))

    def height_at(self, points: np.ndarray) -> np.ndarray:
        """Height of the surface ``(...)`` at points ``(..., 2 or 3)``, exactly as it collides."""
        row, column, u, v = self._cell(points)
        low, right = self.height[row, column], self.height[row, column + 1]
        up, far = self.height[row + 1, column], self.height[row + 1, column + 1]
        # MuJoCo cuts each cell from its lowest to its highest row and column.
        return np.where(
            u >= v,
            low + u * (right - low) + v * (far - right),
            low + v * (up - low) + u * (far - up),
        )

    def ground_at(self, points: np.ndarray) -> np.ndarray:
        """Height of the ground ``(...)`` at points ``(..., 2 or 3)``; bilinear."""
        row, column, u, v = self._cell(points)
        ground = self.ground
        near = ground[row, column] * (1.0 - u) + ground[row, column + 1] * u
        far = ground[row + 1, column] * (1.0 - u) + ground[row + 1, column + 1] * u
        return near * (1.0 - v) + far * v

    def _cell(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Row, column and the position within the cell, 0 to 1 along x and y."""
        rows, columns = self.height.shape
        x = np.clip((points[..., 0] - self.origin[0]) / self.cell_m, 0.0, columns - 1.0)
        y = np.clip((points[..., 1] - self.origin[1]) / self.cell_m, 0.0, rows - 1.0)
        column = np.minimum(x.astype(np.int64), columns - 2)
        row = np.minimum(y.astype(np.int64), rows - 2)
        return row, column, x - column, y - row

    def replace_floor(self, spec: mujoco.MjSpec) -> None:
        """Replace the plane ``floor`` of a spec by this field."""
        low = float(self.height.min())
        relief = max(float(self.height.max()) - low, _LEAST_RELIEF_M)
        rows, columns = self.height.shape
        spec.add_hfield(
            name="terrain",
            nrow=rows,
            ncol=columns,
            size=[0.5 * self.size[0], 0.5 * self.size[1], relief, _BASE_M],
            userdata=((self.height - low) / relief).ravel(),
        )
        floor = spec.geom("floor")
        floor.type = mujoco.mjtGeom.mjGEOM_HFIELD
        floor.hfieldname = "terrain"
        floor.pos = [*self.centre, low]
