"""Options of the training of kinematic systems."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class TrainSystemArgs:
    """Train a kinematic system, which estimates the whole pose from devices."""

    out: Path
    """Folder of the run: record, checkpoints, TensorBoard logs."""
    agent: str
    """The system's family (docs/agents.md)."""
    motions: str = "synthetic"
    """What to learn: synthetic, a dataset (bandai-namco-2:train), a library, file or folder."""
    preset: Literal["cpu", "paper", "smoke"] = "cpu"
    """What learns on two cores, what was published, or a test of two minutes."""
    minutes: float | None = None
    """Time for everything, earlier parts of a resumed run included; by default the preset's."""
    steps: int | None = None
    """Gradient steps of each stage, instead of the preset's limit."""
    resume: bool = False
    """Go on with the run in --out."""
    start: Path | None = None
    """A system of that family and these sizes, by folder or shipped name, that is trained
    further."""
    threads: int = 2
    """Threads of the networks."""
    seed: int = 0
    """Of everything that is random."""
    set: tuple[str, ...] = ()
    """Values of the preset to change, e.g. stages.network.batch=16."""
