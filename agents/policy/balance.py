"""Balance as a term of the torque head: the centre of mass, pushed back through standing legs.

The floor should push the body with M a, where

    a = bounded(kp (c_ref - c) + kd (v_ref - v)),

c and v place and velocity of the whole body's centre of mass. Each foot takes its share of that by
its share of the vertical contact force, and the six hinges of its leg give tau = -J^T F_share. J is
the Jacobian of the point c carried along by that foot, so that no moment about c is left. (The
Jacobian transpose is virtual model control, Pratt et al. 2001.) All of it is a smooth function of
the observation: the centre of mass is linear in places and orientations of the links.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from agents.policy.spec import Layout
from questsim.body import DEFAULT_HEIGHT_M, POLICY_TIMESTEP_S, build_body
from questsim.skeleton import DOFS, FOOT_LINKS, LINKS, NUM_DOFS, NUM_LINKS

LEG_DOFS = 12
"""The legs' hinges are the first of ``DOFS``."""
PUSHES = 3
"""An acceleration: forwards, left and up."""
SIZE = PUSHES * (LEG_DOFS + 2)
"""Numbers of the terms of one observation: basis, error of place and error of velocity."""

LEAST_KP, LEAST_KD, LEAST_LIMIT = 10.0, 3.0, 0.75
"""Trained values stay above these (1/s^2, 1/s, m/s^2): narrow data does not unlearn balance."""
FIRST_KP, FIRST_KD, FIRST_LIMIT = 20.0, 5.0, 1.25
"""Where training begins. The acceleration is bounded since soles are short: g / h times 10 cm from
ankle to centre of pressure is 1 m/s^2, and a torque that asks for more rolls the foot over."""
VERTICAL = 0.5
"""Share of the gains that acts vertically."""
FLIGHT = 0.05
"""Feet that carry less than this share of the weight carry little of the correction."""

FOOT_AHEAD_M = 0.04
"""A standing person's centre of mass is this far in front of the ankles (1.75 m)."""

_HIP, _KNEE, _ANKLE = 3, 1, 2
_SIDES = ("left", "right")
assert DOFS[:LEG_DOFS] == tuple(
    f"{side}_{hinge}"
    for side in _SIDES
    for hinge in ("hip_y", "hip_x", "hip_z", "knee_y", "ankle_y", "ankle_x")
)


