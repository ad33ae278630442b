"""MuJoCo's batch of many avatars, in which a failure ends the episode of one simulation only."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import mujoco
import numpy as np
from mujoco import batch as mujoco_batch

from envs.kernel_arguments import State

POSITION = int(mujoco.mjtStage.mjSTAGE_POS.value)
VELOCITY = int(mujoco.mjtStage.mjSTAGE_VEL.value)
"""MuJoCo's stages up to which a state is computed: positions alone, or velocities too."""

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
        qpos, qvel, ctrl, sensors: ``(n, ...)`` views of the batch.
        state: views that the kernels read; its ``foot_force`` is the last step's.
        torque_limits: ``(n, D)`` N m.
    """

    def __init__(self, models: Sequence[mujoco.MjModel], num_threads: int) -> None:
        self.batch = mujoco_batch.Batch(
            models[0], len(models), nthread=num_threads, persistent=True
        )
        self.batch.set_models(models)
        self.stopped = np.zeros(len(models), bool)
        bind = self.batch.bind
        self.qpos, self.qvel, self.ctrl = bind("qpos"), bind("qvel"), bind("ctrl")
        self.sensors, links = bind("sensordata"), (bind("xpos"), bind("xquat"), bind("cvel"))
        feet = np.zeros((len(models), 2, 3))
        self.state = State(self.qpos, self.qvel, *links, bind("subtree_com"), feet)
        self.torque_limits = np.stack([m.actuator_ctrlrange[:, 1] for m in models])

    def forward(self, ids: np.ndarray | None = None, stage: int = VELOCITY) -> None:
        """Compute what follows from the state of simulations ``ids`` (all, if None)."""
        with self._surviving():
            self.batch.forward(ids, stage=stage)

    def step(self, substeps: int, before_each: Callable[[], None] | None = None) -> None:
        """Advance all simulations.

        Args:
            substeps: number of steps of the physics.
            before_each: called before each of them.
        """
        if before_each is None:
            with self._surviving():
                self.batch.step(nstep=substeps, stage=VELOCITY)
            return
        for _ in range(substeps):
            before_each()
            with self._surviving():
                self.batch.step(nstep=1, stage=VELOCITY)

    @contextmanager
    def _surviving(self) -> Iterator[None]:
        """A MuJoCo error in one simulation ends the episode of that one only."""
        try:
            yield
        except mujoco_batch.SimulationError as error:
            # MuJoCo left the failed simulations unchanged and stepped the others.
            self.stopped[error.ids] = True
            _LOG.info("%s", error)

    def unstable(self) -> np.ndarray:
        """``(n,)`` whether the physics of a simulation failed since its last reset."""
        return (self.batch.warning[:, _UNSTABLE, 1] > 0).any(axis=1) | self.stopped
