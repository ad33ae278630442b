"""Signals of the devices of ``sensors``, worn on the 22 joints of a ``Motion``.

A device is mounted on a joint with a fixed offset and rotation, known from calibration.
``readings`` computes its signals from a motion; ``joint_poses`` undoes the mounting.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M
from questsim.errors import InputError
from questsim.motion.checks import stature_of
from questsim.motion.limbs import ARM_REST
from questsim.motion.motion import Motion
from questsim.sensors import DEVICES, imu_signal
from questsim.skeleton import JOINTS

SENSOR_FPS = 60.0
"""Frames a second of the kinematic systems."""

# Place of the motion's head joint in the avatar's head link, which begins at the neck.
_HEAD_IN_LINK = np.array([0.01, 0.0, 0.09])
_LINK_TO_JOINT = {
    "head": "head", "pelvis": "root",
    "left_hand": "left_wrist", "right_hand": "right_wrist",
    "left_foot": "left_ankle", "right_foot": "right_ankle",
    "left_shin": "left_knee", "right_shin": "right_knee",
}  # fmt: skip
_IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Mount:
    """Mounting of a device on a user.

    Attributes:
        joint: index of the joint among the 22.
        offset: ``(3,)`` metres from the joint, in its frame.
        turn: ``(4,)`` the device's orientation in the joint's frame.
    """

    joint: int
    offset: np.ndarray
    turn: np.ndarray


def mount(name: str, offsets: np.ndarray) -> Mount:
    """Mounting of a device on a user with offsets ``(22, 3)``.

    Raises:
        InputError: an unknown device.
    """
    if name not in DEVICES:
        raise InputError(f"unknown tracker {name!r}", fix=f"known are {', '.join(DEVICES)}")
    device = DEVICES[name]
    ratio = stature_of(offsets) / DEFAULT_HEIGHT_M
    place = np.array(device.offset) * ratio
    turn = _IDENTITY
    if device.link == "head":
        place = place - _HEAD_IN_LINK * ratio
    elif device.link == "pelvis":
        hips = offsets[[JOINTS.index("left_hip"), JOINTS.index("right_hip")]]
        place = place + hips.mean(axis=0)
    elif device.link.endswith("hand"):
        turn = ARM_REST[device.link.split("_")[0]]
        place = rot.quat_rotate(turn, place)
    return Mount(JOINTS.index(_LINK_TO_JOINT[device.link]), place, turn)


@dataclass(frozen=True)
class SensorFrame:
    """One frame of a stream.

    Attributes:
        time_s: seconds since the stream began.
        names: ``D`` devices of ``sensors.DEVICES``.
        position: ``(D, 3)`` metres in the world; ignored for IMUs.
        quat: ``(D, 4)`` orientations wxyz.
        acceleration: ``(D, 3)`` m/s^2 in the world without gravity; used for IMUs only.
        present: ``(D,)`` bool, whether the device reports in this frame.
    """

    time_s: float
    names: tuple[str, ...]
    position: np.ndarray
    quat: np.ndarray
    acceleration: np.ndarray
    present: np.ndarray


@dataclass(frozen=True)
class SensorSequence:
    """``T`` frames of a stream; the arrays of ``SensorFrame`` with a leading axis of time."""

    time_s: np.ndarray
    names: tuple[str, ...]
    position: np.ndarray
    quat: np.ndarray
    acceleration: np.ndarray
    present: np.ndarray

    def __len__(self) -> int:
        return len(self.time_s)

    def __getitem__(self, frame: int) -> SensorFrame:
        return SensorFrame(
            float(self.time_s[frame]),
            self.names,
            self.position[frame],
            self.quat[frame],
            self.acceleration[frame],
            self.present[frame],
        )


def readings(motion: Motion, names: Sequence[str]) -> SensorSequence:
    """Device signals of a motion, at the motion's frame rate, without noise.

    Accelerations are causal; see ``sensors.imu_signal``.

    Args:
        motion: the motion; resample it to ``SENSOR_FPS`` for a kinematic system.
        names: names of the devices.

    Raises:
        InputError: an unknown device.
    """
    joints, orientations = motion.forward_kinematics()
    mounts = [mount(name, motion.offsets) for name in names]
    at = [m.joint for m in mounts]
    turned = orientations[:, at]
    position = joints[:, at] + rot.quat_rotate(turned, np.array([m.offset for m in mounts]))
    quat = rot.quat_multiply(turned, np.array([m.turn for m in mounts]))
    return SensorSequence(
        time_s=np.arange(len(motion)) / motion.fps,
        names=tuple(names),
        position=position,
        quat=quat,
        acceleration=imu_signal(position, quat, motion.fps).acceleration,
        present=np.ones((len(motion), len(names)), bool),
    )


def joint_poses(
    position: np.ndarray, quat: np.ndarray, mounts: Sequence[Mount]
) -> tuple[np.ndarray, np.ndarray]:
    """Poses of the joints that carry devices: positions ``(..., D, 3)``, quats ``(..., D, 4)``.

    Args:
        position: ``(..., D, 3)`` of the devices.
        quat: ``(..., D, 4)``.
        mounts: of each device.
    """
    turn = np.array([m.turn for m in mounts])
    joint = rot.quat_multiply(quat, rot.quat_conjugate(turn))
    return position - rot.quat_rotate(joint, np.array([m.offset for m in mounts])), joint
