"""Objects in the avatar's way: free bodies that interact with the avatar."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from envs.pushes import check_number, check_range
from questsim.body import DEFAULT_HEIGHT_M
from questsim.errors import InputError
from questsim.objects import ObjectShape

_BOX, _SPHERE = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_SPHERE
_Geom = tuple[mujoco.mjtGeom, tuple[float, float, float], tuple[float, float, float]]

# Parts: geom, half sizes and place in metres, the object's lowest point at z = 0 and its front
# along x. The ball is a football of size 5 (Laws of the Game, law 2: 68-70 cm around, 410-450 g).
_SHAPES: dict[str, tuple[float, tuple[_Geom, ...]]] = {
    "ball": (0.43, ((_SPHERE, (0.11, 0.0, 0.0), (0.0, 0.0, 0.11)),)),
    "box": (5.0, ((_BOX, (0.15, 0.2, 0.1), (0.0, 0.0, 0.1)),)),
    "hurdle": (
        3.0,
        (
            (_BOX, (0.02, 0.6, 0.02), (0.0, 0.0, 0.2)),
            (_BOX, (0.02, 0.02, 0.09), (0.0, 0.55, 0.09)),
            (_BOX, (0.02, 0.02, 0.09), (0.0, -0.55, 0.09)),
            (_BOX, (0.2, 0.02, 0.01), (0.0, 0.55, 0.01)),
            (_BOX, (0.2, 0.02, 0.01), (0.0, -0.55, 0.01)),
        ),
    ),
    "chair": (
        6.0,
        (
            (_BOX, (0.22, 0.22, 0.02), (0.0, 0.0, 0.43)),
            (_BOX, (0.02, 0.22, 0.22), (-0.2, 0.0, 0.67)),
            *((_BOX, (0.02, 0.02, 0.205), (x, y, 0.205)) for x in (-0.2, 0.2) for y in (-0.2, 0.2)),
        ),
    ),
}
OBJECTS: tuple[str, ...] = tuple(_SHAPES)
_RGBA = (0.85, 0.75, 0.3, 1.0)
# Contact sensor: data "force", reduce "netforce", one contact.
_NET_FORCE = [2, 3, 1]


@dataclass(frozen=True)
class WorldObject:
    """An object put on the ground beside or on the path of each episode's clip.

    Attributes:
        kind: one of ``OBJECTS``: a football, a box of 30 x 40 x 20 cm, a hurdle 22 cm high, or a
            chair, scaled with the avatar (its seat is at 45 cm for 1.75 m). In a seated clip the
            chair stands where the clip sits, and the fields below are ignored.
        ahead_s: the object stands where the clip is this many seconds after the episode's start,
            turned with the clip's travel; at least half a metre from the avatar's start.
        aside_m: offset to the left of that place, in metres.
        mass_kg: mass; None for the default of the kind.

    Raises:
        InputError: an unknown kind, or an invalid range.
    """

    kind: str = "ball"
    ahead_s: tuple[float, float] = (1.0, 2.0)
    aside_m: tuple[float, float] = (-0.1, 0.1)
    mass_kg: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in OBJECTS:
            raise InputError(
                f"unknown object {self.kind!r}", "objects", f"choose from {', '.join(OBJECTS)}"
            )
        check_range("ahead_s", self.ahead_s, 0.0, 60.0, "objects")
        check_range("aside_m", self.aside_m, -5.0, 5.0, "objects")
        if self.mass_kg is not None:
            check_number("mass_kg", self.mass_kg, 0.01, 200.0, "objects")


def objects_named(names: Sequence[str], where: str = "objects") -> tuple[WorldObject, ...]:
    """Objects of the given kinds, with default options.

    Args:
        names: kinds of ``OBJECTS``.
        where: source of the names, for error messages.

    Raises:
        InputError: an unknown kind.
    """
    for name in names:
        if name not in OBJECTS:
            known = ", ".join(OBJECTS)
            raise InputError(f"unknown object {name!r}", where, f"choose from {known}")
    return tuple(WorldObject(name) for name in names)


def _scaled(part: _Geom, scale: float) -> _Geom:
    kind, (a, b, c), (x, y, z) = part
    return kind, (scale * a, scale * b, scale * c), (scale * x, scale * y, scale * z)


def _made_of(obj: WorldObject, height_m: float) -> tuple[float, tuple[_Geom, ...]]:
    """Mass and parts of an object for an avatar of the given stature."""
    mass, parts = _SHAPES[obj.kind]
    if obj.kind == "chair":
        scale = height_m / DEFAULT_HEIGHT_M
        mass, parts = mass * scale**3, tuple(_scaled(part, scale) for part in parts)
    return mass if obj.mass_kg is None else obj.mass_kg, parts


def shapes_of(obj: WorldObject, height_m: float = DEFAULT_HEIGHT_M) -> tuple[ObjectShape, ...]:
    """Geometry of an object for rendering.

    Args:
        obj: the object.
        height_m: the avatar's stature; chairs scale with it.
    """
    return tuple(
        ObjectShape("ball", size[:1], place) if kind == _SPHERE else ObjectShape("box", size, place)
        for kind, size, place in _made_of(obj, height_m)[1]
    )


def add_objects(
    spec: mujoco.MjSpec, objects: Sequence[WorldObject], height_m: float = DEFAULT_HEIGHT_M
) -> None:
    """Put objects into a spec, behind the avatar, with a sensor of its force on each.

    Args:
        spec: of an avatar on the ground.
        objects: what to add.
        height_m: the avatar's stature; chairs scale with it.
    """
    for number, obj in enumerate(objects):
        mass, parts = _made_of(obj, height_m)
        body = spec.worldbody.add_body(name=f"object{number}", pos=[3.0 + number, 0.0, 0.0])
        body.add_freejoint(name=f"object{number}")
        # Boxes are solid and alike: mass by volume. A ball is its only part.
        volume = np.array([np.prod(size) if kind == _BOX else 1.0 for kind, size, _ in parts])
        for (kind, size, place), share in zip(parts, volume / volume.sum(), strict=True):
            # Rolling friction only where something rolls: condim 6 costs contacts otherwise.
            body.add_geom(
                type=kind, size=size, pos=place, mass=mass * share, rgba=_RGBA, group=2,
                contype=1, conaffinity=1, condim=6 if kind == _SPHERE else 3,
                friction=[0.7, 0.005, 0.002],
            )  # fmt: skip
        sensor = spec.add_sensor(
            name=f"force_on_object{number}",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_XBODY,
            objname="pelvis",
            reftype=mujoco.mjtObj.mjOBJ_BODY,
            refname=f"object{number}",
        )
        sensor.intprm = _NET_FORCE
