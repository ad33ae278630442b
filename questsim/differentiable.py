"""Rotations, dual quaternions and forward kinematics of the 22 joints, differentiable in PyTorch.

The arrays of ``questsim.rotations`` and ``Motion`` as tensors over any leading axes: quaternions
wxyz, metres, z up. Dual quaternions are the real part, then the dual part, as in upc-pymotion,
which computes them.
"""

from __future__ import annotations

import numpy as np
import torch
from pymotion.rotations import dual_quat_torch, quat_torch
from torch import Tensor

from questsim.skeleton import JOINT_PARENTS, NUM_JOINTS


def _ancestors() -> np.ndarray:
    chain = np.eye(NUM_JOINTS)
    for joint in range(1, NUM_JOINTS):
        chain[joint] += chain[JOINT_PARENTS[joint]]
    chain[:, 0] = 0.0
    return chain


PARENTS: list[int] = list(JOINT_PARENTS)
ANCESTORS: Tensor = torch.as_tensor(_ancestors(), dtype=torch.float32)
"""``(22, 22)``: entry (j, k) is 1 if bone k is on the path from the root to joint j."""


def six_d_to_matrix(six: Tensor) -> Tensor:
    """Rotation matrices ``(..., 3, 3)`` of two columns ``(..., 6)``, made orthonormal.

    Source: Zhou et al., "On the Continuity of Rotation Representations", CVPR 2019.
    """
    x = torch.nn.functional.normalize(six[..., :3], dim=-1)
    y = six[..., 3:] - (x * six[..., 3:]).sum(-1, keepdim=True) * x
    y = torch.nn.functional.normalize(y, dim=-1)
    return torch.stack([x, y, torch.linalg.cross(x, y)], dim=-1)


def matrix_to_six_d(matrix: Tensor) -> Tensor:
    """First two columns, column after column ``(..., 6)``, of matrices ``(..., 3, 3)``."""
    return torch.cat([matrix[..., 0], matrix[..., 1]], dim=-1)


def quat_to_matrix(quat: Tensor) -> Tensor:
    """Matrices ``(..., 3, 3)`` of unit quaternions ``(..., 4)``."""
    w, x, y, z = quat.unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))


def matrix_to_quat(matrix: Tensor) -> Tensor:
    """Unit quaternions ``(..., 4)`` of rotation matrices ``(..., 3, 3)``; the sign is arbitrary.

    Each of the four rows below is the quaternion times four times one of its components. The
    longest row is the most accurate (Bar-Itzhack 2000).
    """
    m = matrix.flatten(-2).unbind(-1)
    rows = torch.stack(
        [
            1 + m[0] + m[4] + m[8], m[7] - m[5], m[2] - m[6], m[3] - m[1],
            m[7] - m[5], 1 + m[0] - m[4] - m[8], m[1] + m[3], m[2] + m[6],
            m[2] - m[6], m[1] + m[3], 1 - m[0] + m[4] - m[8], m[5] + m[7],
            m[3] - m[1], m[2] + m[6], m[5] + m[7], 1 - m[0] - m[4] + m[8],
        ],
        dim=-1,
    ).unflatten(-1, (4, 4))  # fmt: skip
    longest = torch.diagonal(rows, dim1=-2, dim2=-1).argmax(-1)
    index = longest[..., None, None].expand(*longest.shape, 1, 4)
    return unit_quat(rows.gather(-2, index).squeeze(-2))


def yaw_matrix(cos: Tensor, sin: Tensor) -> Tensor:
    """Rotations about z ``(..., 3, 3)`` of the cosine and sine ``(...)`` of an angle."""
    zero, one = torch.zeros_like(cos), torch.ones_like(cos)
    rows = [cos, -sin, zero, sin, cos, zero, zero, zero, one]
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))


def heading_matrix(matrix: Tensor) -> Tensor:
    """Heading as a rotation about z ``(..., 3, 3)``: the direction of the x axis on the floor.

    An x axis that points straight up or down has no heading; the result is then the identity.
    """
    x, y = matrix[..., 0, 0], matrix[..., 1, 0]
    length = torch.sqrt(x * x + y * y)
    there = length > 1e-6
    safe = torch.where(there, length, torch.ones_like(length))
    cos = torch.where(there, x / safe, torch.ones_like(x))
    return yaw_matrix(cos, torch.where(there, y / safe, torch.zeros_like(y)))


