"""The interface of all kinematic systems: reset, step one frame, or predict a whole sequence.

All systems handle faults in a stream in the same way:

- Refused with ``InputError``: unknown devices, a set of devices that the system cannot use, frames
  with devices other than those of ``reset``, non-finite values or non-unit quaternions of a device
  that reports, and time that does not increase.
- Bridged: gaps of up to ``MAX_GAP_S`` are filled with interpolated frames. After a longer gap the
  system restarts with the next frame. A device that does not report keeps its last pose if the
  system needs it; DragPoser leaves it out instead.
- Poses are always finite: a non-finite estimate is replaced by the last finite one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from agents.kinematic.scenario import SIX_TRACKERS, Scenario
from agents.kinematic.user_body import UserBody
from questsim.errors import InputError
from questsim.joint_sensors import (
    SENSOR_FPS,
    SensorFrame,
    SensorSequence,
    joint_poses,
    mount,
)
from questsim.motion.motion import Motion, joint_kinematics
from questsim.sensors import DEVICES, sensor_set
from questsim.skeleton import NUM_JOINTS

MAX_GAP_S = 0.5
"""Longest gap in a stream in s that is bridged; after a longer one the system restarts."""
UNIT_TOLERANCE = 1e-2


@dataclass(frozen=True)
class Poses:
    """Poses of ``T`` frames on the 22 joints; a single pose has ``T`` = 1.

    Attributes:
        root_position: ``(T, 3)`` metres in the world.
        rotations: ``(T, 22, 4)`` unit quaternions wxyz, as in ``Motion``.
        offsets: ``(T, 22, 3)`` of the body, as measured or as estimated by the system.
    """

    root_position: np.ndarray
    rotations: np.ndarray
    offsets: np.ndarray

    def __len__(self) -> int:
        return len(self.root_position)

    def finite(self) -> bool:
        """Whether all values are finite."""
        arrays = (self.root_position, self.rotations, self.offsets)
        return all(bool(np.isfinite(array).all()) for array in arrays)

    def forward_kinematics(self) -> tuple[np.ndarray, np.ndarray]:
        """World positions ``(T, 22, 3)`` and orientations ``(T, 22, 4)``."""
        return joint_kinematics(self.root_position, self.rotations, self.offsets)

    @staticmethod
    def joined(parts: Sequence[Poses]) -> Poses:
        """Concatenate poses in time."""
        return Poses(
            np.concatenate([p.root_position for p in parts]),
            np.concatenate([p.rotations for p in parts]),
            np.concatenate([p.offsets for p in parts]),
        )

    def to_motion(self, name: str, fps: float = SENSOR_FPS) -> Motion:
        """Convert to a ``Motion`` with the mean body."""
        return Motion(name, fps, self.root_position, self.rotations, self.offsets.mean(axis=0))


@dataclass(frozen=True)
class DeviceSignals:
    """A system's input: for each device, the pose of the joint that carries it.

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
        devices: all devices it can use, in the order of its ``DeviceSignals``.
        required: devices it needs.
        scenarios: its scenarios in a comparison.
        future_frames: number of later frames that a pose needs; ``step`` is late by this many.
    """

    name: str = ""
    devices: tuple[str, ...] = ()
    required: tuple[str, ...] = ()
    future_frames: int = 0
    scenarios: tuple[Scenario, ...] = SIX_TRACKERS
    interpolates_dropouts: bool = True
    """Whether a device that does not report keeps its last pose; otherwise it is left out."""
    at_once: int = 1
    """Number of sequences that ``predict_many`` computes together."""

    _names: tuple[str, ...] | None = None

    # -- for callers -----------------------------------------------------------------------

    def usable(self, sensors: str | Sequence[str]) -> tuple[str, ...]:
        """The devices of a set that this system can use.

        Raises:
            InputError: unknown devices, a needed device is missing, or the system cannot read one.
        """
        names = device_names(sensors)
        missing = [name for name in self.required if name not in names]
        extra = [name for name in names if name not in self.devices]
        if missing or extra:
            what = f"needs {missing[0]}" if missing else f"cannot use {extra[0]}"
            raise InputError(f"{self.name} {what}", "sensors", f"it reads {self.describe()}")
        return names

    def describe(self) -> str:
        """Describe the sensors in words, for messages and the list of agents."""
        optional = [name for name in self.devices if name not in self.required]
        text = ", ".join(self.required)
        return text + (f" and, if present, {', '.join(optional)}" if optional else "")

    def reset(self, body: UserBody, sensors: str | Sequence[str]) -> None:
        """Start a stream.

        Args:
            body: the user's body, as measured or calibrated.
            sensors: a set of ``questsim.sensors``, or devices in the order of the frames.

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
        """The pose (``T`` = 1) after the next frame, in constant time and memory.

        With ``future_frames`` it is the pose that many frames ago; at the start of a stream, the
        pose of the first frame.

        Raises:
            InputError: the frame is refused; the stream can continue with the next one.
        """
        frame = self._accepted(frame)
        for missed in self._bridged(frame):
            self._answer(missed)
        pose = self._answer(frame)
        self._last = frame
        return pose

    def predict(self, sequence: SensorSequence, body: UserBody) -> Poses:
        """Poses of all frames of a sequence, the same as ``step`` gives frame by frame.

        With ``future_frames`` the last frame is repeated, so that every frame gets a pose.

        Raises:
            InputError: see ``reset`` and ``step``.
        """
        self.reset(body, sequence.names)
        if not len(sequence):
            raise InputError("a sequence has no frames", self.name)
        poses = [self.step(sequence[t]) for t in range(len(sequence))]
        last = sequence[len(sequence) - 1]
        for extra in range(1, self.future_frames + 1):
            poses.append(self.step(replace(last, time_s=last.time_s + extra / SENSOR_FPS)))
        return Poses.joined(poses[self.future_frames :])

    def predict_many(
        self, sequences: Sequence[SensorSequence], bodies: Sequence[UserBody]
    ) -> list[Poses]:
        """``predict`` of several sequences, at most ``at_once``; some systems are faster so.

        Raises:
            InputError: see ``predict``.
        """
        return [
            self.predict(sequence, body) for sequence, body in zip(sequences, bodies, strict=True)
        ]

    # -- for subclasses --------------------------------------------------------------------

    def _all_signals(self, sequence: SensorSequence, body: UserBody) -> DeviceSignals | None:
        """Start a stream and return the signals of all its frames, with the checks of ``step``.

        None if it has a gap, which only ``step`` bridges, or fewer than two frames.

        Raises:
            InputError: see ``step``.
        """
        gaps = np.diff(sequence.time_s) * SENSOR_FPS
        if len(sequence) < 2 or abs(gaps - 1.0).max() > 0.5:
            return None
        self.reset(body, sequence.names)
        frames = []
        for t in range(len(sequence)):
            frames.append(self._accepted(sequence[t]))
            self._last = frames[-1]
        position, quat = joint_poses(
            np.stack([f.position for f in frames]),
            np.stack([f.quat for f in frames]),
            self._mounts,
        )
        acceleration = np.stack([f.acceleration for f in frames])
        return DeviceSignals(position, quat, acceleration, np.stack([f.present for f in frames]))

    @abstractmethod
    def _begin(self, body: UserBody) -> None:
        """Reset all state and start a stream for this body."""

    @abstractmethod
    def _next(self, signals: DeviceSignals) -> Poses:
        """The pose after the next frame (``T`` = 1)."""

    # -- checks ----------------------------------------------------------------------------

    def _accepted(self, frame: SensorFrame) -> SensorFrame:
        """The checked frame with exact unit quaternions; devices that do not report are filled in.

        Raises:
            InputError: see the module's docstring.
        """
        if self._names is None:
            raise InputError("step was called before reset", self.name)
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
            raise InputError(f"{silent} has no signal in the first frame", self.name)
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
        """Interpolated frames for the gap before ``frame``; a long gap restarts the system."""
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
        """Fallback pose: standing straight at the first device."""
        rotations = np.zeros((1, NUM_JOINTS, 4))
        rotations[..., 0] = 1.0
        root = np.where(np.isfinite(signals.position[:, 0]), signals.position[:, 0], 0.0)
        return Poses(root, rotations, self._body.offsets[None])


def device_names(sensors: str | Sequence[str]) -> tuple[str, ...]:
    """The devices of a named set or of a list.

    Raises:
        InputError: no such set or device.
    """
    if isinstance(sensors, str):
        return sensor_set(sensors)
    for name in sensors:
        if name not in DEVICES:
            raise InputError(f"unknown tracker {name!r}", fix=f"known are {', '.join(DEVICES)}")
    if len(set(sensors)) != len(sensors):
        raise InputError("a tracker is listed twice", "sensors")
    return tuple(sensors)


def check_frame(frame: SensorFrame, names: tuple[str, ...], where: str) -> None:
    """Refuse frames with unexpected devices or non-finite values.

    Raises:
        InputError: names the device.
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
    """Interpolate two frames: positions linearly, rotations by normalised interpolation."""
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
