"""What each kinematic system is given in a comparison: the scenarios of its entry, and faults."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agents.kinematic.interface import KinematicSystem
from agents.kinematic.scenario import PAPER_NAMES, SIX, WINDOW, Scenario
from questsim.joint_sensors import SensorSequence

__all__ = ["PAPER_NAMES", "SIX", "WINDOW", "Scenario", "faulty", "scenarios"]

SILENT_FRAMES = 100
"""A faulty tracker returns after so many frames (DragPoser)."""


def scenarios(system: KinematicSystem) -> tuple[Scenario, ...]:
    """The scenarios that suit a system."""
    return system.scenarios


def faulty(sequence: SensorSequence, probability: float, seed: int) -> SensorSequence:
    """Each frame one device falls silent with that probability, and returns after 100 frames.

    Source: DragPoser's faulty trackers. Never all of them: the first that is asked stays.
    """
    rng, present = np.random.default_rng(seed), sequence.present.copy()
    for frame in range(1, len(sequence)):
        if rng.random() < probability:
            device = int(rng.integers(present.shape[1]))
            if present[frame].sum() > 1:
                present[frame : frame + SILENT_FRAMES, device] = False
    return replace(sequence, present=present)
