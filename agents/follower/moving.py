"""The state of a user in motion, estimated by HMD-Poser from the last second of the devices.

An avatar that is set up again while its user walks must walk, too: put upright at rest into a walk,
it falls at once. A user who stands is estimated by ``stance`` instead, with both feet on the floor.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import mujoco
import numpy as np

from agents.kinematic.interface import KinematicSystem, UserBody
from agents.kinematic.physics_behind import on_own_body
from agents.kinematic.store import load_system
from agents.resolve import DEFAULT_SYSTEM
from questsim import rotations as rot
from questsim.body import build_body
from questsim.errors import InputError
from questsim.joint_sensors import SENSOR_FPS, SensorSequence
from questsim.motion.clip import FPS
from questsim.motion.kinematics import standing_clip
from questsim.motion.retarget_back import to_motion
from questsim.motion.retarget_stream import StreamRetargeter
from questsim.sensors import device_poses
from questsim.skeleton import NUM_DOFS, NUM_LINKS

MOVES_M_S = 0.3
"""A user whose headset moves faster than this on average, level, is in motion."""
_FRAMES, _LEAST = 36, 18
"""Number of frames that are kept, and without which nothing is estimated: a half second."""


def level_speed(headset: Sequence[np.ndarray]) -> float:
    """Mean level speed in m/s over the last half second of places ``(3,)`` at 36 Hz.

    0 if there are fewer places.
    """
    if len(headset) < _LEAST:
        return 0.0
    moved = headset[-1][:2] - headset[-_LEAST][:2]
    return float(np.linalg.norm(moved)) * FPS / (_LEAST - 1)


class MovingUser:
    """The last second of a user's devices.

    Args:
        names: ``D`` devices, the headset first.
        height_m: the user's stature.
        ahead_s: time of the newest frame after the avatar's present state.
    """

    def __init__(self, names: tuple[str, ...], height_m: float, ahead_s: float) -> None:
        self._names, self._height_m, self._ahead_s = names, height_m, ahead_s
        self._frames: deque[tuple[np.ndarray, np.ndarray]] = deque(maxlen=_FRAMES)
        self._system = estimator(names)
        self._user = to_motion(standing_clip(height_m, 2))
        self._model = build_body(height_m).model

    def reset(self) -> None:
        """The next frame is the first of a new stream."""
        self._frames.clear()

    def show(self, position: np.ndarray, quat: np.ndarray) -> None:
        """Keep the next frame at 36 Hz: ``(D, 3)``, ``(D, 4)`` over a level floor at z = 0."""
        self._frames.append((position.copy(), quat.copy()))

    @property
    def speed(self) -> float:
        """Mean level speed of the headset in the last half second, m/s; 0 if it is not known."""
        return level_speed([position[0] for position, _ in self._frames])

    def state(self) -> tuple[np.ndarray, np.ndarray] | None:
        """The user's present ``qpos`` ``(40,)`` and ``qvel`` ``(39,)``, with the head in its place.

        None if the user stands, or if the estimator cannot use the devices.
        """
        if self._system is None or self.speed < MOVES_M_S:
            return None
        sequence = self._sequence()
        poses = on_own_body(self._system.predict(sequence, UserBody.of(self._user)), self._user)
        # The last three frames up to the present: its pose, and velocities from its neighbours.
        now = len(sequence) - 1 - max(round(self._ahead_s * SENSOR_FPS), 1)
        rows = slice(now - 1, now + 2)
        around = replace(
            poses, root_position=poses.root_position[rows], rotations=poses.rotations[rows]
        )
        qpos = StreamRetargeter(self._user, self._height_m)(around)
        qvel = np.zeros(6 + NUM_DOFS)
        mujoco.mj_differentiatePos(self._model, qvel, 2.0 / SENSOR_FPS, qpos[0], qpos[2])
        state = qpos[1].copy()
        late_s = (len(sequence) - 1 - now) / SENSOR_FPS - self._ahead_s
        mujoco.mj_integratePos(self._model, state, qvel, late_s)
        state[:2] += self._headset_at_present() - self._own_headset(state)
        finite = np.isfinite(state).all() and np.isfinite(qvel).all()
        return (state, qvel) if finite else None

    def _sequence(self) -> SensorSequence:
        """The kept frames, interpolated to the estimator's rate; the newest frame is the last."""
        known = np.arange(len(self._frames)) / FPS
        count = int(known[-1] * SENSOR_FPS) + 1
        times = known[-1] - np.arange(count)[::-1] / SENSOR_FPS
        position, quat = (np.array(each) for each in zip(*self._frames, strict=True))
        at, turned = rot.resample_poses(position, quat, known, times)
        shape = (count, len(self._names))
        return SensorSequence(
            time_s=times - times[0],
            names=self._names,
            position=at,
            quat=turned,
            acceleration=np.zeros((*shape, 3)),
            present=np.ones(shape, bool),
        )

    def _headset_at_present(self) -> np.ndarray:
        """Level position ``(2,)`` of the user's headset at the time of the avatar's state."""
        known = np.arange(len(self._frames)) / FPS
        path = np.array([position[0, :2] for position, _ in self._frames])
        then = known[-1] - self._ahead_s
        at = rot.resample_points(path, known, np.array(then))
        return at + max(then - known[-1], 0.0) * FPS * (path[-1] - path[-2])

    def _own_headset(self, qpos: np.ndarray) -> np.ndarray:
        """Level position ``(2,)`` of the headset of an avatar in this pose."""
        data = mujoco.MjData(self._model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, data)
        links = slice(1, NUM_LINKS + 1)
        position, _ = device_poses(data.xpos[links], data.xquat[links], ["headset"], self._height_m)
        return position[0, :2]


@cache
def estimator(names: tuple[str, ...]) -> KinematicSystem | None:
    """The system that estimates users in motion; None if it cannot use these devices."""
    system = load_system(DEFAULT_SYSTEM)
    try:
        system.usable(names)
    except InputError:
        return None
    return system
