"""The networks of SparsePoser: a skeletal autoencoder from six trackers, then learned IK.

Source: Ponton, Yun et al., "SparsePoser: Real-time Full-body Motion Reconstruction from Sparse
Data", ACM TOG 43(1), 2023. The `paper` preset has as many parameters as the released code, where
132,496 of them are unused (static features in the dynamic encoder); here they read the deepest
static feature, which the released decoder does not use. Other changes: windows are relative to the
heading of their last frame, learned IK predicts corrections of the generator's limbs, and the
measured orientations of pelvis, head and hands are passed on unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from agents.kinematic.skeletal import (
    PARENTS,
    POOLINGS,
    SIZES,
    MaskedConv,
    MaskedLinear,
    PlainMixing,
    across_joints,
    neighbour_mask,
    pool_matrix,
    unpool_matrix,
)
from agents.kinematic.switches import SWITCH
from questsim import differentiable as diff
from questsim.skeleton import JOINTS, NUM_JOINTS

ENDS: tuple[int, ...] = tuple(
    JOINTS.index(n) for n in ("root", "left_toe", "right_toe", "head", "left_wrist", "right_wrist")
)
"""Joints whose positions the devices measure ..."""
TURNED: tuple[int, ...] = tuple(
    JOINTS.index(n)
    for n in ("root", "left_ankle", "right_ankle", "head", "left_wrist", "right_wrist")
)
"""... and whose orientations they measure: a tracker on the toes rotates with the foot."""
STATIC = (3, 6, 12, 24)
"""Channels per joint of the static features at each level of the skeleton."""


@dataclass(frozen=True)
class SparsePoserSpec:
    """Sizes of the networks, and switches of their parts.

    Attributes:
        channels: per joint: input, then after each convolution.
        kernel: frames of a convolution.
        ik_hidden: units of both hidden layers of a limb's IK.
        learned_ik: whether there is learned IK; otherwise its stage is not trained.
        skeletal: whether layers are masked by the skeleton. Otherwise all joints are connected, and
            pooling and unpooling are learned dense layers over all channels.
    """

    channels: tuple[int, int, int, int] = (8, 16, 32, 64)
    kernel: int = 15
    ik_hidden: int = 128
    learned_ik: bool = field(default=True, metadata=SWITCH)
    skeletal: bool = field(default=True, metadata=SWITCH)


@dataclass(frozen=True)
class Limb:
    """A chain that learned IK corrects.

    Attributes:
        joints: its first three joints, whose dual quaternions are predicted.
        end: index of its end among ``ENDS``.
        chain: the joints it reads, from the third one up to the root.
    """

    joints: tuple[int, int, int]
    end: int
    chain: tuple[int, ...]


def _limb(names: str, end: int) -> Limb:
    joints = [JOINTS.index(name) for name in names.split()]
    chain = [joints[-1]]
    while chain[-1]:
        chain.append(PARENTS[0][chain[-1]])
    return Limb((joints[0], joints[1], joints[2]), end, tuple(chain))


LIMBS: dict[str, Limb] = {
    "left_leg": _limb("left_hip left_knee left_ankle", 1),
    "right_leg": _limb("right_hip right_knee right_ankle", 2),
    "left_arm": _limb("left_clavicle left_shoulder left_elbow", 4),
    "right_arm": _limb("right_clavicle right_shoulder right_elbow", 5),
}


class Generator(nn.Module):
    """Static and dynamic encoder, and the decoder.

    Args:
        spec: network sizes.
    """

    def __init__(self, spec: SparsePoserSpec) -> None:
        super().__init__()
        self.spec = spec
        c, slots = spec.channels, SIZES[3] + 1
        masks = [neighbour_mask(PARENTS[level]) for level in range(3)]
        if not spec.skeletal:
            masks = [torch.ones_like(mask) for mask in masks]
        self.static = nn.ModuleList(
            [MaskedLinear(masks[i], STATIC[i], STATIC[i + 1]) for i in range(3)]
        )
        everything = torch.ones(slots, slots)
        self.encoder = nn.ModuleList(
            [MaskedConv(everything, c[i], c[i + 1], spec.kernel, stride=2) for i in range(3)]
        )
        self.encoder_static = nn.ModuleList(
            [MaskedLinear(everything, STATIC[3], c[i + 1]) for i in range(3)]
        )
        self.decoder, self.decoder_static = nn.ModuleList(), nn.ModuleList()
        self.mixing = nn.ModuleDict()
        for level in (2, 1, 0):
            self.decoder.append(MaskedConv(masks[level], c[level + 1], c[level], spec.kernel))
            self.decoder_static.append(MaskedLinear(masks[level], STATIC[level], c[level]))
            unpool = unpool_matrix(POOLINGS[level], "in" if level == 2 else "")
            self._spreading(f"unpool_{level}", unpool, c[level + 1])
            self._spreading(f"pool_{level}", pool_matrix(POOLINGS[level]), STATIC[level + 1])

    def _spreading(self, name: str, matrix: Tensor, channels: int) -> None:
        """Create pooling or unpooling for joints with the given number of channels."""
        if self.spec.skeletal:
            self.register_buffer(name, matrix, persistent=False)
        else:
            self.mixing[name] = PlainMixing(matrix, channels)

    def _spread(self, name: str, x: Tensor, channels: int) -> Tensor:
        if self.spec.skeletal:
            return across_joints(getattr(self, name), x, channels)
        return self.mixing[name](x)

    def _static(self, offsets: Tensor) -> tuple[list[Tensor], Tensor]:
        """Features of the offsets at 22, 14 and 9 joints, and at 6 joints with an empty slot."""
        levels, x = [offsets], offsets
        for level, layer in enumerate(self.static):
            x = self._spread(f"pool_{level}", layer(x), STATIC[level + 1])
            x = nn.functional.leaky_relu(x, 0.2)
            levels.append(x)
        return levels[:3], nn.functional.pad(levels[3], (0, STATIC[3]))

    def forward(self, sparse: Tensor, offsets: Tensor) -> Tensor:
        """Normalised dual quaternions ``(B, 176, T)``, before scaling to unit length.

        Args:
            sparse: ``(B, 56, T)`` with T a multiple of 8.
            offsets: ``(B, 66)`` normalised.
        """
        levels, deepest = self._static(offsets)
        x = sparse
        for conv, static in zip(self.encoder, self.encoder_static, strict=True):
            x = nn.functional.leaky_relu(conv(x) + static(deepest)[..., None], 0.2)
        blocks = zip((2, 1, 0), self.decoder, self.decoder_static, strict=True)
        for level, conv, static in blocks:
            x = nn.functional.interpolate(x, scale_factor=2, mode="linear", align_corners=False)
            x = self._spread(f"unpool_{level}", x, self.spec.channels[level + 1])
            x = conv(x) + static(levels[level])[..., None]
            if level:
                x = nn.functional.leaky_relu(x, 0.2)
        return x


class SparsePoserModule(nn.Module):
    """Generator, learned IK and the normalisers.

    Args:
        spec: network sizes.
    """

    mean: Tensor
    std: Tensor
    offset_mean: Tensor
    offset_std: Tensor
    step_std: Tensor

    def __init__(self, spec: SparsePoserSpec) -> None:
        super().__init__()
        self.spec = spec
        self.generator = Generator(spec)
        self.ik = nn.ModuleDict()
        for name, limb in LIMBS.items() if spec.learned_ik else ():
            width = 9 + 8 * len(limb.chain) + 8
            last = nn.Linear(spec.ik_hidden, 24)
            # The network outputs corrections, initially zero.
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)
            self.ik[name] = nn.Sequential(
                nn.Linear(width, spec.ik_hidden), nn.ReLU(),
                nn.Linear(spec.ik_hidden, spec.ik_hidden), nn.ReLU(),
                last,
            )  # fmt: skip
        for buffer, value in (
            ("mean", torch.zeros(NUM_JOINTS, 8)),
            ("std", torch.zeros(NUM_JOINTS, 8)),
            ("offset_mean", torch.zeros(3)),
            ("offset_std", torch.ones(3)),
            ("step_std", torch.ones(())),
        ):
            self.register_buffer(buffer, value)

    def normal_offsets(self, offsets: Tensor) -> Tensor:
        """Normalise offsets in metres to ``(B, 22, 3)``."""
        return (offsets - self.offset_mean) / self.offset_std

    def sparse(self, position: Tensor, quat: Tensor) -> tuple[Tensor, Tensor]:
        """Input of the generator for a window of trackers.

        Args:
            position: ``(B, T, 6, 3)`` world positions of the joints ``ENDS``.
            quat: ``(B, T, 6, 4)`` world orientations of the joints ``TURNED``.

        Returns:
            channels ``(B, 56, T)``, and the normalised dual quaternions ``(B, T, 6, 8)`` alone.
        """
        dual = root_space(position, quat)
        normal = (dual - self.mean[list(ENDS)]) / self.std[list(ENDS)]
        step = torch.zeros_like(position[:, :, 0])
        step[:, 1:] = position[:, 1:, 0] - position[:, :-1, 0]
        back = window_heading(quat[:, :, 0]).transpose(-1, -2)
        step = (back[:, None] @ step[..., None]).squeeze(-1) / self.step_std
        step = nn.functional.pad(step, (0, 5))
        return torch.cat([normal.flatten(2), step], dim=-1).transpose(1, 2), normal

    def generate(self, sparse: Tensor, offsets: Tensor) -> Tensor:
        """Unit dual quaternions ``(B, T, 22, 8)`` in root space; offsets normalised."""
        return self.unit(self.generator(sparse, offsets.flatten(1)))

    def unit(self, out: Tensor) -> Tensor:
        """Unit dual quaternions ``(B, T, 22, 8)`` from the generator's output ``(B, 176, T)``."""
        dual = out.transpose(1, 2).unflatten(-1, (NUM_JOINTS, 8))
        return diff.unit_dual_quat(dual * self.std + self.mean)

    def normal(self, dual: Tensor) -> Tensor:
        """Normalise dual quaternions ``(..., 22, 8)`` by mean and deviation."""
        return (dual - self.mean) / self.std

    def solve(self, dual: Tensor, ends: Tensor, offsets: Tensor) -> Tensor:
        """Dual quaternions ``(B, T, 22, 8)`` with the limbs corrected by learned IK.

        Args:
            dual: output of the generator.
            ends: ``(B, T, 6, 8)`` normalised dual quaternions of the trackers.
            offsets: ``(B, 22, 3)`` normalised.
        """
        scaled, parts = self.normal(dual), list(dual.unbind(-2))
        for name, limb in LIMBS.items():
            bones = offsets[:, [*limb.joints[1:], ENDS[limb.end]]].flatten(1)
            seen = [
                bones[:, None].expand(-1, dual.shape[1], -1),
                scaled[..., list(limb.chain), :].flatten(2),
                ends[..., limb.end, :],
            ]
            joints = list(limb.joints)
            out = (
                self.ik[name](torch.cat(seen, dim=-1)).unflatten(-1, (3, 8))
                + scaled[..., joints, :]
            )
            out = diff.unit_dual_quat(out * self.std[joints] + self.mean[joints])
            for joint, answer in zip(joints, out.unbind(-2), strict=True):
                parts[joint] = answer
        return torch.stack(parts, dim=-2)


