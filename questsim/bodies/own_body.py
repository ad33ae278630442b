"""Which body of the user's own a configuration or a checkpoint means."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class OwnBody:
    """A body by its description: what configurations and checkpoints keep.

    Attributes:
        name: of the body.
        path: of the description's file.
        digest: of the compiled MJCF and its map; another file of the same digest is the same body.
    """

    name: str
    path: str
    digest: str
