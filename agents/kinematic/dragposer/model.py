"""Decoder and forward kinematics of DragPoser's solver: joints of a latent, with derivatives.

Computes ``DragPoserModule.decode`` and ``joints_from_root`` for a single pose in NumPy, with
analytic derivatives. Call overhead dominates in networks this small, so there are few calls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from agents.kinematic.dragposer.networks import DECODED, LATENT, DragPoserModule
from agents.kinematic.skeletal import MaskedLinear
from questsim import differentiable as diff
from questsim.skeleton import JOINT_PARENTS, NUM_JOINTS

UNKNOWNS = LATENT + 6
"""Number of unknowns: the latent, a translation of the root in metres and a rotation in radians."""
MOVE, TURN = slice(LATENT, LATENT + 3), slice(LATENT + 3, UNKNOWNS)
_SLOPE = 0.2
_PARENTS = np.array(JOINT_PARENTS)
_ANCESTORS = diff.ANCESTORS.double().numpy()

# Hamilton's product as two tables: (a b)_i = sum of LEFT[i, j, k] a_j b_k.
_PRODUCT = np.zeros((4, 4, 4))
for _i, _j, _k, _sign in (
    (0, 0, 0, 1), (0, 1, 1, -1), (0, 2, 2, -1), (0, 3, 3, -1),
    (1, 0, 1, 1), (1, 1, 0, 1), (1, 2, 3, 1), (1, 3, 2, -1),
    (2, 0, 2, 1), (2, 1, 3, -1), (2, 2, 0, 1), (2, 3, 1, 1),
    (3, 0, 3, 1), (3, 1, 2, 1), (3, 2, 1, -1), (3, 3, 0, 1),
):  # fmt: skip
    _PRODUCT[_i, _j, _k] = _sign
_LEFT = _PRODUCT.transpose(1, 0, 2).reshape(4, 16)
_RIGHT = _PRODUCT.transpose(2, 0, 1).reshape(4, 16)


def left_matrix(a: np.ndarray) -> np.ndarray:
    """Matrices ``(..., 4, 4)`` that multiply by quaternions ``(..., 4)`` from the left."""
    return (a @ _LEFT).reshape(*a.shape[:-1], 4, 4)


def right_matrix(b: np.ndarray) -> np.ndarray:
    """Matrices ``(..., 4, 4)`` that multiply by quaternions ``(..., 4)`` from the right."""
    return (b @ _RIGHT).reshape(*b.shape[:-1], 4, 4)


# The matrix of a quaternion is a quadratic form: R[r, c] = sum of FORM[r, c, j, k] q_j q_k.
_FORM = np.zeros((3, 3, 4, 4))
for _r in range(3):
    for _c in range(3):
        _a, _b = (_r + 1) % 3, (_r + 2) % 3
        if _r == _c:
            for _axis in (_a, _b):
                _FORM[_r, _c, _axis + 1, _axis + 1] = -2.0
            continue
        _third = 3 - _r - _c
        _FORM[_r, _c, _r + 1, _c + 1] += 1.0
        _FORM[_r, _c, _c + 1, _r + 1] += 1.0
        _w = -1.0 if _c == _a else 1.0
        _FORM[_r, _c, 0, _third + 1] += _w
        _FORM[_r, _c, _third + 1, 0] += _w
# Its derivative is linear in q: dR[r, c]/dq_k = sum of SLOPES[j, (r, c, k)] q_j.
_SLOPES = (_FORM + _FORM.swapaxes(2, 3)).transpose(2, 0, 1, 3).reshape(4, 36)


def turning(quat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Matrices ``(..., 3, 3)`` of quaternions, and their derivatives ``(..., 3, 3, 4)``."""
    slopes = (quat @ _SLOPES).reshape(*quat.shape[:-1], 3, 3, 4)
    matrix = 0.5 * (slopes @ quat[..., None, :, None])[..., 0]
    return matrix + np.eye(3), slopes


@dataclass(frozen=True)
class PosedSkeleton:
    """A pose in the world, optionally with its derivatives by the 30 unknowns.

    Attributes:
        position: ``(22, 3)`` metres; quat: ``(22, 4)`` orientations.
        d_position: ``(22, 3, K)`` derivatives by the unknowns; ``K`` is 30 or 0.
        d_quat: ``(22, 4, K)``.
    """

    position: np.ndarray
    quat: np.ndarray
    d_position: np.ndarray
    d_quat: np.ndarray

    @property
    def columns(self) -> int:
        """Number of derivatives: 30 or 0."""
        return self.d_position.shape[-1]


