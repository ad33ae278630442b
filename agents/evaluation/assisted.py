"""Evaluation with a bounded assisting force on the avatars: ``evaluate.py --assist 100``."""

from __future__ import annotations

from typing import Any

import numpy as np

from envs.assist import Assist, checked_bound
from envs.core import BatchSim
from envs.placement import moved, turn_quat
from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M


class AssistUse:
    """Applies the assisting force in each batch and records how much of it was used.

    Args:
        bound_n: largest force in N.

    Raises:
        InputError: ``bound_n`` is out of range.
    """

    def __init__(self, bound_n: float) -> None:
        self.bound_n = checked_bound(bound_n)
        self._steps, self._used_steps, self._sum_n, self._peak_n = 0, 0, 0.0, 0.0
        self._clips, self._used_clips = 0, 0

    def begin(self, sim: BatchSim) -> None:
        """Start a batch; call after its ``reset``."""
        self._sim, self._assist = sim, Assist(sim, self.bound_n)
        self._assist.reset()
        self._helped = np.zeros(sim.num_envs, bool)
        self._clips += sim.num_envs

    def apply(self) -> None:
        """Set the forces of the next step."""
        self._assist.apply(*user_headsets(self._sim))

    def count(self, active: np.ndarray) -> None:
        """Count the forces of the last step; ``active`` ``(C,)`` bool: avatars that count."""
        force = np.linalg.norm(self._assist.force, axis=-1)[active]
        used = force > 0.0
        self._steps += len(force)
        self._used_steps += int(used.sum())
        self._sum_n += float(force.sum())
        self._peak_n = max(self._peak_n, float(force.max(initial=0.0)))
        helped = np.zeros(len(active), bool)
        helped[active] = used
        self._used_clips += int((helped & ~self._helped).sum())
        self._helped |= helped

    def only_counts(self) -> AssistUse:
        """A copy without the simulation, to be sent between processes."""
        copy = AssistUse(self.bound_n)
        copy.add(self)
        return copy

    def add(self, other: AssistUse) -> None:
        """Add what another one has counted in batches of its own."""
        self._steps += other._steps
        self._used_steps += other._used_steps
        self._sum_n += other._sum_n
        self._peak_n = max(self._peak_n, other._peak_n)
        self._clips += other._clips
        self._used_clips += other._used_clips

    def figures(self) -> dict[str, Any]:
        """Use of the assist: percent of time, percent of clips, mean force while in use."""
        return {
            "bound_n": self.bound_n,
            "time_percent": 100.0 * self._used_steps / max(self._steps, 1),
            "clips_percent": 100.0 * self._used_clips / max(self._clips, 1),
            "mean_n": self._sum_n / self._used_steps if self._used_steps else None,
            "peak_n": self._peak_n,
        }

    def line(self) -> str:
        """The figures as one line of text."""
        figures = self.figures()
        mean = figures["mean_n"] or 0.0
        return (
            f"assist of at most {self.bound_n:g} N: in use {figures['time_percent']:.2f} % of the "
            f"time and in {figures['clips_percent']:.1f} % of the clips, mean {mean:.0f} N, "
            f"peak {figures['peak_n']:.0f} N"
        )


def user_headsets(sim: BatchSim) -> tuple[np.ndarray, np.ndarray]:
    """Present world pose of the users' headsets: positions ``(n, 3)``, quaternions ``(n, 4)``."""
    ratio, place = sim.user_heights / DEFAULT_HEIGHT_M, sim.placement.place
    position = moved(place, sim.reference.dev_position[sim.frame, 0] * ratio[:, None])
    position[:, 2] += sim.floor
    quat = sim.reference.dev_quat[sim.frame, 0].astype(float)
    return position, rot.quat_multiply(turn_quat(place), quat)
