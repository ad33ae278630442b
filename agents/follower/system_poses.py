"""A kinematic system on a live stream: its devices and its poses on the avatar."""

from __future__ import annotations

import numpy as np

from agents.kinematic.interface import KinematicSystem, UserBody
from agents.kinematic.physics_behind import on_own_body
from questsim.errors import InputError
from questsim.joint_sensors import SENSOR_FPS, SensorFrame
from questsim.motion.kinematics import standing_clip
from questsim.motion.motion import Motion
from questsim.motion.retarget_back import to_motion
from questsim.motion.retarget_stream import StreamRetargeter
from questsim.sensors import DEVICES

_PREFERRED = ("H+2C", "4T", "6T", "H")
"""Default sensor sets of systems."""


class SystemPoses:
    """Runs a kinematic system on a device stream, with the user's bones.

    Args:
        system: the system.
        names: its devices.
        height_m: the user's stature; the bones are the avatar's proportions of it.
    """

    def __init__(self, system: KinematicSystem, names: tuple[str, ...], height_m: float) -> None:
        self._system, self._names = system, names
        self._user = to_motion(standing_clip(height_m, 2))
        self._retarget = StreamRetargeter(self._user, height_m)
        self.reset()

    def reset(self) -> None:
        """Reset the system for a new stream."""
        self._system.reset(UserBody.of(self._user), self._names)
        self._retarget.reset()
        self._count = 0

    def feed(self, position: np.ndarray, quat: np.ndarray, present: np.ndarray) -> Motion:
        """The pose (one frame) after the next moment of the devices."""
        if self._system.interpolates_dropouts or not self._count:
            present = np.ones(len(self._names), bool)
        frame = SensorFrame(
            self._count / SENSOR_FPS, self._names, position, quat, np.zeros_like(position), present
        )
        self._count += 1
        return on_own_body(self._system.step(frame), self._user)

    def retargeted(self, pose: Motion) -> np.ndarray:
        """The avatar's ``qpos`` ``(40,)``."""
        return self._retarget(pose)[0]


def live_set(system: KinematicSystem, sensors: str | None) -> tuple[str, ...]:
    """The devices used with a system on a live stream.

    Raises:
        InputError: it cannot use them, or they are IMUs, which no headset has.
    """
    if sensors is None:
        usable = [name for name in _PREFERRED if _fits(system, name)]
        if not usable:
            raise InputError(
                f"{system.name} supports no set of devices of a live stream", "Follower"
            )
        sensors = usable[0]
    names = system.usable(sensors)
    imus = [name for name in names if DEVICES[name].kind == "imu"]
    if imus:
        raise InputError(
            f"{imus[0]} cannot be part of a live stream", "sensors", "use a set without"
        )
    return names


def _fits(system: KinematicSystem, sensors: str) -> bool:
    try:
        live_set(system, sensors)
    except InputError:
        return False
    return True
