"""The face that every kinematic system shows: reset, step a frame, or predict a whole sequence.

What is wrong with a stream is treated alike by all of them:

- refused (``InputError``): an unknown device, a set of devices the system cannot use, a frame of
  other devices than ``reset`` was told, numbers that are not finite or quaternions that are not of
  unit length where a device reports, time that does not go forward;
- bridged: a gap of up to ``MAX_GAP_S`` is filled with interpolated frames; after a longer one the
  system forgets what was before and goes on. A device that does not report keeps its last pose
  where the system needs it; DragPoser leaves it out instead;
- a pose is always finite: where a system's answer is not, the last good one is given again.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from agents.kinematic.scenario import SIX_TRACKERS, Scenario
from questsim.errors import InputError
from questsim.joint_sensors import (
    SENSOR_FPS,
    SensorFrame,
    SensorSequence,
    joint_poses,
    mount,
)
from questsim.motion.checks import stature_of
from questsim.motion.motion import Motion, joint_kinematics
from questsim.sensors import DEVICES, SENSOR_SETS
from questsim.skeleton import NUM_JOINTS

MAX_GAP_S = 0.5
"""Longer gaps in a stream are not bridged: the system begins anew."""
UNIT_TOLERANCE = 1e-2


@dataclass(frozen=True)
class UserBody:
    """What is known of the user's body.

    Attributes:
        offsets: ``(22, 3)`` each joint's position in its parent's frame, as in ``Motion``.
    """

    offsets: np.ndarray

    def __post_init__(self) -> None:
        offsets = np.asarray(self.offsets, float)
        if offsets.shape != (NUM_JOINTS, 3) or not np.isfinite(offsets).all():
            raise InputError(f"a body's offsets are not {NUM_JOINTS} x 3 finite numbers", "body")
        if not stature_of(offsets) > 0.5:
            raise InputError("a body is less than 0.5 m tall", "body", "give metres")

    @staticmethod
    def of(motion: Motion) -> UserBody:
        """The body of a recorded person."""
        return UserBody(motion.offsets)


@dataclass(frozen=True)
class Poses:
    """Poses of ``T`` frames on the 22 joints; a single pose has ``T`` = 1.

    Attributes:
        root_position: ``(T, 3)`` metres in the world.
        rotations: ``(T, 22, 4)`` unit quaternions wxyz, as in ``Motion``.
        offsets: ``(T, 22, 3)`` the body they are of: as measured, or as the system estimates it.
    """

    root_position: np.ndarray
    rotations: np.ndarray
    offsets: np.ndarray

    def __len__(self) -> int:
        return len(self.root_position)

    def finite(self) -> bool:
        """Whether all numbers are."""
        arrays = (self.root_position, self.rotations, self.offsets)
        return all(bool(np.isfinite(array).all()) for array in arrays)

    def forward_kinematics(self) -> tuple[np.ndarray, np.ndarray]:
        """World positions ``(T, 22, 3)`` and orientations ``(T, 22, 4)``."""
        return joint_kinematics(self.root_position, self.rotations, self.offsets)

    @staticmethod
    def joined(parts: Sequence[Poses]) -> Poses:
        """One after the other."""
        return Poses(
            np.concatenate([p.root_position for p in parts]),
            np.concatenate([p.rotations for p in parts]),
            np.concatenate([p.offsets for p in parts]),
        )

    def to_motion(self, name: str, fps: float = SENSOR_FPS) -> Motion:
        """A ``Motion``, of the mean of the bodies."""
        return Motion(name, fps, self.root_position, self.rotations, self.offsets.mean(axis=0))


@dataclass(frozen=True)
class DeviceSignals:
    """What a system reads: poses of the joints that carry its devices, by device.

    Attributes:
        position: ``(T, D, 3)`` of the joints; quat: ``(T, D, 4)``.
        acceleration: ``(T, D, 3)`` of the devices.
        present: ``(T, D)`` bool.
    """

    position: np.ndarray
    quat: np.ndarray
    acceleration: np.ndarray
    present: np.ndarray


class KinematicSystem(ABC):
    """A system that turns device signals at 60 Hz into poses.

    Attributes:
        name: for messages and tables.
        devices: every device it can read, in the order of its ``DeviceSignals``.
        required: those it cannot do without.
        scenarios: what it is given in a comparison.
        future_frames: how many later frames a pose waits for; ``step`` answers that much late.
    """

    name: str = ""
    devices: tuple[str, ...] = ()
    required: tuple[str, ...] = ()
    future_frames: int = 0
    scenarios: tuple[Scenario, ...] = SIX_TRACKERS
    interpolates_dropouts: bool = True
    """Whether a silent device keeps its last pose, rather than being left out."""

    _names: tuple[str, ...] | None = None

    # -- what a caller uses ----------------------------------------------------------------

    def usable(self, sensors: str | Sequence[str]) -> tuple[str, ...]:
        """The devices of a set that this system can use.

        Raises:
            InputError: unknown devices, or the set lacks what the system needs or has what it
                cannot read.
        """
        names = device_names(sensors)
        missing = [name for name in self.required if name not in names]
        extra = [name for name in names if name not in self.devices]
        if missing or extra:
            what = f"needs {missing[0]}" if missing else f"cannot use {extra[0]}"
            raise InputError(f"{self.name} {what}", "sensors", f"it reads {self.describe()}")
        return names

    def describe(self) -> str:
        """The sensors in words, for messages and the list of agents."""
        optional = [name for name in self.devices if name not in self.required]
        text = ", ".join(self.required)
        return text + (f" and, if there, {', '.join(optional)}" if optional else "")

    def reset(self, body: UserBody, sensors: str | Sequence[str]) -> None:
        """Begin a stream.

        Args:
            body: the user's, as measured or calibrated.
            sensors: a set of ``questsim.sensors``, or devices in the order frames will have.

        Raises:
            InputError: see ``usable``.
        """
        self._names = self.usable(sensors)
        self._body = body
        self._mounts = [mount(name, body.offsets) for name in self._names]
        self._last: SensorFrame | None = None
        self._pose: Poses | None = None
        self._begin(body)

    def step(self, frame: SensorFrame) -> Poses:
        """The pose (``T`` = 1) after one more frame, in constant time and memory.

        With ``future_frames`` it is the pose of that many frames ago; before there are so many,
        that of the first frame.

        Raises:
            InputError: a frame that is refused; the stream can go on with the next one.
        """
        frame = self._accepted(frame)
        for missed in self._bridged(frame):
            self._answer(missed)
        pose = self._answer(frame)
        self._last = frame
        return pose

    def predict(self, sequence: SensorSequence, body: UserBody) -> Poses:
        """Poses of all frames of a sequence; the same ones as ``step`` gives one by one.

        With ``future_frames`` the last frames are held, so that every frame gets its pose.

        Raises:
            InputError: as ``reset`` and ``step``.
        """
        self.reset(body, sequence.names)
        if not len(sequence):
            raise InputError("a sequence has no frames", self.name)
        poses = [self.step(sequence[t]) for t in range(len(sequence))]
        last = sequence[len(sequence) - 1]
        for extra in range(1, self.future_frames + 1):
            poses.append(self.step(replace(last, time_s=last.time_s + extra / SENSOR_FPS)))
        return Poses.joined(poses[self.future_frames :])

    # -- what a system supplies ------------------------------------------------------------

    @abstractmethod
    def _begin(self, body: UserBody) -> None:
        """Forget everything; a stream of this body begins."""

    @abstractmethod
    def _next(self, signals: DeviceSignals) -> Poses:
        """The pose after one more frame (``T`` = 1)."""

    # -- checks ----------------------------------------------------------------------------

    def _accepted(self, frame: SensorFrame) -> SensorFrame:
        """The frame, quaternions of exactly unit length, silent devices filled in.

        Raises:
            InputError: see the module's text.
        """
        if self._names is None:
            raise InputError("reset comes before step", self.name)
        check_frame(frame, self._names, self.name)
        last = self._last
        if last is not None and not frame.time_s > last.time_s:
            raise InputError(
                f"time goes from {last.time_s:.4f} to {frame.time_s:.4f} s",
                self.name,
                "send frames in order, or reset",
            )
        present = np.asarray(frame.present, bool)
        if last is None and self.interpolates_dropouts and not present.all():
            silent = self._names[int(np.argmin(present))]
            raise InputError(f"{silent} does not report in the first frame", self.name)
        filler = last if last is not None else _still(len(self._names))
        keep = present[:, None]
        quat = np.where(keep, frame.quat, filler.quat)
        quat = quat / np.linalg.norm(quat, axis=-1, keepdims=True)
        return replace(
            frame,
            position=np.where(keep, frame.position, filler.position),
            quat=quat,
            acceleration=np.where(keep, frame.acceleration, 0.0),
            present=present,
        )

    def _bridged(self, frame: SensorFrame) -> list[SensorFrame]:
        """The frames that are missing before ``frame``; a long gap makes the system forget."""
        last = self._last
        if last is None:
            return []
        gap = frame.time_s - last.time_s
        if gap > MAX_GAP_S:
            self._begin(self._body)
            return []
        missing = round(gap * SENSOR_FPS) - 1
        shares = [k / (missing + 1) for k in range(1, missing + 1)]
        return [between(last, frame, share) for share in shares]

    def _answer(self, frame: SensorFrame) -> Poses:
        position, quat = joint_poses(frame.position, frame.quat, self._mounts)
        signals = DeviceSignals(
            position[None], quat[None], frame.acceleration[None], frame.present[None]
        )
        pose = self._next(signals)
        if not pose.finite():
            self._begin(self._body)
            pose = self._pose if self._pose is not None else self._rest(signals)
        self._pose = pose
        return pose

    def _rest(self, signals: DeviceSignals) -> Poses:
        """Standing straight where the first device is: there is nothing better to say."""
        rotations = np.zeros((1, NUM_JOINTS, 4))
        rotations[..., 0] = 1.0
        root = np.where(np.isfinite(signals.position[:, 0]), signals.position[:, 0], 0.0)
        return Poses(root, rotations, self._body.offsets[None])


def device_names(sensors: str | Sequence[str]) -> tuple[str, ...]:
    """The devices of a named set, or those listed.

    Raises:
        InputError: no such set or device.
    """
    if isinstance(sensors, str):
        if sensors not in SENSOR_SETS:
            raise InputError(
                f"unknown sensor set {sensors!r}", fix=f"choose from {', '.join(SENSOR_SETS)}"
            )
        return SENSOR_SETS[sensors]
    for name in sensors:
        if name not in DEVICES:
            raise InputError(f"unknown tracker {name!r}", fix=f"known are {', '.join(DEVICES)}")
    if len(set(sensors)) != len(sensors):
        raise InputError("a tracker is listed twice", "sensors")
    return tuple(sensors)


def check_frame(frame: SensorFrame, names: tuple[str, ...], where: str) -> None:
    """Refuse a frame of other devices, or with numbers that are none.

    Raises:
        InputError: naming the device.
    """
    if tuple(frame.names) != names:
        raise InputError(
            f"a frame has {', '.join(frame.names)} instead of {', '.join(names)}", where
        )
    shapes = {"position": (3,), "quat": (4,), "acceleration": (3,), "present": ()}
    for field, shape in shapes.items():
        found = np.shape(getattr(frame, field))
        if found != (len(names), *shape):
            raise InputError(f"{field} has shape {found}, not {(len(names), *shape)}", where)
    if not np.isfinite(frame.time_s):
        raise InputError("a frame's time is not finite", where)
    for i, name in enumerate(names):
        if not frame.present[i]:
            continue
        read = ("quat", "acceleration") if DEVICES[name].kind == "imu" else ("position", "quat")
        for field in read:
            if not np.isfinite(getattr(frame, field)[i]).all():
                raise InputError(f"{field} of {name} is not finite", where)
        length = float(np.linalg.norm(frame.quat[i]))
        if abs(length - 1.0) > UNIT_TOLERANCE:
            raise InputError(f"quaternion of {name} has length {length:.3g}, not 1", where)


def between(a: SensorFrame, b: SensorFrame, share: float) -> SensorFrame:
    """A frame between two: positions on a line, rotations by normalised interpolation."""
    sign = np.where((a.quat * b.quat).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    quat = (1 - share) * a.quat + share * sign * b.quat
    return replace(
        b,
        time_s=(1 - share) * a.time_s + share * b.time_s,
        position=(1 - share) * a.position + share * b.position,
        quat=quat / np.linalg.norm(quat, axis=-1, keepdims=True),
        acceleration=(1 - share) * a.acceleration + share * b.acceleration,
    )


def _still(devices: int) -> SensorFrame:
    quat = np.zeros((devices, 4))
    quat[:, 0] = 1.0
    zero = np.zeros((devices, 3))
    return SensorFrame(0.0, (), zero, quat, zero, np.zeros(devices, bool))