def window_heading(root: Tensor) -> Tensor:
    """Heading ``(B, 3, 3)``, about z, of the last of root orientations ``(B, T, 4)``."""
    return diff.heading_matrix(diff.quat_to_matrix(root[:, -1]))


def root_space(position: Tensor, quat: Tensor) -> Tensor:
    """Dual quaternions ``(B, T, J, 8)`` relative to joint 0, which keeps only its rotation.

    The root's rotation is relative to the heading of the window's last frame. Signs are continuous
    in time.

    Args:
        position: ``(B, T, J, 3)`` in the world.
        quat: ``(B, T, J, 4)``.
    """
    root = quat[:, :, :1]
    inverse = diff.quat_conjugate(root)
    rotation = diff.quat_multiply(*torch.broadcast_tensors(inverse, quat))
    place = diff.quat_rotate(inverse, position - position[:, :, :1])
    heading = window_heading(quat[:, :, 0])
    half = 0.5 * torch.atan2(heading[:, 1, 0], heading[:, 0, 0])
    zero = torch.zeros_like(half)
    back = torch.stack([half.cos(), zero, zero, -half.sin()], dim=-1)[:, None, None]
    own = diff.quat_multiply(*torch.broadcast_tensors(back, root))
    rotation = torch.cat([own, rotation[:, :, 1:]], dim=2)
    return diff.continuous_signs(diff.dual_quat(rotation, place), dim=1)
