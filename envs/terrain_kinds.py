"""Shapes of ground: pure functions from positions to heights.

Each takes the terrain's options, grids ``x`` and ``y`` in metres and random numbers, and
returns heights in metres of the same shape, zero on average or at their edge.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

FLIGHT = 5
"""Steps of a flight of stairs, up or down."""
LANDING_M = 1.2
_BLOCK_M = 0.8
_PLATFORM_M = 0.8


class Sizes(Protocol):
    """The options of ``envs.terrain.Terrain`` that the shapes of this module read."""

    @property
    def amplitude_m(self) -> float:
        """Rough ground and waves lie within ± this height."""
        ...

    @property
    def wavelength_m(self) -> float:
        """Wavelength of rough ground and waves."""
        ...

    @property
    def slope_deg(self) -> float:
        """Steepness of a slope."""
        ...

    @property
    def step_height_m(self) -> float:
        """Height of stairs and steps."""
        ...

    @property
    def step_depth_m(self) -> float:
        """Depth of stairs."""
        ...

    @property
    def gap_m(self) -> float:
        """Width of gaps."""
        ...

    @property
    def gap_depth_m(self) -> float:
        """Depth of gaps."""
        ...


def flat(terrain: Sizes, x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Nothing but floor."""
    return np.zeros_like(x)


def rough(terrain: Sizes, x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Uniform random heights within ± amplitude every half wavelength, linearly interpolated."""
    spacing = 0.5 * terrain.wavelength_m
    return terrain.amplitude_m * _lattice(x, y, spacing, 1, rng)


def waves(terrain: Sizes, x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Hills and hollows like an egg box, of ± amplitude and one wavelength along x and along y."""
    turn = 2.0 * np.pi / terrain.wavelength_m
    shift = rng.uniform(0.0, 2.0 * np.pi, 2)
    return 0.5 * terrain.amplitude_m * (np.sin(turn * x + shift[0]) + np.sin(turn * y + shift[1]))


def slope(terrain: Sizes, x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """One plane that rises along x."""
    return np.tan(np.deg2rad(terrain.slope_deg)) * x


def stairs(terrain: Sizes, x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Flights of steps along x, up, a landing, down, a landing, and so on."""
    flight = FLIGHT * terrain.step_depth_m
    along = np.mod(x, 2.0 * (flight + LANDING_M))
    # The first riser of a flight is at its beginning.
    risen = np.clip(np.floor(along / terrain.step_depth_m + 1e-9) + 1.0, 0.0, FLIGHT)
    back = along - flight - LANDING_M
    gone = np.clip(np.floor(back / terrain.step_depth_m + 1e-9) + 1.0, 0.0, FLIGHT)
    return terrain.step_height_m * (risen - gone)


def steps(terrain: Sizes, x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Square blocks, each at one of three heights: a step down, level, a step up."""
    column = np.floor((x - x.min()) / _BLOCK_M + 1e-9).astype(int)
    row = np.floor((y - y.min()) / _BLOCK_M + 1e-9).astype(int)
    level = rng.integers(-1, 2, (row.max() + 1, column.max() + 1))
    return terrain.step_height_m * level[row, column]


def gaps(terrain: Sizes, x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Depth below the floor of ditches across x, with platforms between them to step on."""
    along = np.mod(x, _PLATFORM_M + terrain.gap_m)
    return np.where(along < terrain.gap_m - 1e-9, -terrain.gap_depth_m, 0.0)


BuiltIn = Callable[[Sizes, np.ndarray, np.ndarray, np.random.Generator], np.ndarray]

BUILT_IN: dict[str, BuiltIn] = {
    "flat": flat,
    "rough": rough,
    "waves": waves,
    "slope": slope,
    "stairs": stairs,
    "steps": steps,
    "gaps": gaps,
}


def _lattice(
    x: np.ndarray, y: np.ndarray, spacing: float, order: int, rng: np.random.Generator
) -> np.ndarray:
    """Uniform random numbers in [-1, 1] on a square lattice, interpolated."""
    from scipy.ndimage import map_coordinates  # late: a plane needs none

    column, row = (x - x.min()) / spacing, (y - y.min()) / spacing
    shape = (int(np.ceil(row.max())) + 2, int(np.ceil(column.max())) + 2)
    values = rng.uniform(-1.0, 1.0, shape)
    return map_coordinates(values, [row, column], order=order, mode="nearest")
