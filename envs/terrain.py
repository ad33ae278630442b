"""Terrain: options, names, and the seeded generator of height fields."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np

from envs.registration import ENVIRONMENTS, register_id, terrain_id
from envs.terrain_kinds import BUILT_IN
from questsim.errors import InputError, value_text
from questsim.extensions import load_extensions, same_source
from questsim.heightfield import HeightField

Shape = Callable[["Terrain", np.ndarray, np.ndarray, np.random.Generator], np.ndarray]

SHAPES: dict[str, Shape] = dict(BUILT_IN)
"""The shape of each kind but a course: those of ``terrain_kinds`` and registered ones."""
COURSE = "course"
DIRECTIONS = ("any", "up", "down", "across")
MARGIN_M = 1.5
"""Least distance of clips from the edge."""
_FINE_M, _SLOPE_CELL_M, _COURSE_CELL_M = 0.1, 1.0, 0.25
_SEAM_M = 1.0
"""Width of the edge over which a course's tile sinks to the floor."""

RANGES: dict[str, tuple[float, float]] = {
    "amplitude_m": (0.0, 0.5),
    "wavelength_m": (0.2, 20.0),
    "slope_deg": (0.0, 30.0),
    "step_height_m": (0.0, 0.3),
    "step_depth_m": (0.2, 2.0),
    "gap_m": (0.1, 0.6),
    "gap_depth_m": (0.05, 1.0),
    "difficulty": (0.0, 1.0),
    "levels": (1, 10),
    "tile_m": (4.0, 40.0),
    "spread_m": (0.0, 20.0),
    "flat_share": (0.0, 1.0),
    "size_m": (8.0, 200.0),
    "seed": (0, 2**32 - 1),
}
"""Least and greatest value of each option that is a number."""


@dataclass(frozen=True)
class Terrain:
    """Options of the ground; ``None`` in place of a terrain means a plane.

    Attributes:
        kind: ``"flat"``, ``"rough"``, ``"waves"``, ``"slope"``, ``"stairs"``
            (flights up and down along x), ``"steps"`` (blocks a step apart), ``"gaps"`` (ditches
            across x), or ``"course"``: tiles of several kinds, one column each, harder from row
            to row.
        amplitude_m: rough ground and waves lie within ± this height.
        wavelength_m: wavelength of rough ground and waves.
        slope_deg: steepness.
        step_height_m, step_depth_m: size of stairs; steps use the height only.
        gap_m, gap_depth_m: width and depth of gaps.
        direction: travel of clips: ``"up"`` along x (over stairs and gaps), ``"down"`` against it,
            ``"across"`` along y, or ``"any"``, drawn for each episode.
        difficulty: factor on amplitude, steepness, step height and gap width.
        tiles: kinds of a course's columns, optionally with options: ``"rough:amplitude_m=0.08"``.
        levels: rows of a course; row ``i`` has ``(i + 1) / levels`` of the difficulty.
        tile_m: edge length of a course's tiles.
        spread_m: greatest distance of a clip from the centre of its tile, along x and along y.
        flat_share: share of episodes on level floor beside the course's tiles.
        size_m: edge length of the ground; not used by a course.
        seed: random seed; same seed, same bits.

    Raises:
        InputError: an unknown kind or direction, or a number out of its range.
    """

    kind: str = "rough"
    amplitude_m: float = 0.04
    wavelength_m: float = 0.5
    slope_deg: float = 8.0
    step_height_m: float = 0.08
    step_depth_m: float = 0.4
    gap_m: float = 0.2
    gap_depth_m: float = 0.3
    direction: str = "any"
    difficulty: float = 1.0
    tiles: tuple[str, ...] = ("rough", "waves", "slope", "stairs", "steps", "gaps")
    levels: int = 4
    tile_m: float = 8.0
    spread_m: float = 1.0
    flat_share: float = 0.0
    size_m: float = 48.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not isinstance(self.tiles, tuple) or not all(isinstance(t, str) for t in self.tiles):
            what = f"tiles is {value_text(self.tiles)}; it takes a tuple of names"
            raise InputError(what, "terrain")
        _find_shapes(self.kind, *(tile.partition(":")[0] for tile in self.tiles))
        for what, value, known in (
            ("kind", self.kind, (*SHAPES, COURSE)),
            ("direction", self.direction, DIRECTIONS),
            *(("tile", tile.partition(":")[0], tuple(SHAPES)) for tile in self.tiles),
        ):
            if value not in known:
                raise InputError(
                    f"unknown {what} {value!r}", "terrain", f"choose from {', '.join(known)}"
                )
        if not self.tiles:
            raise InputError("the course has no tiles", "terrain")
        for name, (least, most) in RANGES.items():
            value = getattr(self, name)
            if not isinstance(value, (int, float)) or not least <= value <= most:
                raise InputError(f"{name} is {value!r}, not {least:g} to {most:g}", "terrain")
        for name in ("levels", "seed"):
            if getattr(self, name) != int(getattr(self, name)):
                raise InputError(
                    f"{name} is {getattr(self, name)!r}, not a whole number", "terrain"
                )
        for tile in self.tiles:
            if ":" in tile:
                terrain_named(tile, "tile")

    @property
    def scaled(self) -> Terrain:
        """The same terrain at difficulty 1, with amplitude, steepness, steps and gaps scaled."""
        by = self.difficulty
        return replace(
            self,
            amplitude_m=by * self.amplitude_m,
            slope_deg=by * self.slope_deg,
            step_height_m=by * self.step_height_m,
            gap_m=max(by * self.gap_m, RANGES["gap_m"][0]),
            difficulty=1.0,
        )

    @property
    def cell_m(self) -> float:
        """Spacing of the grid: as coarse as the shape allows, because small cells are slow."""
        if self.kind == COURSE:
            finest = min(_COURSE_CELL_M, *(terrain_named(tile).cell_m for tile in self.tiles))
            return self.tile_m / round(self.tile_m / finest)
        if self.kind == "slope":
            return _SLOPE_CELL_M
        if self.kind == "rough":
            return 0.5 * self.wavelength_m
        if self.kind in ("waves", "flat"):
            return max(_FINE_M, self.wavelength_m / 8.0)
        return _FINE_M

    @property
    def columns(self) -> tuple[str, ...]:
        """Kinds of a course's columns along x; with ``flat_share`` level columns come first.

        There are two level columns, so that a clip in the first stays away from the tiles.
        """
        return ("flat", "flat", *self.tiles) if self.flat_share > 0.0 else self.tiles


