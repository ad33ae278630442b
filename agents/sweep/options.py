"""Options of ``questsim sweep``: those of a training, and what varies between its runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from agents.training.options import TrainArgs


@dataclass(frozen=True)
class SweepArgs(TrainArgs):
    """Train with several seeds and values of the preset, and compare the results."""

    out: Path
    """Folder of the sweep: one run per value and seed, sweep.csv and sweep.json."""
    seeds: int = 3
    """Number of seeds of each setting: --seed, --seed + 1, ..."""
    values: tuple[str, ...] = ()
    """Values of the preset to compare, each as path=VALUE,VALUE,..., with the paths of --set; all
    combinations are trained. The first one is the baseline of the comparison."""
    search: tuple[str, ...] = ()
    """Ranges to search by Optuna instead, each as path=LOW:HIGH or path=LOW:HIGH:log."""
    trials: int | None = None
    """With --search: number of settings to try; by default 10."""
    resume: bool = False
    """Continue the sweep in --out; --seeds, --values and --trials may be extended."""
    workers: int = 1
    """Number of runs at the same time: processes of this machine, or tasks of --ray."""
    ray: str | None = None
    """Address of a Ray cluster whose nodes train the runs (docs/scaling.md)."""
