"""Inverse kinematics of a body: damped Gauss-Newton steps on MuJoCo's Jacobians."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

_DAMPING = 1e-3
_LARGEST_STEP = 0.5
_SMALL_STEP = 3e-3


class Solver:
    """Finds poses in which places of a body reach targets; residuals are added row by row.

    Args:
        model: the body.
        joint_range: ``(D, 2)`` rad that the hinges keep.
    """

    def __init__(self, model: mujoco.MjModel, joint_range: np.ndarray) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self._range = joint_range
        self._rows: list[np.ndarray] = []
        self._errors: list[np.ndarray] = []
        self._move, self._turn = np.zeros((3, model.nv)), np.zeros((3, model.nv))

    def set_pose(self, qpos: np.ndarray) -> None:
        """Set a pose, and compute places and Jacobians."""
        self.data.qpos[:] = qpos
        self._forward()

    def _forward(self) -> None:
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)

    def place(self, link: int, at: np.ndarray) -> np.ndarray:
        """World position ``(3,)`` of a point of a link."""
        turn = self.data.xmat[link + 1].reshape(3, 3)
        return self.data.xpos[link + 1] + turn @ at

    def quat(self, link: int) -> np.ndarray:
        """World orientation ``(4,)`` of a link."""
        return self.data.xquat[link + 1]

    def move_jacobian(self, link: int, at: np.ndarray) -> np.ndarray:
        """``(3, nv)`` of a point of a link."""
        mujoco.mj_jac(self.model, self.data, self._move, None, self.place(link, at), link + 1)
        return self._move.copy()

    def turn_jacobian(self, link: int) -> np.ndarray:
        """``(3, nv)`` of a link's rotation, in the world."""
        mujoco.mj_jacBody(self.model, self.data, None, self._turn, link + 1)
        return self._turn.copy()

    def add(self, error: np.ndarray, jacobian: np.ndarray, weight: float) -> None:
        """Ask for a change ``error`` ``(k,)`` of what has ``jacobian`` ``(k, nv)``."""
        self._errors.append(weight * error)
        self._rows.append(weight * jacobian)

    def add_angles(self, wanted: np.ndarray, weight: float) -> None:
        """Draw the hinges to ``wanted`` ``(D,)`` rad."""
        count = len(wanted)
        jacobian = np.eye(count, count + 6, 6)
        self.add(wanted - self.data.qpos[7:], jacobian, weight)

    def step(self) -> float:
        """Move by the residuals added since the last step; the largest change."""
        error, rows = np.concatenate(self._errors), np.concatenate(self._rows)
        self._errors.clear()
        self._rows.clear()
        normal = rows.T @ rows
        normal[np.diag_indices_from(normal)] += _DAMPING
        change = np.linalg.solve(normal, rows.T @ error)
        change = self._held(normal, rows.T @ error, change)
        largest = float(np.abs(change).max())
        if largest > _LARGEST_STEP:
            change *= _LARGEST_STEP / largest
        mujoco.mj_integratePos(self.model, self.data.qpos, change, 1.0)
        hinges = self.data.qpos[7:]
        np.clip(hinges, self._range[:, 0], self._range[:, 1], out=hinges)
        self._forward()
        return largest

    def _held(self, normal: np.ndarray, right: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Solve again without the hinges that would leave their ranges: others make up for it."""
        at = self.data.qpos[7:]
        beyond = (at <= self._range[:, 0] + 1e-9) & (change[6:] < 0.0)
        beyond |= (at >= self._range[:, 1] - 1e-9) & (change[6:] > 0.0)
        if not beyond.any():
            return change
        free = np.concatenate([np.ones(6, bool), ~beyond])
        held = np.zeros_like(change)
        held[free] = np.linalg.solve(normal[np.ix_(free, free)], right[free])
        return held

    def until_still(self, residuals: Callable[[], None], steps: int) -> None:
        """Call ``residuals()`` and step, at most ``steps`` times."""
        for _ in range(steps):
            residuals()
            if self.step() < _SMALL_STEP:
                return


def turn_error(quat: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Rotation vector ``(3,)`` in the world that turns ``quat`` into ``wanted``."""
    inverse, turn, vector = np.empty(4), np.empty(4), np.empty(3)
    mujoco.mju_negQuat(inverse, quat)
    mujoco.mju_mulQuat(turn, wanted, inverse)
    mujoco.mju_quat2Vel(vector, turn, 1.0)
    return vector
