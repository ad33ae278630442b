"""The avatar's body in a world: MuJoCo models that a batch steps."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from functools import lru_cache

import mujoco
import numpy as np

from envs.objects import WorldObject, add_objects
from envs.terrain import Terrain, height_field
from questsim import rotations as rot
from questsim.bodies import OwnBody, map_of
from questsim.bodies.scaling import scaled_spec as scaled_spec_of
from questsim.body import Body, build_body, let_links_collide, scaled_spec
from questsim.body_proportions import Proportions

_SOLE = "sole"
_GROUND = 2
"""Contact bit of geoms that collide with ground that is not a plane."""


def build_world(
    height_m: float,
    preset: str = "default",
    self_collision: bool = False,
    terrain: Terrain | None = None,
    objects: tuple[WorldObject, ...] = (),
    proportions: Proportions | None = None,
) -> Body:
    """The avatar of a person ``height_m`` tall on the ground; cached, do not write to the model.

    Args:
        height_m, preset, self_collision, proportions: as of ``questsim.body.build_body``.
        terrain: the ground; None for a plane.
        objects: those behind the avatar in ``qpos``, seven numbers each.

    Raises:
        InputError: height out of range or unknown preset.
    """
    flat = build_body(height_m, preset, self_collision, proportions)
    if terrain is None and not objects:
        return flat
    return _build(flat.height_m, preset, self_collision, terrain, objects, proportions)


@lru_cache(maxsize=128)
def _build(
    height_m: float,
    preset: str,
    self_collision: bool,
    terrain: Terrain | None,
    objects: tuple[WorldObject, ...],
    proportions: Proportions | None,
) -> Body:
    spec = scaled_spec(height_m, preset, proportions)
    if self_collision:
        let_links_collide(spec)
    if terrain is not None:
        height_field(terrain).replace_floor(spec)
    add_objects(spec, objects, height_m)
    if terrain is not None:
        _stand_on_points(spec)
    # Torque limits and damping of the avatar alone, independent of its surroundings.
    flat = build_body(height_m, preset, self_collision, proportions)
    return replace(flat, model=spec.compile())


@lru_cache(maxsize=128)
def build_own_world(
    body: OwnBody,
    height_m: float,
    self_collision: bool = False,
    terrain: Terrain | None = None,
    objects: tuple[WorldObject, ...] = (),
) -> Body:
    """A body of the user's own on the ground; cached, do not write to the model.

    Args:
        body: the body.
        height_m: stature; masses, torques and inertias change with it, see ``bodies.scaling``.
        self_collision, terrain, objects: as of ``build_world``.
    """
    own = map_of(body)
    plain = own.colliding if self_collision else own.body
    ratio = height_m / plain.height_m
    if terrain is None and not objects and ratio == 1.0:
        return plain
    spec = own.spec.copy() if ratio == 1.0 else scaled_spec_of(own.spec, ratio)
    if self_collision:
        let_links_collide(spec)
    if terrain is not None:
        height_field(terrain).replace_floor(spec)
    add_objects(spec, objects, height_m, root=own.links[0])
    if terrain is not None:
        feet = {own.links[link] for link in own.support.link}
        _stand_on_points(spec, lambda geom: _is_capsule_of(geom, feet))
    return replace(
        plain,
        model=spec.compile(),
        height_m=height_m,
        torque_limits=plain.torque_limits * ratio**3,
        damping=plain.damping * ratio**3,
    )


def _is_capsule_of(geom: mujoco.MjsGeom, bodies: Collection[str]) -> bool:
    capsule = geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE
    return bool(geom.contype and capsule and geom.parent.name in bodies)


def _is_sole(geom: mujoco.MjsGeom) -> bool:
    return geom.classname.name == _SOLE


def _stand_on_points(
    spec: mujoco.MjSpec, is_sole: Callable[[mujoco.MjsGeom], bool] = _is_sole
) -> None:
    """Replace the soles' capsules by spheres for contacts with the ground.

    A capsule on a plane has a contact at each end. On a triangle of a height field MuJoCo finds
    only one contact, anywhere along the capsule: feet rock, sink in by centimetres and creep
    downhill. Spheres at the two ends, and one between them for ridges, avoid this.
    """
    for geom in list(spec.geoms):
        if is_sole(geom):
            ends = _ends(geom)
            for number, share in enumerate((0.0, 0.5, 1.0)):
                geom.parent.add_geom(
                    name=f"{geom.name}_{number}",
                    type=mujoco.mjtGeom.mjGEOM_SPHERE,
                    pos=(1.0 - share) * ends[0] + share * ends[1],
                    size=[geom.size[0], 0.0, 0.0],
                    mass=0.0,
                    contype=_GROUND,
                    conaffinity=0,
                    condim=geom.condim,
                    friction=geom.friction,
                    priority=geom.priority,
                    group=geom.group,
                )
        elif geom.contype:
            geom.contype |= _GROUND
    spec.geom("floor").conaffinity = _GROUND


def _ends(geom: mujoco.MjsGeom) -> np.ndarray:
    """Centres ``(2, 3)`` of the ends of a capsule in its body."""
    fromto = np.asarray(geom.fromto)
    if not np.isnan(fromto[0]):
        return fromto.reshape(2, 3)
    along = rot.quat_rotate(np.asarray(geom.quat), np.array([0.0, 0.0, geom.size[1]]))
    return np.stack([geom.pos - along, geom.pos + along])
