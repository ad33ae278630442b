"""Assist: a bounded force and torque on the pelvis of an avatar that is about to lose its user.

QuestSim (section 5.3) asks when physics should be violated. The assist acts while the avatar's
head is more than 25 cm from the user's head, or will be within 0.1 s at the present velocities.
The prediction detects toppling early. The assist reads the headset alone, so it also works live.
"""

from __future__ import annotations

import numpy as np

from envs.core import BatchSim
from questsim import rotations as rot
from questsim.errors import InputError
from questsim.motion.clip import FPS
from questsim.sensors import device_poses
from questsim.skeleton import LINKS

COMES_M, GOES_M = 0.25, 0.12
"""Distance between the heads above which the assist fades in, and below which it fades out."""
FORESIGHT_S = 0.1
"""How far ahead the distance is extrapolated."""
FADE_S = 0.25
"""Duration of a full fade in or out."""
ARM_M = 0.3
"""Bound of the torque over bound of the force: 90 N m for 300 N."""
MAX_ASSIST_N = 2000.0
_STIFFNESS, _DAMPING = 60.0, 14.0
"""Gains of the force on the pelvis, 1/s^2 and 1/s per kg: nearly critical damping at 1.2 Hz."""
_UPRIGHTING, _SPIN_DAMPING = 15.0, 1.2
"""Gains of the torque on the sine of the tilt and on rad/s, N m per kg of the body."""
_TURNING = 4.0
"""Gain of the torque about the vertical on the sine of the angle between the headings."""
_PELVIS, _HEAD = 1, LINKS.index("head")


class Assist:
    """The assist of every avatar of a batch.

    Args:
        sim: of the avatars.
        bound_n: largest magnitude of the force in newtons; 0 turns the assist off.

    Attributes:
        force: ``(n, 3)`` N on the pelvis in the present step.
        torque: ``(n, 3)`` N m in the present step; its bound is ``ARM_M`` times the force's.
        share: ``(n,)`` fade of the assist, 0 (off) to 1 (full).

    Raises:
        InputError: the bound is not within 0 and 2000 N.
    """

    def __init__(self, sim: BatchSim, bound_n: float) -> None:
        n = sim.num_envs
        self._sim, self.bound_n = sim, checked_bound(bound_n)
        self._mass = 70.0 * (sim.heights / 1.75) ** 3
        self._wrench, self._spin = sim.batch.bind("xfrc_applied"), sim.batch.bind("cvel")
        self.force, self.torque = np.zeros((n, 3)), np.zeros((n, 3))
        self.share = np.zeros(n)
        self._comes = np.zeros(n, bool)
        self._before: np.ndarray | None = None

    def reset(self) -> None:
        """Turn the assist off in episodes that begin."""
        self.share[:], self._comes[:], self._before = 0.0, False, None
        self.force[:], self.torque[:] = 0.0, 0.0
        self._wrench[:, _PELVIS] = 0.0

    def apply(self, user: np.ndarray, user_quat: np.ndarray) -> None:
        """Set the forces of the coming step; call once before each.

        Args:
            user: ``(n, 3)`` positions of the users' headsets in the world in metres.
            user_quat: ``(n, 4)`` orientations of the headsets.
        """
        if self.bound_n == 0.0 and not self.share.any():
            return
        own = headsets(self._sim)
        error = user - own
        rate = np.zeros_like(error) if self._before is None else (error - self._before) * FPS
        self._before = error
        distance = np.linalg.norm(error, axis=-1)
        ahead = np.linalg.norm(error + FORESIGHT_S * rate, axis=-1)
        worst = np.maximum(distance, ahead)
        self._comes |= worst > COMES_M
        self._comes &= worst > GOES_M
        step = 1.0 / (FADE_S * FPS)
        self.share += np.clip(self._comes - self.share, -step, step)
        if not self.share.any():
            self.force[:], self.torque[:] = 0.0, 0.0
            self._wrench[:, _PELVIS] = 0.0
            return
        mass = self._mass[:, None]
        pull = mass * (_STIFFNESS * error + _DAMPING * rate)
        pelvis = self._sim.link_positions[:, 0]
        lever, wanted = _unit(own - pelvis), _unit(user - pelvis)
        spin = self._spin[:, _PELVIS, :3]
        turn = _UPRIGHTING * np.cross(lever, wanted) - _SPIN_DAMPING * spin
        aside = rot.heading(user_quat) - rot.heading(self._sim.link_quats[:, _HEAD])
        turn[:, 2] += _TURNING * np.sin(aside)
        turn *= mass
        self.force[:] = self.share[:, None] * _bounded(pull, self.bound_n)
        self.torque[:] = self.share[:, None] * _bounded(turn, ARM_M * self.bound_n)
        self._wrench[:, _PELVIS, :3], self._wrench[:, _PELVIS, 3:] = self.force, self.torque


def checked_bound(bound_n: float) -> float:
    """Validate the bound of the force in newtons.

    Raises:
        InputError: it is not within 0 and 2000 N.
    """
    if not 0.0 <= bound_n <= MAX_ASSIST_N:
        raise InputError(
            f"{bound_n:g} N is not within 0 and {MAX_ASSIST_N:g} N", "assist", "0 turns it off"
        )
    return float(bound_n)


def headsets(sim: BatchSim) -> np.ndarray:
    """Positions of the avatars' headsets ``(n, 3)``."""
    out = np.empty((sim.num_envs, 3))
    for height in np.unique(sim.heights):
        these = sim.heights == height
        position, _ = device_poses(
            sim.link_positions[these], sim.link_quats[these], ["headset"], float(height)
        )
        out[these] = position[:, 0]
    return out


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), 1e-6)


def _bounded(vector: np.ndarray, most: float) -> np.ndarray:
    """Vectors ``(n, 3)`` shortened to at most ``most``; zero where not finite."""
    vector = np.where(np.isfinite(vector), vector, 0.0)
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return vector * np.minimum(1.0, most / np.maximum(length, 1e-9))
