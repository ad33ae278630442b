"""MuJoCo's batch of many avatars, in which a failure ends the episode of one simulation only."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import mujoco
import numpy as np
from mujoco import batch as mujoco_batch

# Warning counters of states that are not finite or too large; MuJoCo then resets the simulation.
_UNSTABLE = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
]


_LOG = logging.getLogger("questsim.physics")


def _log_warning(message: str) -> None:
    # Unstable simulations are counted and reset here. MuJoCo would also write each to a log file.
    _LOG.log(logging.INFO if "unstable" in message else logging.WARNING, "%s", message)


if mujoco.get_mju_user_warning() is None:
    mujoco.set_mju_user_warning(_log_warning)


class Physics:
    """A MuJoCo batch and its failures.

    Args:
        models: one for each simulation, with equal sizes.
        num_threads: threads that step it.

    Attributes:
        batch: MuJoCo's batch.
        stopped: ``(n,)`` bool, simulations with an error of MuJoCo since their last reset.
    """

    def __init__(self, models: Sequence[mujoco.MjModel], num_threads: int) -> None:
        self.batch = mujoco_batch.Batch(
            models[0], len(models), nthread=num_threads, persistent=True
        )
        self.batch.set_models(models)
        self.stopped = np.zeros(len(models), bool)

    @contextmanager
    def surviving(self) -> Iterator[None]:
        """Step the physics. A MuJoCo error in one simulation ends the episode of that one only."""
        try:
            yield
        except mujoco_batch.SimulationError as error:
            # MuJoCo left the failed simulations unchanged and stepped the others.
            self.stopped[error.ids] = True
            _LOG.info("%s", error)

    def unstable(self) -> np.ndarray:
        """``(n,)`` whether the physics of a simulation failed since its last reset."""
        return (self.batch.warning[:, _UNSTABLE, 1] > 0).any(axis=1) | self.stopped
