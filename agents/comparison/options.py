"""Options of the comparison."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typing_extensions import Doc

from agents.resolve import ANY_AGENT


@dataclass(frozen=True, kw_only=True)
class CompareArgs:
    """Compare kinematic systems and policies on the same frames."""

    agents: Annotated[
        tuple[str, ...],
        Doc(f"Agents to compare, by default all shipped ones. Each is {ANY_AGENT}."),
    ] = ()
    motions: str = "synthetic"
    """Motions to reconstruct: synthetic, a dataset, a library, file or folder."""
    sensors: str | None = None
    """Use only this sensor set, e.g. H+2C or 6T; by default every set that an agent supports."""
    out: Path
    """Folder for tables, figures and the film."""
    video: bool = False
    """Also write a film of all agents side by side."""
    video_clips: tuple[str, ...] = ()
    """Names of the clips in the film; by default some of different kinds."""
    max_clips: int | None = None
    """Reconstruct only this many motions, of all kinds."""
    threads: int = 2
    """Number of parallel processes."""
    seed: int = 0
    """Seed of device faults and of the embedded motions."""
