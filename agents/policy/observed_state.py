"""Positions, velocities and leg hinges of avatars, read from the columns of an observation."""

from __future__ import annotations

import torch
from torch import Tensor

from questsim.body import DEFAULT_HEIGHT_M
from questsim.skeleton import DOFS, LINKS, NUM_DOFS, NUM_LINKS

SIDES = ("left", "right")
LEG_HINGES = ("hip_y", "hip_x", "hip_z", "knee_y", "ankle_y", "ankle_x")
LEG_DOFS = len(SIDES) * len(LEG_HINGES)
"""Hinges of both legs, the first of all hinges."""
assert DOFS[:LEG_DOFS] == tuple(f"{side}_{hinge}" for side in SIDES for hinge in LEG_HINGES)

_HIP, _KNEE, _ANKLE = 3, 1, 2


class ObservedState:
    """The state of ``n`` avatars from ``o_sim`` and ``o_scale``, all in the frame S."""

    def __init__(self, columns: Tensor) -> None:
        angles, _, position, turn, velocity, spin, force, height = columns.split(
            (NUM_DOFS, NUM_DOFS, 3 * NUM_LINKS, 6 * NUM_LINKS, 3 * NUM_LINKS, 3 * NUM_LINKS, 6, 1),
            dim=1,
        )
        self.position = position.unflatten(1, (NUM_LINKS, 3))
        self.first, self.second = turn.unflatten(1, (NUM_LINKS, 2, 3)).unbind(2)
        self.third = torch.linalg.cross(self.first, self.second)
        self.velocity = velocity.unflatten(1, (NUM_LINKS, 3))
        self.spin = spin.unflatten(1, (NUM_LINKS, 3))
        self.load = force.unflatten(1, (2, 3))[:, :, 2].clamp_min(0.0)
        self.ratio = height / DEFAULT_HEIGHT_M
        self._hip_y = angles[:, [DOFS.index(f"{side}_hip_y") for side in SIDES]]

    def rotated(self, offset: Tensor) -> Tensor:
        """Vectors ``(n, 16, 3)`` of the links' own frames in S."""
        x, y, z = offset.unsqueeze(-1).unbind(-2)
        return x * self.first + y * self.second + z * self.third

    def hinges(self) -> tuple[Tensor, Tensor]:
        """Axes of the legs' hinges and points on them, ``(n, 12, 3)`` each."""
        axes, anchors = [], []
        for side, name in enumerate(SIDES):
            thigh, shin, foot = (LINKS.index(f"{name}_{p}") for p in ("thigh", "shin", "foot"))
            angle = self._hip_y[:, side, None]
            # The second hinge of the hip turns with the first, about the pelvis' y axis.
            hip_x = torch.cos(angle) * self.first[:, 0] - torch.sin(angle) * self.third[:, 0]
            axes += [self.second[:, 0], hip_x, self.third[:, thigh], self.second[:, thigh]]
            axes += [self.second[:, shin], self.first[:, foot]]
            for link, hinges in ((thigh, _HIP), (shin, _KNEE), (foot, _ANKLE)):
                anchors += hinges * [self.position[:, link]]
        return torch.stack(axes, 1), torch.stack(anchors, 1)
