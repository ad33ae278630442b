"""What HMD-Poser and LGSIK-Poser read: 135 numbers a frame of headset, controllers and IMUs."""

from __future__ import annotations

import torch
from torch import Tensor

from questsim import differentiable as diff
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
"""m/s^2 that count as one, so that all features are of the same order."""

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


def features(
    position: Tensor, rotation: Tensor, acceleration: Tensor, seen: Tensor
) -> tuple[Tensor, Tensor]:
    """The 135 numbers of each frame, and the frame they are told in.

    Everything is seen from the head's heading and its place on the floor, so that a walk means the
    same in every direction and at every place; the papers take the axes of the recording. No frame
    uses a later one; before the first, all is as in the first.

    Args:
        position: ``(B, T, 3, 3)`` head and wrists in the world.
        rotation: ``(B, T, 6, 3, 3)`` of the joints of ``DEVICES``.
        acceleration: ``(B, T, 3, 3)`` of the IMUs in the world, m/s^2.
        seen: ``(B, 3)`` bool, which IMUs there are; the others' numbers are zero.

    Returns:
        features ``(B, T, 135)`` and the heading's turn ``(B, T, 3, 3)``.
    """
    heading = diff.heading_matrix(rotation[:, :, 0])
    back = heading.transpose(-1, -2)

    def before(x: Tensor) -> Tensor:
        return torch.cat([x[:, :1], x[:, :-1]], dim=1)

    def spin(r: Tensor) -> Tensor:
        return diff.matrix_to_six_d(before(r).transpose(-1, -2) @ r)

    def seen_from(turn: Tensor, vectors: Tensor) -> Tensor:
        return (turn[:, :, None] @ vectors[..., None]).squeeze(-1)

    floor = position[:, :, :1] * position.new_tensor([1.0, 1.0, 0.0])
    velocity = (position - before(position)) * SENSOR_FPS
    head, hands = rotation[:, :, :1].transpose(-1, -2), rotation[:, :, 1:3]
    in_head = head @ hands
    place = (head @ (position[:, :, 1:] - position[:, :, :1])[..., None]).squeeze(-1)
    mask = torch.cat([seen.new_ones(len(seen), 3), seen], dim=1).to(position)[:, None, :, None]
    imu = seen.to(position)[:, None, :, None]
    parts = [
        diff.matrix_to_six_d(back[:, :, None] @ rotation) * mask,
        spin(rotation) * mask,
        seen_from(back, position - floor),
        seen_from(back, velocity),
        diff.matrix_to_six_d(in_head),
        spin(in_head),
        place,
        (place - before(place)) * SENSOR_FPS,
        seen_from(back, acceleration) * imu / ACCELERATION_UNIT,
    ]
    return torch.cat([part.flatten(2) for part in parts], dim=-1), heading
