"""The avatar's body in a world: MuJoCo models that a batch steps."""

from __future__ import annotations

from functools import lru_cache

from envs.terrain import Terrain, height_field
from questsim.body import Body, body_of, build_body, scaled_spec


def build_world(
    height_m: float,
    preset: str = "default",
    self_collision: bool = False,
    terrain: Terrain | None = None,
) -> Body:
    """The avatar of a person ``height_m`` tall on the ground; cached, do not write to the model.

    Args:
        height_m, preset, self_collision: as of ``questsim.body.build_body``.
        terrain: the ground; None for a plane.

    Raises:
        InputError: height out of range or unknown preset.
    """
    flat = build_body(height_m, preset, self_collision)
    if terrain is None:
        return flat
    return _build(flat.height_m, preset, self_collision, terrain)


@lru_cache(maxsize=128)
def _build(height_m: float, preset: str, self_collision: bool, terrain: Terrain) -> Body:
    spec = scaled_spec(height_m, preset)
    height_field(terrain).replace_floor(spec)
    return body_of(spec, height_m, preset, self_collision)