def world_matrices(local: Tensor) -> Tensor:
    """Orientations in the world ``(..., 22, 3, 3)`` of rotations in the parent."""
    world = [local[..., 0, :, :]]
    for joint in range(1, NUM_JOINTS):
        world.append(world[PARENTS[joint]] @ local[..., joint, :, :])
    return torch.stack(world, dim=-3)


def positions_from_root(world: Tensor, offsets: Tensor) -> Tensor:
    """Joint positions relative to the root ``(..., 22, 3)``.

    Args:
        world: ``(..., 22, 3, 3)`` orientations in any common frame; the result is in that frame.
        offsets: ``(..., 22, 3)`` as in ``Motion``.
    """
    bones = (world[..., PARENTS, :, :] @ offsets[..., None]).squeeze(-1)
    return ANCESTORS.to(bones) @ bones


def forward_kinematics(local: Tensor, root: Tensor, offsets: Tensor) -> tuple[Tensor, Tensor]:
    """World positions ``(..., 22, 3)`` and orientations ``(..., 22, 3, 3)``.

    Args:
        local: ``(..., 22, 3, 3)`` as the rotations of ``Motion``.
        root: ``(..., 3)`` position of the root.
        offsets: ``(..., 22, 3)``.
    """
    world = world_matrices(local)
    return root[..., None, :] + positions_from_root(world, offsets), world


def quat_multiply(a: Tensor, b: Tensor) -> Tensor:
    """Hamilton product of quaternions ``(..., 4)``: first ``b``, then ``a``."""
    return quat_torch.mul(a, b)


def quat_conjugate(quat: Tensor) -> Tensor:
    """The inverse rotation of unit quaternions ``(..., 4)``."""
    return quat * quat.new_tensor([1.0, -1.0, -1.0, -1.0])


def quat_rotate(quat: Tensor, vector: Tensor) -> Tensor:
    """Vectors ``(..., 3)`` turned by unit quaternions ``(..., 4)``, broadcast."""
    axis = quat[..., 1:]
    axis, vector = torch.broadcast_tensors(axis, vector)
    turn = 2.0 * torch.linalg.cross(axis, vector)
    return vector + quat[..., :1] * turn + torch.linalg.cross(axis, turn)


def unit_quat(quat: Tensor) -> Tensor:
    """Quaternions ``(..., 4)`` normalised to unit length; zeros give finite values."""
    return torch.nn.functional.normalize(quat, dim=-1)


def continuous_signs(quat: Tensor, dim: int) -> Tensor:
    """The same rotations, signs chosen: ``w >= 0`` first, neighbours along ``dim`` close.

    Args:
        quat: ``(..., 4)``, or dual quaternions ``(..., 8)``, for which the real part decides.
        dim: the axis of time.
    """
    real = quat[..., :4]
    count = quat.shape[dim]
    first = real.narrow(dim, 0, 1)[..., :1] < 0
    dot = (real.narrow(dim, 1, count - 1) * real.narrow(dim, 0, count - 1)).sum(-1, keepdim=True)
    flips = torch.cat([first, dot < 0], dim=dim).cumsum(dim) % 2
    return quat * (1.0 - 2.0 * flips)


def dual_quat(rotation: Tensor, translation: Tensor) -> Tensor:
    """Unit dual quaternions ``(..., 8)``: rotation first, then translation.

    Args:
        rotation: ``(..., 4)`` unit quaternions.
        translation: ``(..., 3)`` metres.
    """
    return dual_quat_torch.from_rotation_translation(rotation, translation)


def unit_dual_quat(dual: Tensor) -> Tensor:
    """The nearest unit dual quaternions ``(..., 8)``: real part of length 1, dual normal to it.

    Source: Kavan et al., "Geometric Skinning with Approximate Dual Quaternion Blending", 2008.
    """
    length = dual[..., :4].norm(dim=-1, keepdim=True).clamp_min(1e-8)
    real, other = dual[..., :4] / length, dual[..., 4:] / length
    return torch.cat([real, other - (real * other).sum(-1, keepdim=True) * real], dim=-1)
