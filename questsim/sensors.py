"""Headset, controllers, trackers and IMUs as rigid offsets from the links that carry them.

A device's frame is aligned with its link's in the zero pose: x forward, y left, z up, when the user
stands upright with arms hanging. Offsets are those of the 1.75 m body and scale with height.
Signals are synthetic, as in QuestSim: constant offsets, and no noise by default.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M
from questsim.errors import InputError, value_text
from questsim.skeleton import LINKS


@dataclass(frozen=True)
class Device:
    """A sensor on a link.

    Attributes:
        kind: ``"headset"``, ``"controller"``, ``"tracker"`` (6 DoF) or ``"imu"`` (orientation,
            angular velocity, acceleration; no position).
        link: name of the link that carries it.
        offset: metres from the link's origin, in the link's frame, on the 1.75 m body.
    """

    kind: str
    link: str
    offset: tuple[float, float, float]


DEVICES: dict[str, Device] = {
    "headset": Device("headset", "head", (0.12, 0.0, 0.19)),
    "left_controller": Device("controller", "left_hand", (0.0, 0.0, -0.08)),
    "right_controller": Device("controller", "right_hand", (0.0, 0.0, -0.08)),
    "pelvis_tracker": Device("tracker", "pelvis", (-0.09, 0.0, 0.08)),
    "left_foot_tracker": Device("tracker", "left_foot", (0.05, 0.0, 0.01)),
    "right_foot_tracker": Device("tracker", "right_foot", (0.05, 0.0, 0.01)),
    "left_toe_tracker": Device("tracker", "left_foot", (0.13, 0.0, -0.03)),
    "right_toe_tracker": Device("tracker", "right_foot", (0.13, 0.0, -0.03)),
    "pelvis_imu": Device("imu", "pelvis", (-0.09, 0.0, 0.08)),
    "left_knee_imu": Device("imu", "left_shin", (0.05, 0.0, -0.05)),
    "right_knee_imu": Device("imu", "right_shin", (0.05, 0.0, -0.05)),
}

_HEAD_AND_HANDS = ("headset", "left_controller", "right_controller")
SENSOR_SETS: dict[str, tuple[str, ...]] = {
    "H": ("headset",),
    "H+2C": _HEAD_AND_HANDS,
    "H+2C+2IMU": (*_HEAD_AND_HANDS, "left_knee_imu", "right_knee_imu"),
    "H+2C+3IMU": (*_HEAD_AND_HANDS, "pelvis_imu", "left_knee_imu", "right_knee_imu"),
    "6T": (*_HEAD_AND_HANDS, "pelvis_tracker", "left_toe_tracker", "right_toe_tracker"),
    "4T": (*_HEAD_AND_HANDS, "pelvis_tracker"),
    "3T": _HEAD_AND_HANDS,
}
"""Named sets of devices, in the order in which observations list them."""


def sensor_set(name: str) -> tuple[str, ...]:
    """The devices of a named set.

    Raises:
        InputError: there is no such set.
    """
    if name not in SENSOR_SETS:
        raise InputError(
            f"unknown sensor set {name!r}", fix=f"choose from {', '.join(SENSOR_SETS)}"
        )
    return SENSOR_SETS[name]


def device_poses(
    link_position: np.ndarray,
    link_quat: np.ndarray,
    names: Sequence[str],
    height_m: float = DEFAULT_HEIGHT_M,
) -> tuple[np.ndarray, np.ndarray]:
    """World poses of devices on an avatar.

    Args:
        link_position: ``(..., 16, 3)`` metres.
        link_quat: ``(..., 16, 4)`` wxyz.
        names: devices, e.g. ``SENSOR_SETS["H+2C"]``.
        height_m: the avatar's stature, which scales the offsets.

    Returns:
        positions ``(..., D, 3)`` in metres and orientations ``(..., D, 4)``.
    """
    links = [LINKS.index(DEVICES[name].link) for name in names]
    offsets = np.array([DEVICES[name].offset for name in names]) * (height_m / DEFAULT_HEIGHT_M)
    quat = np.asarray(link_quat, float)[..., links, :]
    position = np.asarray(link_position, float)[..., links, :] + rot.quat_rotate(quat, offsets)
    return position, quat


@dataclass(frozen=True)
class ImuSignal:
    """Signals of IMUs over ``T`` frames, all in the world's axes.

    Attributes:
        quat: ``(T, D, 4)`` orientation.
        angular_velocity: ``(T, D, 3)`` rad/s.
        acceleration: ``(T, D, 3)`` m/s^2, gravity removed.
    """

    quat: np.ndarray
    angular_velocity: np.ndarray
    acceleration: np.ndarray


def imu_signal(position: np.ndarray, quat: np.ndarray, fps: float) -> ImuSignal:
    """Causal IMU readings from poses ``(T, D, 3)``, ``(T, D, 4)``.

    Acceleration is the backward second difference, angular velocity the backward difference;
    the device is at rest before the first frame.
    """
    before = np.concatenate([position[:1], position[:1], position])
    acceleration = (before[2:] - 2.0 * before[1:-1] + before[:-2]) * fps**2
    acceleration[:2] = 0.0
    previous = np.concatenate([quat[:1], quat[:-1]])
    delta = rot.quat_multiply(quat, rot.quat_conjugate(previous))
    rotvec = rot.as_rotation(delta).as_rotvec().reshape(position.shape)
    return ImuSignal(np.array(quat, float), rotvec * fps, acceleration)


@dataclass(frozen=True)
class SensorNoise:
    """Sensor noise of the devices; none by default.

    Attributes:
        position_std_m: standard deviation of white noise on every coordinate.
        rotation_std_rad: standard deviation of a white rotation vector.
        latency_frames: latency of every signal in frames.
        dropout: probability per frame that a dropout of a device begins.
        dropout_frames: duration of a dropout; the device then repeats its last pose.
        mount_m: greatest distance of a device from its nominal mount, constant in a clip.
        mount_rad: greatest angle from its nominal mount.

    Raises:
        InputError: a value is negative, not finite or not a number, a probability is above 1, or a
            number of frames is not whole.
    """

    position_std_m: float = 0.0
    rotation_std_rad: float = 0.0
    latency_frames: int = 0
    dropout: float = 0.0
    dropout_frames: int = 36
    mount_m: float = 0.0
    mount_rad: float = 0.0

    def __post_init__(self) -> None:
        for option in fields(self):
            value, whole = getattr(self, option.name), option.name.endswith("_frames")
            most = 1.0 if option.name == "dropout" else np.inf
            kinds = (int, np.integer) if whole else (int, float, np.number)
            good = isinstance(value, kinds) and not isinstance(value, bool)
            if not (good and 0 <= float(value) <= most and np.isfinite(float(value))):
                takes = "a whole number from 0 on" if whole else "a number from 0 on"
                takes = "a probability from 0 to 1" if most == 1.0 else takes
                what = f"{option.name} is {value_text(value)}; it takes {takes}"
                raise InputError(what, "noise")

    def apply(
        self, position: np.ndarray, quat: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Copies of a clip's device poses ``(T, D, 3)`` and ``(T, D, 4)`` with noise."""
        frames, devices = position.shape[:2]
        late = np.maximum(np.arange(frames) - self.latency_frames, 0)
        if self.mount_m or self.mount_rad:
            position, quat = self._mounted(position, quat, rng)
        position = position[late] + rng.normal(0.0, 1.0, position.shape) * self.position_std_m
        turn = rot.from_rotvec(rng.normal(0.0, 1.0, (frames * devices, 3)) * self.rotation_std_rad)
        quat = rot.quat_multiply(rot.as_quat(turn, (frames, devices)), quat[late])
        for device in range(devices):
            shown = self._shown_frames(frames, rng)
            position[:, device] = position[shown, device]
            quat[:, device] = quat[shown, device]
        return position, quat

    def _mounted(
        self, position: np.ndarray, quat: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Poses of devices with mounting errors."""
        devices = position.shape[1]
        offset, turn = rng.normal(0.0, 1.0, (2, devices, 3))
        size = rng.random((2, devices, 1))
        offset *= self.mount_m * size[0] / np.linalg.norm(offset, axis=-1, keepdims=True)
        turn *= self.mount_rad * size[1] / np.linalg.norm(turn, axis=-1, keepdims=True)
        turned = rot.as_quat(rot.from_rotvec(turn))
        return position + rot.quat_rotate(quat, offset), rot.quat_multiply(quat, turned)

    def _shown_frames(self, frames: int, rng: np.random.Generator) -> np.ndarray:
        """For each frame, the frame of the delivered pose ``(T,)``."""
        shown, silent_until = np.arange(frames), -1
        falls_silent = rng.random(frames) < self.dropout
        for frame in range(1, frames):
            if frame > silent_until and falls_silent[frame]:
                silent_until = frame + self.dropout_frames - 1
            if frame <= silent_until:
                shown[frame] = shown[frame - 1]
        return shown
