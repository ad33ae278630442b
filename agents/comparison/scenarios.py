"""The comparison scenarios of each kinematic system, and faulty devices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agents.kinematic.interface import KinematicSystem
from agents.kinematic.scenario import PAPER_NAMES, SIX, WINDOW, Scenario
from questsim.joint_sensors import SensorSequence

__all__ = ["PAPER_NAMES", "SIX", "WINDOW", "Scenario", "faulty", "scenarios"]

SILENT_FRAMES = 100
"""Number of frames after which a faulty tracker returns (DragPoser)."""


def scenarios(system: KinematicSystem) -> tuple[Scenario, ...]:
    """The scenarios that a system supports."""
    return system.scenarios


def faulty(sequence: SensorSequence, probability: float, seed: int) -> SensorSequence:
    """In each frame, one device drops out with this probability; it returns after 100 frames.

    Source: DragPoser's faulty trackers. At least one device always reports.
    """
    rng, present = np.random.default_rng(seed), sequence.present.copy()
    for frame in range(1, len(sequence)):
        if rng.random() < probability:
            device = int(rng.integers(present.shape[1]))
            if present[frame].sum() > 1:
                present[frame : frame + SILENT_FRAMES, device] = False
    return replace(sequence, present=present)
