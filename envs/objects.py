"""Objects in the avatar's way: free bodies that interact with the avatar."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from envs.checks import check_number, check_range
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
OPTIONS: tuple[str, ...] = ("ahead_s", "aside_m", "mass_kg")
"""Options of an object: the fields of ``WorldObject`` but its kind."""
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


def objects_named(
    texts: Sequence[str], where: str = "objects", options: Sequence[str] = OPTIONS
) -> tuple[WorldObject, ...]:
    """Parse objects: kinds of ``OBJECTS``, each optionally followed by options.

    Args:
        texts: e.g. ``"ball"``, ``"ball:mass_kg=1"`` or ``"chair:ahead_s=1..3,aside_m=2"``. A range
            is two numbers with two dots between them; one number is a range of that number alone.
        where: source of the texts, for error messages.
        options: the options that count there.

    Raises:
        InputError: an unknown kind or option, or a value out of range.
    """
    return tuple(_object_named(text, where, options) for text in texts)


def _object_named(text: str, where: str, options: Sequence[str]) -> WorldObject:
    kind, _, given = text.partition(":")
    if kind not in OBJECTS:
        raise InputError(f"unknown object {kind!r}", where, f"choose from {', '.join(OBJECTS)}")
    values: dict[str, Any] = {}
    for option in filter(None, given.split(",")):
        name, equals, value = option.partition("=")
        if not equals or name not in options:
            fix = f"it has {', '.join(options)}"
            raise InputError(f"{option!r} is not an option of an object here", where, fix)
        try:
            ends = [float(end) for end in value.split("..")]
        except ValueError:
            ends = []
        if len(ends) != 1 and (len(ends) != 2 or name == "mass_kg"):
            fix = "give a number" if name == "mass_kg" else "give a number, or a range such as 1..2"
            raise InputError(f"{value!r} is no value", f"{where} {name}", fix)
        values[name] = ends[0] if name == "mass_kg" else (ends[0], ends[-1])
    return WorldObject(kind, **values)


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
    spec: mujoco.MjSpec,
    objects: Sequence[WorldObject],
    height_m: float = DEFAULT_HEIGHT_M,
    root: str = "pelvis",
) -> None:
    """Put objects into a spec, behind the avatar, with a sensor of its force on each.

    Args:
        spec: of an avatar on the ground.
        objects: what to add.
        height_m: the avatar's stature; chairs scale with it.
        root: name of the avatar's root.
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
            objname=root,
            reftype=mujoco.mjtObj.mjOBJ_BODY,
            refname=f"object{number}",
        )
        sensor.intprm = _NET_FORCE
