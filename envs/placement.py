"""Places of the episodes' clips on the ground."""

from __future__ import annotations

from typing import Any

import numpy as np

from envs.episode_random import EpisodeRandom, Seeds
from envs.reference import Reference
from envs.terrain import COURSE, MARGIN_M, Terrain, height_field, tile_centre
from questsim import rotations as rot
from questsim.errors import InputError
from questsim.heightfield import HeightField

_ANGLES = {"up": 0.0, "down": np.pi, "across": 0.5 * np.pi}
_LEAST_TRAVEL_M = 0.5
"""Clips that travel less than this from start to end are turned by their heading instead."""


class Placement:
    """Places of a batch's clips on a terrain; at the origin, unturned, without one.

    Args:
        reference: the clips.
        terrain: the ground; None for a plane.
        ratio: ``(n,)`` height of each simulation's body over 1.75 m.
        seed: seed of the places.
        fixed: a clip always has the same place, whatever the batch.

    Attributes:
        place: ``(n, 4)`` x and y of the clip's origin in metres, cosine and sine of its turn.
        tile: ``(n, 2)`` column and level of the course's tile, zero elsewhere.
        field: the ground; None for a plane.

    Raises:
        InputError: a clip's path does not fit on the ground.
    """

    def __init__(
        self,
        reference: Reference,
        terrain: Terrain | None,
        ratio: np.ndarray,
        seed: int,
        fixed: bool,
    ) -> None:
        self._terrain, self._ratio = terrain, ratio
        # A stream of its own: a terrain does not change which clips are drawn.
        self._random = EpisodeRandom(reference.names, len(ratio), seed, 1, fixed)
        self.place = np.zeros((len(ratio), 4))
        self.place[:, 2] = 1.0
        self.tile = np.zeros((len(ratio), 2), np.int64)
        self.field: HeightField | None = None
        if terrain is None:
            return
        self.field = height_field(terrain)
        paths = [_path(reference, i) for i in range(len(reference.names))]
        self._middle = np.array([middle for middle, _, _ in paths])
        self._radius = np.array([radius for _, radius, _ in paths])
        self._travel = np.array([travel for _, _, travel in paths])
        reach = 0.5 * min(self.field.size) - MARGIN_M - self._radius * ratio.max()
        if reach.min() < 0.0:
            raise InputError(
                f"its path is {2 * self._radius[reach.argmin()]:.1f} m wide, but the ground only "
                f"{min(self.field.size):g} m",
                reference.names[int(reach.argmin())],
                "leave it out or make the terrain larger (size_m, tile_m)",
            )

    def seed(self, seeds: Seeds) -> None:
        """Seed the random streams of places."""
        self._random.seed(seeds)

    def draw(self, ids: np.ndarray, clips: np.ndarray) -> None:
        """Draw places for simulations ``ids``, which begin to play ``clips``."""
        terrain, field = self._terrain, self.field
        if terrain is None or field is None:
            self.place[ids] = 0.0, 0.0, 1.0, 0.0
            return
        numbers = self._random.draw(ids, clips, 5)
        if terrain.direction == "any":
            turn = 2.0 * np.pi * numbers[:, 0]
        else:
            turn = _ANGLES[terrain.direction] - self._travel[clips]
        cos, sin = np.cos(turn), np.sin(turn)
        ratio = self._ratio[ids]
        room = 0.5 * np.array(field.size) - MARGIN_M - (self._radius[clips] * ratio)[:, None]
        if terrain.kind == COURSE:
            self.tile[ids] = _tiles(terrain, numbers[:, 1:3])
            middle = tile_centre(terrain, self.tile[ids, 0], self.tile[ids, 1])
            spread = terrain.spread_m
            middle = np.clip(middle + 2.0 * spread * numbers[:, 3:5] - spread, -room, room)
        else:
            middle = (2.0 * numbers[:, 3:5] - 1.0) * room
        offset = self._middle[clips] * ratio[:, None]
        self.place[ids, 0] = middle[:, 0] - (cos * offset[:, 0] - sin * offset[:, 1])
        self.place[ids, 1] = middle[:, 1] - (sin * offset[:, 0] + cos * offset[:, 1])
        self.place[ids, 2], self.place[ids, 3] = cos, sin

    def get_state(self) -> dict[str, Any]:
        """Random numbers and places, to resume from."""
        return {
            "rng": self._random.get_state(),
            "place": self.place.copy(),
            "tile": self.tile.copy(),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore the result of ``get_state``."""
        self._random.set_state(state["rng"])
        self.place[:], self.tile[:] = state["place"], state["tile"]


def _tiles(terrain: Terrain, numbers: np.ndarray) -> np.ndarray:
    """Column and level ``(m, 2)`` of a course for numbers ``(m, 2)`` in [0, 1)."""
    shape = np.array([len(terrain.tiles), terrain.levels])
    share, numbers = terrain.flat_share, numbers.copy()
    flat = numbers[:, 0] < share
    if share > 0.0:
        # The rest of [0, 1) is spread evenly over the columns of tiles.
        numbers[:, 0] = np.maximum(numbers[:, 0] - share, 0.0) / max(1.0 - share, 1e-9)
    tiles = np.minimum((numbers * shape).astype(np.int64), shape - 1)
    tiles[:, 0] = np.where(flat, 0, tiles[:, 0] + len(terrain.columns) - len(terrain.tiles))
    return tiles


def _path(reference: Reference, clip: int) -> tuple[np.ndarray, float, float]:
    """Centre and radius of a circle around a clip's path, and the angle of its travel."""
    rows = slice(int(reference.start[clip]), int(reference.end[clip]))
    roots = reference.qpos[rows, :2].astype(float)
    middle = 0.5 * (roots.min(axis=0) + roots.max(axis=0))
    radius = float(np.linalg.norm(roots - middle, axis=-1).max())
    travel = roots[-1] - roots[0]
    if np.linalg.norm(travel) < _LEAST_TRAVEL_M:
        return middle, radius, float(rot.heading(reference.qpos[rows.start, 3:7].astype(float)))
    return middle, radius, float(np.arctan2(travel[1], travel[0]))


def turned(place: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Turn vectors ``(m, ..., 3)`` of clips into the world, at places ``(m, 4)``."""
    shape = (len(place), *[1] * (vectors.ndim - 2))
    cos, sin = place[:, 2].reshape(shape), place[:, 3].reshape(shape)
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)


def moved(place: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Move points ``(m, ..., 3)`` of clips into the world; they are not lifted yet."""
    out = turned(place, points)
    out[..., 0] += place[:, 0].reshape((len(place), *[1] * (points.ndim - 2)))
    out[..., 1] += place[:, 1].reshape((len(place), *[1] * (points.ndim - 2)))
    return out


def turn_quat(place: np.ndarray) -> np.ndarray:
    """The turns of places ``(m, 4)`` as quaternions ``(m, 4)``, wxyz."""
    return rot.yaw_quat(np.arctan2(place[:, 3], place[:, 2]))
