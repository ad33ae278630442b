"""One frame of a user's devices, and the coordinate conventions of the reporting programs.

Inside the project everything is right-handed with x forward, y left and z up, in metres, with
quaternions wxyz. ``DeviceFrame.of`` converts poses from a headset, game engine or log file;
``from_ours`` converts results back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from questsim import rotations as rot
from questsim.errors import InputError
from questsim.sensors import DEVICES

MAX_NUMBER = 1e9
MAX_DISTANCE_M = 1000.0
"""Positions further from the origin than this are rejected."""
UNIT_TOLERANCE = 1e-2


@dataclass(frozen=True)
class Convention:
    """Axes, unit and order of quaternions of another program.

    Attributes:
        axes: ``(3, 3)`` its axes in ours, as columns: a vector ``p`` there is ``axes @ p`` here.
        unit_m: its unit of length in metres.
        scalar_first: whether its quaternions are wxyz; otherwise xyzw.
    """

    axes: tuple[tuple[float, float, float], ...]
    unit_m: float = 1.0
    scalar_first: bool = False

    @property
    def matrix(self) -> np.ndarray:
        """``axes`` as an array."""
        return np.array(self.axes)


_OPENXR = ((0.0, 0.0, -1.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
CONVENTIONS: dict[str, Convention] = {
    # Right-handed, x forward, y left, z up.
    "questsim": Convention(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), 1.0, True),
    # Right-handed, x right, y up, z back; WebXR has the same.
    "openxr": Convention(_OPENXR),
    # OpenVR: the axes of OpenXR. Its poses are 3 x 4 matrices, which every convention accepts.
    "steamvr": Convention(_OPENXR),
    # Left-handed, x right, y up, z forward.
    "unity": Convention(((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0))),
    # Left-handed, x forward, y right, z up, centimetres.
    "unreal": Convention(((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)), 0.01),
}
"""By name: ``questsim``, ``openxr``, ``steamvr``, ``unity``, ``unreal``."""


class DevicePose(NamedTuple):
    """Pose of a device in our convention.

    Attributes:
        position: ``(3,)`` metres.
        quat: ``(4,)`` unit quaternion wxyz. The device's axes follow the same convention as the
            world's: a headset that looks along x has the identity.
    """

    position: np.ndarray
    quat: np.ndarray


@dataclass(frozen=True)
class DeviceFrame:
    """One frame of a stream of devices, in our convention.

    Attributes:
        time_s: seconds on any monotonic clock, e.g. the predicted display time.
        poses: poses by name, of the devices of ``sensors.DEVICES`` that report in this frame.
            Devices that sleep or have lost tracking are left out.
    """

    time_s: float
    poses: Mapping[str, DevicePose]

    @staticmethod
    def of(
        time_s: float,
        poses: Mapping[str, Sequence[float] | np.ndarray | None],
        convention: str = "questsim",
    ) -> DeviceFrame:
        """Make a frame from the poses of another program.

        Args:
            time_s: seconds.
            poses: poses by device; None for a device that does not report. A pose is either 7
                numbers, position x y z and quaternion (wxyz in ``questsim``, xyzw elsewhere), or a
                matrix ``(3, 4)`` or ``(4, 4)`` of rotation and position.
            convention: one of ``CONVENTIONS``.

        Raises:
            InputError: unknown device or convention, wrong shape, numbers that are not finite or
                too large, or a quaternion or matrix that is not a rotation. Names the device.
        """
        rules = convention_named(convention)
        time_s = _time(time_s)
        out = {}
        for name, value in poses.items():
            if name not in DEVICES:
                known = ", ".join(DEVICES)
                raise InputError(f"unknown device {name!r}", "device frame", f"known are {known}")
            if value is not None:
                out[name] = _read_pose(value, rules, name)
        return DeviceFrame(time_s, out)


def convention_named(name: str) -> Convention:
    """The convention with the given name.

    Raises:
        InputError: an unknown name.
    """
    if name not in CONVENTIONS:
        known = ", ".join(CONVENTIONS)
        raise InputError(f"unknown convention {name!r}", fix=f"choose from {known}")
    return CONVENTIONS[name]


def from_ours(
    position: np.ndarray, quat: np.ndarray, convention: str
) -> tuple[np.ndarray, np.ndarray]:
    """Convert positions ``(..., 3)`` in metres and quaternions wxyz ``(..., 4)`` to a convention.

    The inverse of ``DeviceFrame.of``: positions in the convention's unit, quaternions in its order.
    """
    rules = convention_named(convention)
    quat, axes = np.asarray(quat, float), rules.matrix
    turned = np.linalg.det(axes) * quat[..., 1:] @ axes
    out = np.concatenate([quat[..., :1], turned], axis=-1)
    if not rules.scalar_first:
        out = out[..., [1, 2, 3, 0]]
    return np.asarray(position, float) @ axes / rules.unit_m, out


def _time(value: float) -> float:
    try:
        time_s = float(value)
    except (TypeError, ValueError, OverflowError):
        time_s = np.nan
    if not np.isfinite(time_s):
        raise InputError(f"time {value!r} is not a finite number", "device frame")
    return time_s


def _read_pose(
    value: Sequence[float] | np.ndarray, convention: Convention, name: str
) -> DevicePose:
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"pose of {name} is not made of numbers", "device frame") from None
    if numbers.shape not in ((7,), (3, 4), (4, 4)):
        raise InputError(
            f"pose of {name} has shape {numbers.shape}",
            "device frame",
            "give 7 numbers or a 3 x 4 matrix",
        )
    if not np.isfinite(numbers).all():
        raise InputError(f"pose of {name} is not finite", "device frame", "leave the device out")
    if np.abs(numbers).max() > MAX_NUMBER:  # its square may not be finite
        raise InputError(f"pose of {name} has a number above {MAX_NUMBER:g}", "device frame")
    axes = convention.matrix
    if numbers.shape == (7,):
        place, quat = numbers[:3], numbers[3:]
        length = float(np.linalg.norm(quat))
        if abs(length - 1.0) > UNIT_TOLERANCE:
            raise InputError(f"quaternion of {name} has length {length:.3g}, not 1", "device frame")
        if not convention.scalar_first:
            quat = quat[[3, 0, 1, 2]]
        turned = np.linalg.det(axes) * (axes @ quat[1:])
        quat = np.concatenate([quat[:1], turned]) / length
    else:
        place, turn = numbers[:3, 3], numbers[:3, :3]
        if np.abs(turn @ turn.T - np.eye(3)).max() > UNIT_TOLERANCE or np.linalg.det(turn) < 0:
            raise InputError(f"matrix of {name} is not a rotation", "device frame")
        quat = rot.matrix_to_quat(axes @ turn @ axes.T)
    position = convention.unit_m * (axes @ place)
    if np.abs(position).max() > MAX_DISTANCE_M:
        raise InputError(
            f"{name} is further than {MAX_DISTANCE_M:g} m from the origin", "device frame"
        )
    return DevicePose(position, quat)
