"""The sparse observation as a torch module: QuestSim's 475 numbers from a simulator's raw state.

It computes the same as ``envs.observation_kernel``, which environments use, in operations that can
be exported to other runtimes. The tests compare the two.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from questsim.skeleton import FEET, NUM_DOFS, NUM_LINKS

MIN_FORWARD = 1e-9
"""If the root's x axis is more upright than this, its heading is undefined and taken as zero."""


class SparseObservation(nn.Module):
    """Observations ``(n, D)`` in the frame S: below the root on the floor z = 0, with its heading.

    The blocks are those of ``envs.layout.observation_layout`` without a privileged one.

    Args:
        frames: device frames per observation: the future ones in order, or only the present one.
        devices: devices per frame.
    """

    def __init__(self, frames: int, devices: int) -> None:
        super().__init__()
        self.frames, self.devices = frames, devices

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the arguments of ``forward``, in order, without the batch axis."""
        return {
            "qpos": (7 + NUM_DOFS,),
            "link_position": (NUM_LINKS, 3),
            "link_quat": (NUM_LINKS, 4),
            "qvel": (6 + NUM_DOFS,),
            "link_velocity": (NUM_LINKS, 3),
            "link_angular_velocity": (NUM_LINKS, 3),
            "contact_force": (len(FEET), 3),
            "device_position": (self.frames, self.devices, 3),
            "device_quat": (self.frames, self.devices, 4),
            "height_m": (1,),
        }

    def forward(
        self,
        qpos: Tensor,
        link_position: Tensor,
        link_quat: Tensor,
        qvel: Tensor,
        link_velocity: Tensor,
        link_angular_velocity: Tensor,
        contact_force: Tensor,
        device_position: Tensor,
        device_quat: Tensor,
        height_m: Tensor,
    ) -> Tensor:
        """Observe ``n`` avatars; everything is in world axes, quaternions are wxyz.

        Args:
            qpos: ``(n, 40)`` root position, root orientation, hinge angles.
            link_position: ``(n, 16, 3)`` link origins in metres.
            link_quat: ``(n, 16, 4)`` link orientations.
            qvel: ``(n, 39)``; only the hinge velocities are read, rad/s.
            link_velocity: ``(n, 16, 3)`` of the link origins, m/s.
            link_angular_velocity: ``(n, 16, 3)`` rad/s.
            contact_force: ``(n, 2, 3)`` force of the floor on each foot, N.
            device_position: ``(n, F, D, 3)`` metres.
            device_quat: ``(n, F, D, 4)``.
            height_m: ``(n, 1)`` stature.
        """
        cos, sin = heading(qpos[:, 3:7])
        # Positions are relative to the root horizontally; heights stay relative to the floor.
        below_root = torch.cat([qpos[:, :2], torch.zeros_like(qpos[:, :1])], dim=1)[:, None]

        device_place = turn_back(cos, sin, device_position.flatten(1, 2) - below_root)
        device_columns = columns_back(cos, sin, device_quat.flatten(1, 2))
        blocks = [
            qpos[:, 7:],
            qvel[:, 6:],
            turn_back(cos, sin, link_position - below_root),
            columns_back(cos, sin, link_quat),
            turn_back(cos, sin, link_velocity),
            turn_back(cos, sin, link_angular_velocity),
            turn_back(cos, sin, contact_force),
            torch.cat([device_place, device_columns], dim=-1),
            height_m,
        ]
        return torch.cat([block.flatten(1) for block in blocks], dim=1)


def heading(quat: Tensor) -> tuple[Tensor, Tensor]:
    """Cosine and sine ``(n, 1)`` of the heading of quaternions ``(n, 4)``."""
    w, x, y, z = quat.unbind(-1)
    forward_x = 1 - 2 * (y * y + z * z)
    forward_y = 2 * (w * z + x * y)
    length = torch.sqrt(forward_x * forward_x + forward_y * forward_y)
    upright = length < MIN_FORWARD
    safe = torch.where(upright, torch.ones_like(length), length)
    cos = torch.where(upright, torch.ones_like(length), forward_x / safe)
    sin = torch.where(upright, torch.zeros_like(length), forward_y / safe)
    return cos[:, None], sin[:, None]


def turn_back(cos: Tensor, sin: Tensor, vectors: Tensor) -> Tensor:
    """Vectors ``(n, k, 3)`` turned about z by minus the heading ``(n, 1)``."""
    x, y, z = vectors.unbind(-1)
    return torch.stack([cos * x + sin * y, cos * y - sin * x, z], dim=-1)


def columns_back(cos: Tensor, sin: Tensor, quats: Tensor) -> Tensor:
    """First two matrix columns ``(n, k, 6)`` of orientations turned like ``turn_back``'s."""
    first, second = matrix_columns(quats)
    return torch.cat([turn_back(cos, sin, first), turn_back(cos, sin, second)], dim=-1)


def matrix_columns(quat: Tensor) -> tuple[Tensor, Tensor]:
    """First and second column ``(..., 3)`` of the matrices of quaternions ``(..., 4)``."""
    w, x, y, z = quat.unbind(-1)
    first = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
    second = [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)]
    return torch.stack(first, dim=-1), torch.stack(second, dim=-1)
