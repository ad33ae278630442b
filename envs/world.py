"""The avatar's body in a world: MuJoCo models that a batch steps."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import mujoco

from envs.objects import WorldObject, add_objects
from envs.terrain import Terrain, height_field
from questsim.body import Body, build_body, scaled_spec


def build_world(
    height_m: float,
    preset: str = "default",
    self_collision: bool = False,
    terrain: Terrain | None = None,
    objects: tuple[WorldObject, ...] = (),
) -> Body:
    """The avatar of a person ``height_m`` tall on the ground; cached, do not write to the model.

    Args:
        height_m, preset, self_collision: as of ``questsim.body.build_body``.
        terrain: the ground; None for a plane.
        objects: things behind the avatar in ``qpos``, seven numbers each.

    Raises:
        InputError: height out of range or unknown preset.
    """
    flat = build_body(height_m, preset, self_collision)
    if terrain is None and not objects:
        return flat
    return _build(flat.height_m, preset, self_collision, terrain, objects)


@lru_cache(maxsize=128)
def _build(
    height_m: float,
    preset: str,
    self_collision: bool,
    terrain: Terrain | None,
    objects: tuple[WorldObject, ...],
) -> Body:
    spec = scaled_spec(height_m, preset)
    if self_collision:
        collide_with_itself(spec)
    if terrain is not None:
        height_field(terrain).replace_floor(spec)
    add_objects(spec, objects, height_m)
    # Limits and damping are the avatar's, whatever is around it.
    return replace(build_body(height_m, preset, self_collision), model=spec.compile())


def collide_with_itself(spec: mujoco.MjSpec) -> None:
    """Let links collide with each other, as ``build_body`` does."""
    for body in spec.bodies:
        for geom in body.geoms:
            if geom.contype:
                geom.conaffinity = 1
