"""Kinematic system with physics in a live session: a tracker follows the system's poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from agents.agent import Agent, Needs
from agents.kinematic.interface import KinematicSystem, UserBody
from agents.kinematic.physics_behind import begun_as, reference_of
from agents.live.drivers import TorqueDriver
from agents.live.poses import LEFT_OPEN, PoseDriver
from envs.config import EnvConfig
from questsim.joint_sensors import SENSOR_FPS, readings
from questsim.motion.clip import Clip
from questsim.motion.kinematics import clip_from_qpos
from questsim.motion.motion import Motion


class PhysicsDriver(TorqueDriver):
    """Drives by the torques of a tracker that follows a kinematic system's poses.

    When a clip is chosen, the system estimates the poses of the whole clip. The tracker reads as
    many future frames as in an evaluation.

    Args:
        system: reads the user's devices at 60 Hz.
        tracker: observes the system's poses as its reference.
        recording: returns the user's motion of a clip by name, the source of the device signals.
    """

    def __init__(
        self, system: KinematicSystem, tracker: Agent, recording: Callable[[str], Motion]
    ) -> None:
        super().__init__(tracker)
        self._system, self._recording = system, recording
        self._worn = PoseDriver(system, recording)
        self._made: tuple[tuple[str, float, str], Clip] | None = None

    @property
    def needs(self) -> Needs:
        """The tracker's environment with the devices of the system."""
        return replace(self.agent.needs, sensors=self._worn.needs.sensors)

    def sensor_sets(self) -> tuple[str, ...]:
        """Names of the sensor sets that the system can read, IMUs included."""
        return self._worn.sensor_sets()

    def config(self, sensors: str, height_m: float | None = None) -> EnvConfig:
        """The tracker's environment; it reads no devices."""
        return super().config(LEFT_OPEN, height_m)

    def shown(self, clip: Clip, sensors: str) -> list[Clip]:
        """The system's poses of the clip's user, on the avatar of the same stature."""
        key = clip.name, clip.height_m, sensors
        if self._made is None or self._made[0] != key:
            self._made = key, self._estimate(clip, sensors)
        return [self._made[1]]

    def _estimate(self, clip: Clip, sensors: str) -> Clip:
        user = self._recording(clip.name).resampled(SENSOR_FPS)
        devices = self._system.usable(sensors)
        poses = self._system.predict(readings(user, devices), UserBody.of(user))
        estimate = reference_of(poses, user)
        # Resampling by way of 60 Hz may lose the last frame.
        rows = np.minimum(np.arange(len(clip)), len(estimate) - 1)
        qpos = estimate.qpos[rows]
        whole = clip_from_qpos(clip.name, qpos, estimate.height_m).scaled(clip.height_m)
        return begun_as(whole, clip)
