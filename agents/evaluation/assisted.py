"""Evaluation with a bounded assisting force on the avatars: ``evaluate.py --assist 100``."""

from __future__ import annotations

from typing import Any

import numpy as np

from envs.assist import Assist, checked_bound
from envs.core import BatchSim
from envs.placement import moved, turn_quat
from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M
from questsim.skeleton import LINKS

UPRIGHT_SHARES = {"pelvis": 0.5, "head": 0.6}
"""An avatar is upright while these links are above these shares of the height that the user's have
at the same time, each over its own floor. A squatting user's avatar may squat."""
_UPRIGHT_LINKS = [LINKS.index(link) for link in UPRIGHT_SHARES]


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
        self._clips, self._used_clips, self._down_clips = 0, 0, 0

    def begin(self, sim: BatchSim) -> None:
        """Start a batch; call after its ``reset``."""
        self._sim, self._assist = sim, Assist(sim, self.bound_n)
        self._assist.reset()
        self._helped, self._down = np.zeros((2, sim.num_envs), bool)
        self._clips += sim.num_envs

    def apply(self) -> None:
        """Set the forces of the next step."""
        self._assist.apply(*user_headsets(self._sim))

    def count(self, active: np.ndarray, running: np.ndarray) -> None:
        """Count the last step: forces, and avatars that went down.

        Args:
            active: ``(C,)`` bool, avatars that have not lost their users: their forces count.
            running: ``(C,)`` bool, clips that have not ended: their avatars can go down.
        """
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
        down = running & ~self._down & ~is_upright(self._sim)
        self._down_clips += int(down.sum())
        self._down |= down

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
        self._down_clips += other._down_clips

    def figures(self) -> dict[str, Any]:
        """Use of the assist, and percent of the clips in which the avatar never went down.

        Time, mean and peak in N are of the frames before an avatar lost its user.
        """
        return {
            "bound_n": self.bound_n,
            "time_percent": 100.0 * self._used_steps / max(self._steps, 1),
            "clips_percent": 100.0 * self._used_clips / max(self._clips, 1),
            "mean_n": self._sum_n / self._used_steps if self._used_steps else None,
            "peak_n": self._peak_n,
            "upright_percent": 100.0 * (1.0 - self._down_clips / max(self._clips, 1)),
        }

    def line(self) -> str:
        """The figures as one line of text."""
        figures = self.figures()
        mean = figures["mean_n"] or 0.0
        return (
            f"assist of at most {self.bound_n:g} N: in use {figures['time_percent']:.2f} % of the "
            f"time and in {figures['clips_percent']:.1f} % of the clips, mean {mean:.0f} N, "
            f"peak {figures['peak_n']:.0f} N; "
            f"upright to the end in {figures['upright_percent']:.1f} % of the clips"
        )


def user_headsets(sim: BatchSim) -> tuple[np.ndarray, np.ndarray]:
    """Present world pose of the users' headsets: positions ``(n, 3)``, quaternions ``(n, 4)``."""
    ratio, place = sim.user_heights / DEFAULT_HEIGHT_M, sim.placement.place
    position = moved(place, sim.reference.dev_position[sim.frame, 0] * ratio[:, None])
    position[:, 2] += sim.floor
    quat = sim.reference.dev_quat[sim.frame, 0].astype(float)
    return position, rot.quat_multiply(turn_quat(place), quat)


def is_upright(sim: BatchSim) -> np.ndarray:
    """``(n,)`` whether each avatar is upright, see ``UPRIGHT_SHARES``."""
    user = sim.reference.position[sim.frame][:, _UPRIGHT_LINKS, 2]
    user = user * (sim.user_heights / DEFAULT_HEIGHT_M)[:, None]
    own = sim.link_positions[:, _UPRIGHT_LINKS, 2] - sim.floor[:, None]
    # A height that is not finite is not above its share.
    shares = np.array(list(UPRIGHT_SHARES.values()))
    high = own > shares * user
    return high[:, 0] & high[:, 1]
