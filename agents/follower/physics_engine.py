"""The engine of a kinematic system with physics: a tracker follows the system's poses."""

from __future__ import annotations

from collections import deque

import numpy as np

from agents.agent import Agent
from agents.follower.engines import SimulatedEngine
from agents.follower.moving import MOVES_M_S, level_speed
from agents.follower.states import AvatarState, between_poses, between_qpos
from agents.follower.system_poses import SystemPoses, live_set
from agents.kinematic.interface import KinematicSystem
from agents.kinematic.physics_behind import BEGINNING_FRAMES
from envs.config import EnvConfig
from envs.objects import WorldObject
from envs.stream import AHEAD
from questsim.body import DEFAULT_HEIGHT_M, build_body
from questsim.joint_sensors import SENSOR_FPS
from questsim.motion.clip import FPS
from questsim.motion.inverse_dynamics import InverseDynamics
from questsim.motion.kinematics import clip_from_qpos
from questsim.motion.motion import Motion

_POSES = 5
"""Number of poses from which velocity and acceleration of the middle one are computed."""


class PhysicsEngine(SimulatedEngine):
    """A tracker follows the poses of a kinematic system on simulated physics.

    Args:
        system: reads devices at 60 Hz.
        tracker: reads a full-body reference, at 36 Hz.
        sensors: as of ``PoseEngine``.
        objects: on the ground before the avatar.

    Raises:
        InputError: the system cannot use these devices, or they are IMUs.
    """

    rate_hz = SENSOR_FPS

    def __init__(
        self,
        system: KinematicSystem,
        tracker: Agent,
        sensors: str | None = None,
        objects: tuple[WorldObject, ...] = (),
    ) -> None:
        self.names = live_set(system, sensors)
        self._system = system
        needs = tracker.needs
        config = EnvConfig(
            sensors="H",
            future_frames=needs.future_frames,
            privileged=needs.privileged,
            body_preset=needs.body_preset,
            observe_proportions=needs.observe_proportions,
            objects=objects,
        )
        super().__init__(tracker, config)
        # Sources of delay: the velocity of a reference frame needs the next one (the step wins one
        # back), frames of 60 and 36 Hz do not coincide, and states are interpolated.
        self._late = system.future_frames / SENSOR_FPS
        self.latency_s = AHEAD / FPS + 1.0 / SENSOR_FPS + self._late

    def build(self, height_m: float) -> None:
        """See ``Engine``."""
        super().build(height_m)
        self._poses = SystemPoses(self._system, self.names, height_m)
        self._dynamics = InverseDynamics()
        self._limits = build_body().torque_limits

    def begin(self, position: np.ndarray, quat: np.ndarray) -> None:
        """See ``Engine``."""
        self._poses.reset()
        self._pose: Motion | None = None
        self._count, self._frame = 0, 0
        self._last: list[np.ndarray] = []
        self._users = [(position, quat)] * (AHEAD + 1)
        self._heads: deque[np.ndarray] = deque(maxlen=round(FPS))
        self._blend = 0

    def moving_user(self) -> tuple[np.ndarray, np.ndarray] | None:
        """See ``Engine``; the system has estimated this state."""
        if level_speed(self._heads) < MOVES_M_S or self._blend:
            return None
        return self._sim.shown_pose()

    def put(self, qpos: np.ndarray, qvel: np.ndarray, in_motion: bool = False) -> None:
        """See ``Engine``; the reference blends from a pose at rest to the system's."""
        super().put(qpos, qvel)
        if in_motion:
            return  # the reference moves already as the user does
        self._last = [qpos.copy() for _ in range(_POSES)]
        still = clip_from_qpos("pose", np.array(self._last), self.height_m)
        self._sim.show_pose(still, 1, None, fill=True)
        self._start, self._blend = qpos.copy(), BEGINNING_FRAMES

    def user_devices(self) -> tuple[np.ndarray, np.ndarray]:
        """See ``Engine``; the step has used the first of the kept ones."""
        return self._users[1]

    def feed(
        self, time_s: float, position: np.ndarray, quat: np.ndarray, present: np.ndarray
    ) -> AvatarState | None:
        """See ``Engine``."""
        pose = self._poses.feed(position, quat, present)
        before, self._pose = self._pose or pose, pose
        moment = self._count / SENSOR_FPS
        due = self._frame / FPS
        self._count += 1
        if due > moment + 1e-9:
            return None
        share = 1.0 - (moment - due) * SENSOR_FPS
        self._frame += 1
        qpos = self._poses.retargeted(between_poses(before, pose, share))
        self._users = [*self._users[1:], (position, quat)]
        self._heads.append(position[0].copy())
        self._show(qpos)
        headset = self._users[0][0][0], self._users[0][1][0]
        late_s = moment - due + self._late + (AHEAD - 1) / FPS
        return self._step(headset, time_s - late_s)

    def _show(self, qpos: np.ndarray) -> None:
        """Advance the tracker's window by the last pose that has both neighbours."""
        if self._blend:
            share = 1.0 - self._blend / (BEGINNING_FRAMES + 1)
            qpos = between_qpos(self._start, qpos, share)
            self._blend -= 1
        self._last = [*self._last[1:], qpos]
        clip = clip_from_qpos("poses", np.array(self._last), self.height_m)
        common = clip.scaled(DEFAULT_HEIGHT_M)
        acceleration = 0.5 * FPS * (common.qvel[3] - common.qvel[1])
        forces = self._dynamics.at(common.qpos[2], common.qvel[2], acceleration)
        self._sim.show_pose(clip, _POSES - 2, forces[6:] / self._limits)
