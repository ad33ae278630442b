"""Input of HMD-Poser and LGSIK-Poser: 135 features per frame of headset, controllers and IMUs."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from questsim.compiled import jit, turn_back
from questsim.joint_sensors import SENSOR_FPS
from questsim.skeleton import JOINTS

DEVICES: tuple[str, ...] = (
    "headset", "left_controller", "right_controller",
    "left_knee_imu", "right_knee_imu", "pelvis_imu",
)  # fmt: skip
"""The order of all signals: head, hands, then the three IMUs."""

SENSOR_JOINTS: tuple[int, ...] = tuple(
    JOINTS.index(name)
    for name in ("head", "left_wrist", "right_wrist", "left_knee", "right_knee", "root")
)
HEAD = JOINTS.index("head")
ACCELERATION_UNIT = 10.0
"""Scale of accelerations in m/s^2, so that all features are of the same order."""

ATOMS: dict[str, list[int]] = {}
"""Columns by source: head, left, right, left_in_head, right_in_head, left_leg, right_leg, pelvis.

6 DoF: rotation 6, angular velocity 6, position 3, velocity 3. IMU: 6, 6, acceleration 3.
"""
_names = ("head", "left", "right", "left_leg", "right_leg", "pelvis")
for _i, _name in enumerate(_names):
    ATOMS[_name] = [*range(6 * _i, 6 * _i + 6), *range(36 + 6 * _i, 42 + 6 * _i)]
for _i, _name in enumerate(("head", "left", "right")):
    ATOMS[_name] += [*range(72 + 3 * _i, 75 + 3 * _i), *range(81 + 3 * _i, 84 + 3 * _i)]
for _i, _name in enumerate(("left_in_head", "right_in_head")):
    ATOMS[_name] = [
        *range(90 + 6 * _i, 96 + 6 * _i), *range(102 + 6 * _i, 108 + 6 * _i),
        *range(114 + 3 * _i, 117 + 3 * _i), *range(120 + 3 * _i, 123 + 3 * _i),
    ]  # fmt: skip
for _i, _name in enumerate(("left_leg", "right_leg", "pelvis")):
    ATOMS[_name] += [*range(126 + 3 * _i, 129 + 3 * _i)]
NUM_FEATURES = 135

_FPS, _UNIT = np.float32(SENSOR_FPS), np.float32(ACCELERATION_UNIT)


def features(
    position: Tensor, rotation: Tensor, acceleration: Tensor, seen: Tensor
) -> tuple[Tensor, Tensor]:
    """The 135 features of each frame, and the heading frame they are expressed in.

    All features are relative to the head's heading and its position on the floor, so that they do
    not depend on walking direction and place; the papers use the axes of the recording. No frame
    depends on a later one; frames before the first are taken as equal to it.

    Args:
        position: ``(B, T, 3, 3)`` head and wrists in the world.
        rotation: ``(B, T, 6, 3, 3)`` of the joints of ``DEVICES``.
        acceleration: ``(B, T, 3, 3)`` of the IMUs in the world, m/s^2.
        seen: ``(B, 3)`` bool, which IMUs are present; features of the others are zero.

    Returns:
        features ``(B, T, 135)`` and rotations of the heading ``(B, T, 3, 3)``.
    """
    arrays = (array.contiguous().numpy() for array in (position, rotation, acceleration, seen))
    values = np.zeros((*position.shape[:2], NUM_FEATURES), np.float32)
    heading = np.zeros((*position.shape[:2], 3, 3), np.float32)
    _fill(*arrays, values, heading)
    return torch.from_numpy(values), torch.from_numpy(heading)


@jit
def _fill(position, rotation, acceleration, seen, values, heading):
    """Write the features of each frame into a zeroed array; see ``features``."""
    frames = position.shape[1]
    now, was = np.empty((2, 3, 3), np.float32), np.empty((2, 3, 3), np.float32)
    place, last = np.empty((2, 3), np.float32), np.empty((2, 3), np.float32)
    for b in range(len(position)):
        for t in range(frames):
            before, out = max(t - 1, 0), values[b, t]
            turns, turns_before = rotation[b, t], rotation[b, before]
            at, at_before = position[b, t], position[b, before]
            cos, sin = _heading(turns[0, 0, 0], turns[0, 1, 0])
            heading[b, t, 0, 0] = heading[b, t, 1, 1] = cos
            heading[b, t, 0, 1], heading[b, t, 1, 0], heading[b, t, 2, 2] = -sin, sin, 1.0
            for i in range(6):
                if i < 3 or seen[b, i - 3]:
                    for c in range(2):
                        x, y, z = turns[i, 0, c], turns[i, 1, c], turns[i, 2, c]
                        turn_back(cos, sin, x, y, z, out, 6 * i + 3 * c)
                    _spin(turns_before[i], turns[i], out, 36 + 6 * i)
            for i in range(3):
                x, y, z = at[i, 0] - at[0, 0], at[i, 1] - at[0, 1], at[i, 2]
                turn_back(cos, sin, x, y, z, out, 72 + 3 * i)
                x, y, z = at[i, 0], at[i, 1], at[i, 2]
                x, y, z = x - at_before[i, 0], y - at_before[i, 1], z - at_before[i, 2]
                turn_back(cos, sin, x * _FPS, y * _FPS, z * _FPS, out, 81 + 3 * i)
                if seen[b, i]:
                    x, y, z = acceleration[b, t, i]
                    x, y, z = x / _UNIT, y / _UNIT, z / _UNIT
                    turn_back(cos, sin, x, y, z, out, 126 + 3 * i)
            _in_head(turns, at, now, place)
            _in_head(turns_before, at_before, was, last)
            for h in range(2):
                _spin(was[h], now[h], out, 102 + 6 * h)
                for k in range(3):
                    out[90 + 6 * h + k], out[93 + 6 * h + k] = now[h, k, 0], now[h, k, 1]
                    out[114 + 3 * h + k] = place[h, k]
                    out[120 + 3 * h + k] = (place[h, k] - last[h, k]) * _FPS


@jit
def _heading(x, y):
    """Cosine and sine of the direction of (x, y); for a zero vector, of angle zero."""
    length = math.sqrt(x * x + y * y)
    if length > 1e-6:
        return x / length, y / length
    return 1.0, 0.0


@jit
def _spin(before, now, out, at):
    """Write two columns of the rotation from one matrix to another to out[at:at + 6]."""
    for c in range(2):
        for k in range(3):
            turned = before[0, k] * now[0, c] + before[1, k] * now[1, c] + before[2, k] * now[2, c]
            out[at + 3 * c + k] = turned


@jit
def _in_head(turns, at, hands, place):
    """Write rotations and positions of both hands relative to the head."""
    for h in range(2):
        for i in range(3):
            place[h, i] = 0.0
            for j in range(3):
                place[h, i] += turns[0, j, i] * (at[1 + h, j] - at[0, j])
            for k in range(3):
                hands[h, i, k] = 0.0
                for j in range(3):
                    hands[h, i, k] += turns[0, j, i] * turns[1 + h, j, k]
