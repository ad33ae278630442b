"""Skeletal layers: joint features masked to neighbouring joints and pooled along bones.

Source: Aberman et al., "Skeleton-Aware Networks for Deep Motion Retargeting", SIGGRAPH 2020, as
SparsePoser and DragPoser use them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from agents.kinematic.derived_weights import DerivedWeights
from agents.kinematic.small_batch import linear
from questsim.skeleton import JOINT_PARENTS

REACH = 2
"""A joint's features depend on joints at most this many bones away."""


@dataclass(frozen=True)
class Pooling:
    """One step from a skeleton to one of fewer joints.

    Attributes:
        merged: for each kept joint, itself and the collapsed joints next to it.
        parents: parents of the kept joints, in the new numbering.
        joints: number of joints before.
    """

    merged: tuple[tuple[int, ...], ...]
    parents: tuple[int, ...]
    joints: int


def pooling(parents: Sequence[int]) -> Pooling:
    """Collapse every second joint along each chain; the root and the leaves stay.

    A collapsed joint has a child, and its parent is kept.
    """
    count = len(parents)
    neighbours: list[set[int]] = [set() for _ in range(count)]
    for joint in range(1, count):
        neighbours[joint].add(parents[joint])
        neighbours[parents[joint]].add(joint)
    collapsed: set[int] = set()
    for joint in range(1, count):
        if len(neighbours[joint]) > 1 and parents[joint] not in collapsed:
            collapsed.add(joint)
    kept = [joint for joint in range(count) if joint not in collapsed]
    merged = tuple((joint, *sorted(neighbours[joint] & collapsed)) for joint in kept)

    def kept_ancestor(joint: int) -> int:
        while True:
            joint = parents[joint]
            if joint not in collapsed:
                return kept.index(joint)

    return Pooling(merged, tuple(kept_ancestor(joint) for joint in kept), count)


def _levels() -> tuple[tuple[tuple[int, ...], ...], tuple[Pooling, ...]]:
    parents: list[tuple[int, ...]] = [tuple(JOINT_PARENTS)]
    steps = []
    for _ in range(3):
        steps.append(pooling(parents[-1]))
        parents.append(steps[-1].parents)
    return tuple(parents), tuple(steps)


PARENTS, POOLINGS = _levels()
"""Parents of the skeletons of 22, 14, 9 and 6 joints, and the three steps between them."""
SIZES: tuple[int, ...] = tuple(len(parents) for parents in PARENTS)


def pool_matrix(step: Pooling) -> Tensor:
    """Matrix ``(kept, joints)`` of means over merged joints."""
    matrix = torch.zeros(len(step.merged), step.joints)
    for new, olds in enumerate(step.merged):
        matrix[new, list(olds)] = 1.0 / len(olds)
    return matrix


def unpool_matrix(step: Pooling, displacement: str = "") -> Tensor:
    """Matrix ``(joints, kept)``: each joint gets the mean of the kept joints it was merged into.

    Args:
        step: the pooling to undo.
        displacement: handling of an extra last slot for the root's displacement: ``"in"``: an
            input slot that all joints read; ``"out"``: an output slot made from the root;
            ``"both"``: the slot is passed on.
    """
    matrix = (pool_matrix(step) > 0).float().T
    joints, kept = matrix.shape
    if displacement in ("in", "both"):
        column = torch.ones(joints, 1) if displacement == "in" else torch.zeros(joints, 1)
        matrix = torch.cat([matrix, column], dim=1)
    if displacement == "out":
        matrix = torch.cat([matrix, torch.eye(kept)[:1]], dim=0)
    if displacement == "both":
        matrix = torch.cat([matrix, torch.eye(kept + 1)[-1:]], dim=0)
    return matrix / matrix.sum(dim=1, keepdim=True)


def neighbour_mask(parents: Sequence[int], displacement: bool = False) -> Tensor:
    """Mask ``(J, J)``: ones where two joints are at most ``REACH`` bones apart.

    Args:
        parents: parents in the skeleton.
        displacement: add a last slot with the same neighbours as the root.
    """
    count = len(parents)
    apart = torch.full((count, count), 99.0)
    for joint in range(count):
        apart[joint, joint] = 0.0
        if joint:
            apart[joint, parents[joint]] = apart[parents[joint], joint] = 1.0
    for k in range(count):
        apart = torch.minimum(apart, apart[:, k : k + 1] + apart[k : k + 1])
    mask = (apart <= REACH).float()
    if displacement:
        near = torch.cat([mask[0], torch.ones(1)])
        mask = torch.cat([torch.cat([mask, near[:-1, None]], dim=1), near[None]], dim=0)
    return mask


