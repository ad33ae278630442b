"""Options of the training of kinematic systems, and of ``questsim estimate``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from agents.resolve import DEFAULT_SYSTEM
from agents.training.options import LogName

Noise = Literal["white", "mounts", "latency", "dropouts", "all"]
"""Kinds of faults of the devices."""


@dataclass(frozen=True)
class TrainSystemArgs:
    """Train a kinematic system, which estimates the full-body pose from devices."""

    out: Path
    """Folder of the run: record, checkpoints, TensorBoard logs."""
    agent: str
    """The system's family (docs/agents.md)."""
    motions: str = "synthetic"
    """Motions to learn: synthetic, a dataset (bandai-namco-2:train), a library, file or folder."""
    preset: Literal["cpu", "paper", "smoke"] = "cpu"
    """cpu: learns on two cores; paper: as published; smoke: a test of two minutes."""
    minutes: float | None = None
    """Total time budget, including earlier parts of a resumed run; by default the preset's."""
    steps: int | None = None
    """Gradient steps of each stage, instead of the preset's limit."""
    resume: bool = False
    """Resume the run in --out."""
    start: Path | None = None
    """A system to train further, by folder or shipped name; its family and sizes must match."""
    threads: int = 2
    """Threads for the networks."""
    workers: int = 0
    """Processes that share each batch: this one and Ray workers, each with --threads
    (docs/scaling.md); 0 for this one alone."""
    ray: str | None = None
    """Address of a Ray cluster for --workers, by default one of this machine alone."""
    log: LogName = "tensorboard"
    """Where curves go, beside a CSV file: tensorboard, Weights & Biases, trackio, or csv for
    nowhere else."""
    seed: int = 0
    """Seed of all random numbers."""
    hold_out: str = ""
    """Styles, separated by commas, to hold out from training and compare checkpoints on."""
    validation: str | None = None
    """Motions to compare checkpoints on; by default those of the training."""
    set: tuple[str, ...] = ()
    """Change values of the preset, e.g. stages.network.batch=16."""


@dataclass(frozen=True)
class EstimateArgs:
    """Write a library of the motions that a kinematic system estimates from devices."""

    out: Path
    """The library to write, an .npz file."""
    agent: str = DEFAULT_SYSTEM
    """The system: a name, checkpoint folder or run folder."""
    motions: str = "synthetic"
    """Motions that the device signals are made from: synthetic, a dataset, a library, file or
    folder."""
    sensors: str | None = None
    """Sensor set by name; by default the set of the system's first comparison scenario."""
    max_clips: int | None = None
    """Use only this many motions, of all kinds."""
    threads: int = 2
    """Number of parallel processes."""
    workers: int = 0
    """Ray workers that share the clips (docs/scaling.md); 0 for none."""
    ray: str | None = None
    """Address of a Ray cluster for --workers, by default one of this machine alone."""
    seed: int = 0
    """Seed of the embedded motions."""
