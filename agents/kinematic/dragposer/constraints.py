"""Optional user constraints on DragPoser's poses: plain loss functions.

A constraint takes world positions ``(B, 22, 3)`` and orientations ``(B, 22, 4)`` of all joints and
returns a loss ``(B,)`` in squared metres or squared radians, zero where the constraint is met.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from questsim import differentiable as diff
from questsim.skeleton import JOINTS

Constraint = Callable[[Tensor, Tensor], Tensor]


def look_at(target: tuple[float, float, float], joint: str = "head") -> Constraint:
    """The joint's x axis (forward) points at a target in the world.

    The loss is the squared difference of the directions. A head with a headset keeps the headset's
    orientation: use devices without it.

    Args:
        target: world position in metres.
        joint: the joint that is aimed.
    """

    def loss(position: Tensor, quat: Tensor) -> Tensor:
        at = JOINTS.index(joint)
        way = position.new_tensor(target) - position[:, at]
        forward = diff.quat_rotate(quat[:, at], position.new_tensor([1.0, 0.0, 0.0]))
        return (torch.nn.functional.normalize(way, dim=-1) - forward).square().sum(-1)

    return loss


def joint_distance(a: str, b: str, metres: float) -> Constraint:
    """Two joints are a given distance apart."""

    def loss(position: Tensor, quat: Tensor) -> Tensor:
        apart = (position[:, JOINTS.index(a)] - position[:, JOINTS.index(b)]).norm(dim=-1)
        return (apart - metres).square()

    return loss


def above_floor(height: float = 0.0) -> Constraint:
    """No joint is below a given height in metres."""

    def loss(position: Tensor, quat: Tensor) -> Tensor:
        return (height - position[..., 2]).clamp_min(0.0).square().sum(-1)

    return loss


def _weighted(weight: float, constraint: Constraint, position: Tensor, quat: Tensor) -> Tensor:
    return weight * constraint(position, quat)


def weighted(weight: float, constraint: Constraint) -> Constraint:
    """The same constraint with another weight; trackers' positions have weights of 5 or 10."""
    return partial(_weighted, weight, constraint)