class _Masked(DerivedWeights):
    """A layer whose weight is masked."""

    weight: nn.Parameter
    mask: Tensor

    def masked_weight(self) -> Tensor:
        """The weight, multiplied by the mask."""
        return self.derived(lambda: self.weight * self.mask)


class MaskedLinear(_Masked):
    """A linear layer between groups of features with a mask of connected groups.

    Args:
        mask: ``(groups out, groups in)`` of zeros and ones.
        size_in, size_out: features per group.
    """

    def __init__(self, mask: Tensor, size_in: int, size_out: int) -> None:
        super().__init__()
        wide = torch.kron(mask, torch.ones(size_out, size_in))
        self.register_buffer("mask", wide, persistent=False)
        bound = wide.sum(1, keepdim=True).clamp_min(1.0).rsqrt()
        self.weight = nn.Parameter(torch.empty_like(wide).uniform_(-1.0, 1.0) * bound * wide)
        self.bias = nn.Parameter(torch.empty(len(wide)).uniform_(-1.0, 1.0) * bound[:, 0])

    def forward(self, x: Tensor) -> Tensor:
        """``(..., groups in * size_in)`` to ``(..., groups out * size_out)``."""
        return linear(x, self.masked_weight(), self.bias)


class MaskedConv(_Masked):
    """A convolution over time of joint features with a mask of connected joints.

    The signal is reflected at both ends, so that a stride of 1 keeps its length.

    Args:
        mask: ``(joints, joints)`` of zeros and ones.
        size_in, size_out: channels per joint.
        kernel: frames; odd.
        stride: frames.
    """

    def __init__(
        self, mask: Tensor, size_in: int, size_out: int, kernel: int, stride: int = 1
    ) -> None:
        super().__init__()
        self.stride, self.padding = stride, kernel // 2
        wide = torch.kron(mask, torch.ones(size_out, size_in))
        self.register_buffer("mask", wide[..., None], persistent=False)
        bound = (wide.sum(1, keepdim=True) * kernel).clamp_min(1.0).rsqrt()
        weight = torch.empty(*wide.shape, kernel).uniform_(-1.0, 1.0)
        self.weight = nn.Parameter(weight * (bound * wide)[..., None])
        self.bias = nn.Parameter(torch.empty(len(wide)).uniform_(-1.0, 1.0) * bound[:, 0])

    def forward(self, x: Tensor) -> Tensor:
        """``(B, joints * size_in, T)`` to ``(B, joints * size_out, T / stride)``."""
        padded = nn.functional.pad(x, (self.padding, self.padding), mode="reflect")
        return nn.functional.conv1d(padded, self.masked_weight(), self.bias, self.stride)


class PlainMixing(nn.Module):
    """A dense layer in place of pooling or unpooling, the same for every frame.

    Args:
        matrix: ``(joints out, joints in)`` of the replaced pooling; only its shape is used.
        channels: channels per joint.
    """

    def __init__(self, matrix: Tensor, channels: int) -> None:
        super().__init__()
        rows, columns = matrix.shape[0] * channels, matrix.shape[1] * channels
        weight = torch.empty(rows, columns).uniform_(-1.0, 1.0)
        self.weight = nn.Parameter(weight * columns**-0.5)

    def forward(self, x: Tensor) -> Tensor:
        """``(B, joints in * channels, ...)`` to ``(B, joints out * channels, ...)``."""
        return torch.einsum("ij,bj...->bi...", self.weight, x)


def across_joints(matrix: Tensor, x: Tensor, channels: int) -> Tensor:
    """Pool or unpool features ``(B, joints * channels, ...)`` by a matrix of joints."""
    joints = x.unflatten(1, (matrix.shape[1], channels))
    return torch.einsum("ij,bj...->bi...", matrix, joints).flatten(1, 2)
