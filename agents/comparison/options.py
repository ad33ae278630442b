"""Options of the comparison."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class CompareArgs:
    """Compare kinematic systems and policies on the same frames."""

    agents: tuple[str, ...] = ()
    """All that --agent takes: names, checkpoint and run folders, classes of your own, systems
    with +physics after the name. By default what is shipped."""
    motions: str = "synthetic"
    """What to reconstruct: synthetic, a dataset, a library, file or folder."""
    sensors: str | None = None
    """Only with this set of sensors, e.g. H+2C or 6T; by default with all that an agent can use."""
    out: Path
    """Folder for tables, figures and the film."""
    video: bool = False
    """Also write a film of all agents side by side."""
    video_clips: tuple[str, ...] = ()
    """Names of the clips that the film shows; by default some of different kinds."""
    max_clips: int | None = None
    """Reconstruct only this many motions, of all kinds."""
    threads: int = 2
    """Processes side by side."""
    seed: int = 0
    """Of faults and of the embedded motions."""