class DragModel:
    """Decoder and forward kinematics.

    Args:
        module: a trained module.
    """

    def __init__(self, module: DragPoserModule) -> None:
        self._layers = _dense(module)
        self._mean = module.mean[:, :4].double().numpy()
        self._step_std = float(module.step_std)

    def posed_skeleton(
        self,
        unknowns: np.ndarray,
        turn: np.ndarray,
        root: np.ndarray,
        offsets: np.ndarray,
        slopes: bool = False,
    ) -> PosedSkeleton:
        """The pose for given unknowns.

        Args:
            unknowns: ``(30,)``.
            turn: ``(4,)`` the root's orientation in the previous frame.
            root: ``(3,)`` the root's position in the previous frame.
            offsets: ``(22, 3)`` offsets of the body.
            slopes: whether to compute the derivatives.
        """
        local, moved, d_local, d_moved = self._decoded(unknowns[:LATENT], slopes)
        half = np.concatenate([[1.0], 0.5 * unknowns[TURN]])
        length = np.sqrt(half @ half)
        half /= length
        before = left_matrix(turn)
        decoded = before @ local[0]
        own = left_matrix(decoded) @ half
        matrices, d_matrices = turning(np.concatenate([local, own[None], turn[None]]))
        whole, d_whole, back = matrices[-2], d_matrices[-2], matrices[-1]
        # In root space the rotation of the root itself is the identity.
        matrices[0], d_matrices[0] = np.eye(3), 0.0
        bones = (matrices[_PARENTS] @ offsets[:, :, None])[..., 0]
        joints = _ANCESTORS @ bones
        position = root + back @ moved + unknowns[MOVE] + joints @ whole.T
        quat = local @ left_matrix(own).T
        quat[0] = own
        if not slopes:
            none = np.zeros((NUM_JOINTS, 4, 0))
            return PosedSkeleton(position, quat, none[:, :3], none)

        d_own = np.zeros((4, UNKNOWNS))
        d_own[:, :LATENT] = right_matrix(half) @ before @ d_local[0]
        d_half = (np.eye(4)[:, 1:] - np.outer(half, half[1:])) * (0.5 / length)
        d_own[:, TURN] = left_matrix(decoded) @ d_half
        # Row by row of the bones' matrices: (22, 3, 4) = sum over c of dR[r, c]/dq o_c.
        d_bones = (offsets[:, None, None] @ d_matrices[_PARENTS])[:, :, 0] @ d_local[_PARENTS]
        d_joints = (_ANCESTORS @ d_bones.reshape(NUM_JOINTS, -1)).reshape(NUM_JOINTS, 3, LATENT)
        d_position = ((joints[:, None, None] @ d_whole)[:, :, 0]) @ d_own
        d_position[..., :LATENT] += whole @ d_joints + back @ d_moved
        d_position[:, [0, 1, 2], [LATENT, LATENT + 1, LATENT + 2]] += 1.0
        d_quat = right_matrix(local) @ d_own
        d_quat[..., :LATENT] += left_matrix(own) @ d_local
        d_quat[0] = d_own
        return PosedSkeleton(position, quat, d_position, d_quat)

    def posed_skeletons(
        self,
        unknowns: np.ndarray,
        turn: np.ndarray,
        root: np.ndarray,
        offsets: np.ndarray,
        slopes: bool = False,
    ) -> PosedSkeleton:
        """``posed_skeleton`` of ``B`` poses; arguments and result have one more axis in front."""
        count = len(unknowns)
        local, moved, d_local, d_moved = self._decoded_all(unknowns[:, :LATENT], slopes)
        half = np.concatenate([np.ones((count, 1)), 0.5 * unknowns[:, TURN]], axis=1)
        length = np.sqrt((half * half).sum(axis=1, keepdims=True))
        half /= length
        before = left_matrix(turn)
        decoded = (before @ local[:, 0, :, None])[..., 0]
        own = (left_matrix(decoded) @ half[..., None])[..., 0]
        matrices, d_matrices = turning(np.concatenate([local, own[:, None], turn[:, None]], axis=1))
        whole, d_whole, back = matrices[:, -2], d_matrices[:, -2], matrices[:, -1]
        matrices[:, 0], d_matrices[:, 0] = np.eye(3), 0.0
        bones = (matrices[:, _PARENTS] @ offsets[..., None])[..., 0]
        joints = _ANCESTORS @ bones
        place = root + (back @ moved[..., None])[..., 0] + unknowns[:, MOVE]
        position = place[:, None] + joints @ whole.swapaxes(1, 2)
        quat = local @ left_matrix(own).swapaxes(1, 2)
        quat[:, 0] = own
        if not slopes:
            none = np.zeros((count, NUM_JOINTS, 4, 0))
            return PosedSkeleton(position, quat, none[:, :, :3], none)

        d_own = np.zeros((count, 4, UNKNOWNS))
        d_own[:, :, :LATENT] = right_matrix(half) @ before @ d_local[:, 0]
        outer = half[:, :, None] * half[:, None, 1:]
        d_half = (np.eye(4)[:, 1:] - outer) * (0.5 / length[..., None])
        d_own[:, :, TURN] = left_matrix(decoded) @ d_half
        d_bones = (offsets[:, :, None, None] @ d_matrices[:, _PARENTS])[:, :, :, 0]
        d_bones = d_bones @ d_local[:, _PARENTS]
        d_joints = _ANCESTORS @ d_bones.reshape(count, NUM_JOINTS, -1)
        d_joints = d_joints.reshape(count, NUM_JOINTS, 3, LATENT)
        turned = (joints[:, :, None, None] @ d_whole[:, None])[:, :, :, 0]
        d_position = turned @ d_own[:, None]
        d_position[..., :LATENT] += whole[:, None] @ d_joints + (back @ d_moved)[:, None]
        d_position[:, :, [0, 1, 2], [LATENT, LATENT + 1, LATENT + 2]] += 1.0
        d_quat = right_matrix(local) @ d_own[:, None]
        d_quat[..., :LATENT] += left_matrix(own)[:, None] @ d_local
        d_quat[:, 0] = d_own
        return PosedSkeleton(position, quat, d_position, d_quat)

    def _decoded_all(
        self, latent: np.ndarray, slopes: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """``_decoded`` of latents ``(B, 24)``."""
        count = len(latent)
        columns = [latent[..., None]]
        if slopes:
            columns.append(np.broadcast_to(np.eye(LATENT), (count, LATENT, LATENT)))
        x = np.concatenate(columns, axis=2)
        for i, (weight, bias) in enumerate(self._layers):
            x = torch.matmul(weight, torch.from_numpy(x)).numpy()
            x[:, :, 0] += bias
            if i < len(self._layers) - 1:
                x *= np.where(x[:, :, :1] > 0.0, 1.0, _SLOPE)
        out = x.reshape(count, NUM_JOINTS + 1, DECODED, -1)
        raw = out[:, :NUM_JOINTS, :, 0] + self._mean
        length = np.sqrt((raw * raw).sum(-1, keepdims=True)).clip(1e-12)
        local = raw / length
        d_raw = out[:, :NUM_JOINTS, :, 1:]
        along = local[:, :, None] @ d_raw
        d_local = (d_raw - local[..., None] * along) / length[..., None]
        moved = out[:, NUM_JOINTS, :3] * self._step_std
        return local, moved[..., 0], d_local, moved[..., 1:]

    def _decoded(
        self, latent: np.ndarray, slopes: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Rotations ``(22, 4)`` relative to the root, its displacement, and their derivatives."""
        # The first column is the value, the others its derivatives: one product computes both.
        columns = [latent[:, None], np.eye(LATENT)] if slopes else [latent[:, None]]
        x = np.concatenate(columns, axis=1)
        for i, (weight, bias) in enumerate(self._layers):
            # PyTorch's product, since efficiency.py counts it; small products are faster in NumPy.
            x = torch.mm(weight, torch.from_numpy(x)).numpy()
            x[:, 0] += bias
            if i < len(self._layers) - 1:
                x *= np.where(x[:, :1] > 0.0, 1.0, _SLOPE)
        out = x.reshape(NUM_JOINTS + 1, DECODED, -1)
        raw = out[:NUM_JOINTS, :, 0] + self._mean
        length = np.sqrt((raw * raw).sum(-1, keepdims=True)).clip(1e-12)
        local = raw / length
        d_raw = out[:NUM_JOINTS, :, 1:]
        along = local[:, None] @ d_raw
        d_local = (d_raw - local[:, :, None] * along) / length[..., None]
        moved = out[NUM_JOINTS, :3] * self._step_std
        return local, moved[:, 0], d_local, moved[:, 1:]


def _dense(module: DragPoserModule) -> list[tuple[Tensor, np.ndarray]]:
    """Weights and biases of the decoder's layers, with unpooling and masks multiplied in."""
    vae = module.vae
    layers: list[tuple[Tensor, Tensor]] = [(vae.from_latent.weight, vae.from_latent.bias)]
    for level, layer in zip((2, 1, 0), vae.decoder, strict=True):
        assert isinstance(layer, MaskedLinear) and isinstance(layer.mask, Tensor)
        wide = torch.kron(getattr(vae, f"unpool_{level}").double(), torch.eye(DECODED).double())
        layers.append((layer.weight.double() * layer.mask @ wide, layer.bias))
    return [(w.detach().double(), b.detach().double().numpy()) for w, b in layers]
