"""Options of ``questsim demo`` and ``questsim play``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from typing_extensions import Doc

from agents.resolve import DEFAULT_POLICY, AgentName
from envs.objects import OBJECTS
from envs.terrain import COURSE, TERRAINS
from questsim.body import DEFAULT_HEIGHT_M
from questsim.modes import one_of
from questsim.viewing.page_access import DEFAULT_PORT, LOOPBACK

GROUNDS = tuple(name for name, terrain in TERRAINS.items() if terrain.kind != COURSE)
"""Terrains of the page, without the course: its tiles are smaller than many clips' paths."""
NOTHING = "none"
"""The page's choice for no object."""
_GROUND = f"The ground: {one_of(GROUNDS)}."


@dataclass(frozen=True, kw_only=True)
class WatchArgs:
    """Initial settings and address of every page."""

    clip: str | None = None
    """The first clip; by default a walk, or the first of the motions."""
    terrain: Annotated[str, Doc(_GROUND)] = "flat"
    roughness: float = 1.0
    """Multiplies the terrain's relief: 1 is ±4 cm on rough ground, slopes of 8 degrees."""
    object: Annotated[
        str | None,
        Doc(
            f"An object on the path: {one_of((NOTHING, *OBJECTS))}; by default a chair for seated "
            "clips and none for others."
        ),
    ] = None
    height: float = DEFAULT_HEIGHT_M
    """Stature of the user in metres."""
    avatar_height: float | None = None
    """Stature of the avatar in metres if it differs from its user; device signals are scaled."""
    host: str = LOOPBACK
    """Address to listen on; any other than the default lets others watch and control."""
    port: int = DEFAULT_PORT
    """The page's port; 0 takes any free one."""


@dataclass(frozen=True)
class DemoArgs(WatchArgs):
    """Watch a shipped policy or kinematic system follow a user, in a browser or on video."""

    agent: AgentName = DEFAULT_POLICY
    motions: str = "synthetic"
    """What to follow: synthetic, a dataset (bandai-namco-2:test), a library, file or folder."""
    terrain: Annotated[str, Doc(_GROUND)] = "rough"
    roughness: float = 0.5
    """Multiplies the terrain's relief: 1 is ±4 cm on rough ground, slopes of 8 degrees."""
    video: Path | None = None
    """Write this MP4 or GIF instead of serving a page."""
    seconds: float = 15.0
    """Length of the video."""
    push: float = 40.0
    """Push force in newtons in the video; 0 for none. Agents without physics are not pushed."""
    seed: int = 0
    """Seed of the embedded motions."""


@dataclass(frozen=True)
class PlayArgs(WatchArgs):
    """Watch the newest policy or kinematic system of a running training."""

    run: Annotated[Path, tyro.conf.Positional]
    """A run folder, a stage in it, or a checkpoint folder; waits for the first checkpoint."""
    motions: str | None = None
    """Motions to follow; by default the training motions of the run."""