def _find_shapes(*kinds: str) -> None:
    """Import the extensions if a kind is unknown."""
    if not {*kinds} <= {*SHAPES, COURSE}:
        load_extensions()


TERRAINS: dict[str, Terrain] = {
    **{kind: Terrain(kind) for kind in SHAPES},
    "waves": Terrain("waves", amplitude_m=0.1, wavelength_m=2.0),
    "stairs": Terrain("stairs", direction="up"),
    "steps": Terrain("steps", step_height_m=0.06),
    "gaps": Terrain("gaps", direction="up"),
    "course": Terrain("course"),
}
"""Terrains by name: what ``QuestSimRough-v0`` and ``train.py --env rough`` use."""


_COMMON = ("direction", "difficulty", "size_m", "seed")
_READS: dict[str, tuple[str, ...]] = {
    "flat": ("size_m",),
    "rough": ("amplitude_m", "wavelength_m", *_COMMON),
    "waves": ("amplitude_m", "wavelength_m", *_COMMON),
    "slope": ("slope_deg", *_COMMON),
    "stairs": ("step_height_m", "step_depth_m", *_COMMON),
    "steps": ("step_height_m", *_COMMON),
    "gaps": ("gap_m", "gap_depth_m", *_COMMON),
    COURSE: ("direction", "difficulty", "levels", "tile_m", "spread_m", "flat_share", "seed"),
}
"""Options that each kind reads; a registered kind may read all."""


def terrain_named(text: str, where: str = "terrain") -> Terrain:
    """Parse a terrain: a name, optionally followed by options.

    Args:
        text: e.g. ``"rough"`` or ``"rough:amplitude_m=0.08,seed=3"``.
        where: source of the text, for error messages.

    Raises:
        InputError: an unknown terrain or option, an option that the terrain does not read, or a
            value out of range.
    """
    name, _, options = text.partition(":")
    if name not in TERRAINS:
        load_extensions()
    if name not in TERRAINS:
        raise InputError(f"unknown terrain {name!r}", where, f"choose from {', '.join(TERRAINS)}")
    known = {field.name: type(getattr(TERRAINS[name], field.name)) for field in fields(Terrain)}
    changes = {}
    for option in filter(None, options.split(",")):
        key, equals, value = option.partition("=")
        if not equals or key not in known or key in ("kind", "tiles"):
            settable = ", ".join(k for k in known if k not in ("kind", "tiles"))
            raise InputError(
                f"{option!r} is not an option of a terrain", where, f"it has {settable}"
            )
        reads = _READS.get(TERRAINS[name].kind, tuple(known))
        if key not in reads:
            what = f"{option!r} has no effect on the terrain {name}"
            raise InputError(what, where, f"it reads {', '.join(reads)}")
        try:
            changes[key] = known[key](value)
        except ValueError as error:
            raise InputError(
                f"{value!r} is not of type {known[key].__name__}", f"{where} {key}"
            ) from error
    return replace(TERRAINS[name], **changes)


# Defined after parsing, because its tiles are terrains with options.
TERRAINS["mixed"] = Terrain(
    COURSE,
    tiles=("rough:amplitude_m=0.08", "rough:amplitude_m=0.08", "slope:slope_deg=8"),
    tile_m=16.0,
    spread_m=7.0,
    flat_share=0.4,
)


