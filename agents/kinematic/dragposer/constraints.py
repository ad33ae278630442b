"""Optional user constraints on DragPoser's poses: plain loss functions.

A constraint takes world positions ``(B, 22, 3)`` and orientations ``(B, 22, 4)`` of all joints and
answers a loss ``(B,)``, zero where it is met, in squared metres or squared radians.
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
    """The joint's x axis, which is forward, points at a place in the world; squared sine-like loss.

    Args:
        target: metres.
        joint: which.
    """

    def loss(position: Tensor, quat: Tensor) -> Tensor:
        at = JOINTS.index(joint)
        way = position.new_tensor(target) - position[:, at]
        forward = diff.quat_rotate(quat[:, at], position.new_tensor([1.0, 0.0, 0.0]))
        return (torch.nn.functional.normalize(way, dim=-1) - forward).square().sum(-1)

    return loss


def joint_distance(a: str, b: str, metres: float) -> Constraint:
    """Two joints are that far apart."""

    def loss(position: Tensor, quat: Tensor) -> Tensor:
        apart = (position[:, JOINTS.index(a)] - position[:, JOINTS.index(b)]).norm(dim=-1)
        return (apart - metres).square()

    return loss


def above_floor(height: float = 0.0) -> Constraint:
    """No joint is lower than that, in metres."""

    def loss(position: Tensor, quat: Tensor) -> Tensor:
        return (height - position[..., 2]).clamp_min(0.0).square().sum(-1)

    return loss


def _weighted(weight: float, constraint: Constraint, position: Tensor, quat: Tensor) -> Tensor:
    return weight * constraint(position, quat)


def weighted(weight: float, constraint: Constraint) -> Constraint:
    """The same constraint, more or less important; trackers' positions weigh 5 or 10."""
    return partial(_weighted, weight, constraint)
