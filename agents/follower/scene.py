"""The ground under a live avatar and the objects before it."""

from __future__ import annotations

from dataclasses import dataclass

from envs.objects import WorldObject
from envs.terrain import Terrain


@dataclass(frozen=True)
class Scene:
    """What surrounds a live avatar.

    Attributes:
        terrain: None for a plane.
        objects: placed side by side before the avatar when it starts.
    """

    terrain: Terrain | None = None
    objects: tuple[WorldObject, ...] = ()


PLAIN = Scene()
"""Level ground without objects."""