def register_terrain(kind: str, shape: Shape, **options: Any) -> None:
    """Add a kind of ground, e.g. from a module that ``QUESTSIM_EXTENSIONS`` names.

    It gets an id of gymnasium as well, see ``envs.registration.terrain_id``.

    Args:
        kind: its name on command lines.
        shape: function of ``(terrain, x, y, rng)`` that returns heights in metres; see
            ``terrain_kinds``.
        **options: default values of ``Terrain`` fields.

    Raises:
        InputError: the name is taken or has a comma or colon, or an option is invalid.
    """
    if kind in TERRAINS and not (kind in SHAPES and same_source(SHAPES[kind], shape)):
        raise InputError(f"there is a terrain {kind!r} already", "register_terrain", "rename it")
    if not kind.isidentifier():
        raise InputError(f"{kind!r} is not a valid name of a terrain", "register_terrain")
    name, given = terrain_id(kind), {"terrain": kind}
    if ENVIRONMENTS.get(name, given) != given:
        raise InputError(f"there is an id {name} already", "register_terrain", "rename it")
    SHAPES[kind] = shape
    TERRAINS[kind] = Terrain(kind, **options)
    register_id(name, given)
    height_field.cache_clear()


@lru_cache(maxsize=32)
def height_field(terrain: Terrain) -> HeightField:
    """The height field of a terrain; cached, do not write to it."""
    if terrain.kind == COURSE:
        return _course(terrain)
    cell = terrain.cell_m
    points = int(np.ceil(terrain.size_m / cell)) + 1
    half = 0.5 * cell * (points - 1)
    x, y = np.meshgrid(np.linspace(-half, half, points), np.linspace(-half, half, points))
    height, carved = _shape(terrain.scaled, x, y, np.random.default_rng(terrain.seed))
    return HeightField.of(height, cell, carved)


def _shape(
    terrain: Terrain, x: np.ndarray, y: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray | None]:
    """Heights, and the heights with gaps cut in, if there are any."""
    _find_shapes(terrain.kind)  # a terrain that comes from another process
    height = SHAPES[terrain.kind](terrain, x, y, rng)
    return (np.zeros_like(height), height) if terrain.kind == "gaps" else (height, None)


def tile_centre(terrain: Terrain, column: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Centres of a course's tiles ``(..., 2)`` in metres."""
    across = (len(terrain.columns) - 1) / 2.0
    along = (terrain.levels - 1) / 2.0
    return terrain.tile_m * np.stack([column - across, level - along], axis=-1)


def _course(terrain: Terrain) -> HeightField:
    """Tiles of every kind and level, surrounded by floor; tiles meet at floor height."""
    cell, tile = terrain.cell_m, terrain.tile_m
    inner = np.linspace(-0.5 * tile, 0.5 * tile, round(tile / cell) + 1)
    x, y = np.meshgrid(inner, inner)
    rim = np.clip((0.5 * tile - np.maximum(abs(x), abs(y))) / _SEAM_M, 0.0, 1.0)
    shape = (terrain.levels, len(terrain.columns))
    steps = len(inner) - 1
    border = round(tile / cell)
    grid = np.zeros([count * steps + 1 + 2 * border for count in shape])
    carved = grid.copy()
    for level in range(shape[0]):
        for column, kind in enumerate(terrain.columns):
            rng = np.random.default_rng([terrain.seed, level, column])
            difficulty = terrain.difficulty * (level + 1) / terrain.levels
            height, cut = _tile(kind, difficulty, x, y, rim, rng)
            rows = slice(border + level * steps, border + (level + 1) * steps + 1)
            columns = slice(border + column * steps, border + (column + 1) * steps + 1)
            grid[rows, columns] = height
            carved[rows, columns] = cut
    return HeightField.of(grid, cell, carved)


def _tile(
    kind: str,
    difficulty: float,
    x: np.ndarray,
    y: np.ndarray,
    rim: np.ndarray,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Heights of a tile with and without gaps, zero at its edge."""
    terrain = terrain_named(kind)
    terrain = replace(terrain, difficulty=terrain.difficulty * difficulty).scaled
    if terrain.kind in ("slope", "stairs"):
        # The slope rises from the edge to the middle, from both sides.
        inward = 0.5 * (x.max() - x.min()) - np.maximum(abs(x), abs(y)) - _SEAM_M
        most = 0.5 * (x.max() - x.min()) - _SEAM_M - 1.0
        inward = np.clip(inward, 0.0, most)
        if terrain.kind == "stairs":
            rise = np.floor(inward / terrain.step_depth_m + 1e-9) * terrain.step_height_m
        else:
            rise = np.tan(np.deg2rad(terrain.slope_deg)) * inward
        return rise, rise
    height, carved = _shape(terrain, x, y, rng)
    return height * rim, (height if carved is None else carved) * rim