class Balance(nn.Module):
    """Torques of the legs that bring the centre of mass to where it should be.

    Args:
        layout: the observation's blocks.
        reference: whether the centre of mass should be the reference's, as the observation's
            ``tracking_errors`` have it; else it should be midway between the feet, and move
            with them. That is where it is on average in stance and gait alike; what is missing of
            the reference's is then for the network to add.
    """

    columns: Tensor
    errors: Tensor | None
    mass_share: Tensor
    centre: Tensor
    strength: Tensor
    least_kp: Tensor
    least_kd: Tensor

    def __init__(self, layout: Layout, reference: bool) -> None:
        super().__init__()
        model = build_body().model
        mass = model.body_mass[1 : 1 + NUM_LINKS]
        limits = model.actuator_ctrlrange[:LEG_DOFS, 1]
        self.reference = reference
        vertical = np.array([1.0, 1.0, VERTICAL])

        def buffer(name: str, value: np.ndarray) -> None:
            tensor = torch.as_tensor(value, dtype=torch.float32)
            self.register_buffer(name, tensor, persistent=False)

        buffer("mass_share", mass / mass.sum())
        buffer("centre", model.body_ipos[1 : 1 + NUM_LINKS])
        # Masses and torque limits grow alike with height, so their ratio is any body's.
        buffer("strength", mass.sum() / limits)
        buffer("least_kp", LEAST_KP * vertical)
        buffer("least_kd", LEAST_KD * vertical)
        self.weight_n = float(mass.sum() * 9.81)
        self.log_kp = _logarithm((FIRST_KP - LEAST_KP) * vertical)
        self.log_kd = _logarithm((FIRST_KD - LEAST_KD) * vertical)
        self.log_limit = _logarithm(np.array(FIRST_LIMIT - LEAST_LIMIT))
        self.register_buffer("columns", None, persistent=False)
        self.register_buffer("errors", None, persistent=False)
        self.use_layout(layout)

    def use_layout(self, layout: Layout) -> None:
        """Find what it reads in the observation."""
        self.columns = torch.as_tensor(layout.columns(("o_sim", "o_scale")))
        if self.reference:
            self.errors = torch.as_tensor(layout.columns(("tracking_errors",)))

    def terms(self, obs: Tensor) -> Tensor:
        """Of observations ``(n, D)`` what the torques are linear in: ``(n, SIZE)``.

        These are actions of the 12 hinges by an acceleration in S, ``(12, 3)``, and the errors of
        place and of velocity of the centre of mass, three numbers each.
        """
        state = _State(obs.index_select(1, self.columns))
        offset = self.centre * state.ratio[:, None]
        arm = state.rotated(offset)
        centre = self._mean(state.position + arm)
        velocity = self._mean(state.velocity + torch.linalg.cross(state.spin, arm))
        basis = self._basis(state, centre)
        if self.errors is None:
            place, speed = self._from_feet(state, centre, velocity)
        else:
            errors = obs.index_select(1, self.errors).unflatten(1, (NUM_LINKS, 4, 3))
            place, speed = self._from_reference(state, errors, offset, arm)
            # The torque acts until the next frame: the reference is midway to it.
            place = place + (0.5 * POLICY_TIMESTEP_S) * (speed + velocity)
        return torch.cat([basis.flatten(1), place, speed], dim=1)

    def forward(self, terms: Tensor, push: Tensor | None = None) -> Tensor:
        """The part of the action ``(n, 33)`` for rows of ``terms``.

        Args:
            terms: ``(n, SIZE)``.
            push: ``(n, 3)`` m/s^2 of acceleration beside it, in S.
        """
        basis = terms[:, : LEG_DOFS * PUSHES].unflatten(1, (LEG_DOFS, PUSHES))
        place, speed = terms[:, LEG_DOFS * PUSHES :].split(PUSHES, dim=1)
        kp, kd, limit = self.gains()
        wanted = kp * place + kd * speed
        excess = (wanted[:, :2] / limit).square().sum(1, keepdim=True)
        wanted = wanted * torch.rsqrt(1.0 + excess)
        if push is not None:
            wanted = wanted + push
        legs = (basis * wanted[:, None]).sum(-1)
        return nn.functional.pad(legs, (0, NUM_DOFS - LEG_DOFS))

    def gains(self) -> tuple[Tensor, Tensor, Tensor]:
        """Kp in 1/s^2 and kd in 1/s, ``(3,)`` each: forwards, left and up; limit in m/s^2."""
        limit = LEAST_LIMIT + self.log_limit.exp()
        return self.least_kp + self.log_kp.exp(), self.least_kd + self.log_kd.exp(), limit

    def _mean(self, of_links: Tensor) -> Tensor:
        """Mean over links by mass: ``(n, 3)`` of ``(n, 16, 3)``."""
        return (of_links * self.mass_share[:, None]).sum(1)

    def _basis(self, state: _State, centre: Tensor) -> Tensor:
        """``(n, 12, 3)`` action of each hinge of the legs for an acceleration."""
        axes, anchors = state.hinges()
        # -(axis x (c - anchor)) . F: what the hinge has to give so that the floor gives F.
        lever = torch.linalg.cross(centre[:, None] - anchors, axes)
        load = state.load / (state.load.sum(1, keepdim=True) + FLIGHT * self.weight_n)
        share = load.repeat_interleave(LEG_DOFS // 2, dim=1)
        return lever * (share * self.strength)[:, :, None]

    def _from_reference(
        self, state: _State, errors: Tensor, offset: Tensor, arm: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Reference less avatar of the centre's place and velocity, ``(n, 3)`` each."""
        place, turn, velocity, spin = errors.unbind(2)
        # 2 sin(angle / 2) times the axis: a quaternion's vector part is half of it.
        half = 0.5 * turn
        real = (1.0 - half.square().sum(-1, keepdim=True)).clamp_min(0.0).sqrt()
        twice = 2.0 * torch.linalg.cross(half, arm)
        moved = real * twice + torch.linalg.cross(half, twice)
        speed = velocity + torch.linalg.cross(state.spin + spin, arm + moved)
        speed = speed - torch.linalg.cross(state.spin, arm)
        return self._mean(place + moved), self._mean(speed)

    def _from_feet(self, state: _State, centre: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        """Midway between the feet less avatar, horizontally, ``(n, 3)`` each."""
        feet = list(FOOT_LINKS)
        flat = torch.tensor([1.0, 1.0, 0.0])
        # Ahead of the ankles: where a standing person's weight is over the sole.
        ahead = state.first[:, feet] * (FOOT_AHEAD_M * state.ratio[:, None])
        middle = (state.position[:, feet] + ahead).mean(1)
        return flat * (middle - centre), flat * state.velocity[:, feet].mean(1) - velocity


def _logarithm(value: np.ndarray) -> nn.Parameter:
    return nn.Parameter(torch.as_tensor(np.log(value), dtype=torch.float32))


class _State:
    """What ``o_sim`` and ``o_scale`` say of ``n`` avatars, all in the frame S."""

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
        self._hip_y = angles[:, [DOFS.index(f"{side}_hip_y") for side in _SIDES]]

    def rotated(self, offset: Tensor) -> Tensor:
        """Vectors ``(n, 16, 3)`` of the links' own frames in S."""
        x, y, z = offset.unsqueeze(-1).unbind(-2)
        return x * self.first + y * self.second + z * self.third

    def hinges(self) -> tuple[Tensor, Tensor]:
        """Axes of the legs' hinges and points on them, ``(n, 12, 3)`` each."""
        axes, anchors = [], []
        for side, name in enumerate(_SIDES):
            thigh, shin, foot = (LINKS.index(f"{name}_{p}") for p in ("thigh", "shin", "foot"))
            angle = self._hip_y[:, side, None]
            # The second hinge of the hip turns with the first, about the pelvis' y axis.
            hip_x = torch.cos(angle) * self.first[:, 0] - torch.sin(angle) * self.third[:, 0]
            axes += [self.second[:, 0], hip_x, self.third[:, thigh], self.second[:, thigh]]
            axes += [self.second[:, shin], self.first[:, foot]]
            for link, hinges in ((thigh, _HIP), (shin, _KNEE), (foot, _ANKLE)):
                anchors += hinges * [self.position[:, link]]
        return torch.stack(axes, 1), torch.stack(anchors, 1)
