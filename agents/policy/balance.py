"""Balance term of the torque head: standing legs push the centre of mass back.

The desired force of the floor on the body is M a with

    a = bounded(kp (c_ref - c) + kd (v_ref - v)),

where c and v are position and velocity of the whole body's centre of mass. The force is split
between the feet in proportion to their vertical contact forces. The six hinges of each leg produce
tau = -J^T F_share. J is the Jacobian of the point c moving rigidly with that foot, so that no
moment about c remains. (The Jacobian transpose is virtual model control, Pratt et al. 2001.) The
term is a smooth function of the observation: the centre of mass is linear in positions and
orientations of the links.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from agents.policy.observed_state import LEG_DOFS, ObservedState
from agents.policy.spec import Layout
from agents.policy.stepping import (
    CAPTURE_RATE,
    PLACEMENTS,
    POSITION,
    FootPlacement,
    Stepping,
)
from questsim.body import POLICY_TIMESTEP_S, build_body
from questsim.skeleton import FOOT_LINKS, NUM_DOFS, NUM_LINKS

PUSHES = 3
"""An acceleration: forwards, left and up."""
SIZE = PUSHES * (LEG_DOFS + 2)
"""Size of the terms of one observation: basis, position error and velocity error."""


OUTPUTS = {"feet": PUSHES, "placement": PUSHES + PLACEMENTS}
"""Outputs of a student's network for the term, by the kind of balance."""


class Gains(NamedTuple):
    """Gains of the centre of mass, forwards, left and up, and the limit of the acceleration.

    The trained values stay above the least ones, so that training on narrow data keeps balance. The
    acceleration is bounded because soles are short: g / h times 10 cm from ankle to centre of
    pressure is 1 m/s^2; a torque for more rolls the foot over.

    Attributes:
        kp, least_kp: start values and lower bounds in 1/s^2.
        kd, least_kd: the same in 1/s.
        limit, least_limit: of the horizontal acceleration in m/s^2.
    """

    kp: tuple[float, float, float]
    kd: tuple[float, float, float]
    limit: float
    least_kp: tuple[float, float, float]
    least_kd: tuple[float, float, float]
    least_limit: float


STANDING = Gains(
    (20.0, 20.0, 10.0), (5.0, 5.0, 2.5), 1.25, (10.0, 10.0, 5.0), (3.0, 3.0, 1.5), 0.75
)
STEPPING = Gains((9.6, 6.2, 16.2), (6.6, 10.0, 14.0), 0.76, (5.0, 2.5, 8.0), (3.0, 3.0, 5.0), 0.4)
"""With the laws of ``stepping.py``: less against drifting aside, much more against sinking."""
FLIGHT = 0.05
"""Feet that carry less than this share of the weight apply little of the correction."""

FOOT_AHEAD_M = 0.04
"""Distance in m of a standing person's centre of mass in front of the ankles (stature 1.75 m)."""


class Balance(nn.Module):
    """Leg torques that move the centre of mass to its target.

    Args:
        layout: the observation's blocks.
        kind: ``reference``: the target is the reference's centre of mass, from the observation's
            ``tracking_errors``. ``steps``: so too, with the laws of ``stepping.py``. ``feet``: the
            target is midway between the feet and moves with them: the average position in both
            stance and gait. The network then adds the difference to the reference. ``placement``:
            the same, with ``FootPlacement``.
    """

    columns: Tensor
    errors: Tensor | None
    mass_share: Tensor
    centre: Tensor
    strength: Tensor
    least_kp: Tensor
    least_kd: Tensor

    def __init__(self, layout: Layout, kind: str) -> None:
        super().__init__()
        model = build_body().model
        mass = model.body_mass[1 : 1 + NUM_LINKS]
        limits = model.actuator_ctrlrange[:LEG_DOFS, 1]
        self.reference = kind not in OUTPUTS
        self.stepping = Stepping() if kind == "steps" else None
        self.placement = FootPlacement() if kind == "placement" else None
        first = STEPPING if kind == "steps" else STANDING

        def buffer(name: str, value: np.ndarray) -> None:
            tensor = torch.as_tensor(value, dtype=torch.float32)
            self.register_buffer(name, tensor, persistent=False)

        buffer("mass_share", mass / mass.sum())
        buffer("centre", model.body_ipos[1 : 1 + NUM_LINKS])
        # Masses and torque limits scale alike with height: their ratio is the same for all bodies.
        buffer("strength", mass.sum() / limits)
        buffer("least_kp", np.array(first.least_kp))
        buffer("least_kd", np.array(first.least_kd))
        self.weight_n = float(mass.sum() * 9.81)
        self.least_limit = first.least_limit
        self.log_kp = _logarithm(np.subtract(first.kp, first.least_kp))
        self.log_kd = _logarithm(np.subtract(first.kd, first.least_kd))
        self.log_limit = _logarithm(np.array(first.limit - first.least_limit))
        self.register_buffer("columns", None, persistent=False)
        self.register_buffer("errors", None, persistent=False)
        self.use_layout(layout)

    def use_layout(self, layout: Layout) -> None:
        """Find the columns of its inputs in the observation."""
        height = layout.columns(("o_scale",))[:1]  # proportions may follow it
        self.columns = torch.as_tensor(np.concatenate([layout.columns(("o_sim",)), height]))
        if self.reference:
            self.errors = torch.as_tensor(layout.columns(("tracking_errors",)))

    def terms(self, obs: Tensor) -> Tensor:
        """Terms ``(n, SIZE)`` of observations ``(n, D)``, in which the torques are linear.

        They are the actions of the 12 hinges per unit acceleration in S, ``(12, 3)``, and position
        and velocity errors of the centre of mass, three numbers each. Those of ``Stepping`` or
        ``FootPlacement`` follow.
        """
        state = ObservedState(obs.index_select(1, self.columns))
        offset = self.centre * state.ratio[:, None]
        arm = state.rotated(offset)
        centre = self._mean(state.position + arm)
        velocity = self._mean(state.velocity + torch.linalg.cross(state.spin, arm))
        hinges = state.hinges()
        basis = self._basis(state, hinges, centre)
        if self.errors is None:
            place, speed = self._from_feet(state, centre, velocity)
            terms = [basis.flatten(1), place, speed]
            if self.placement is not None:
                terms.append(self.placement.terms(state, hinges, self.strength, self.weight_n))
            return torch.cat(terms, dim=1)
        errors = obs.index_select(1, self.errors).unflatten(1, (NUM_LINKS, 4, 3))
        place, speed = self._from_reference(state, errors, offset, arm)
        # The torque acts until the next frame, so the reference is taken midway.
        midway = place + (0.5 * POLICY_TIMESTEP_S) * (speed + velocity)
        terms = [basis.flatten(1), midway, speed]
        if self.stepping is not None:
            capture = -(POSITION * place + speed / CAPTURE_RATE)
            terms.append(
                self.stepping.terms(state, hinges, errors, capture, self.strength, self.weight_n)
            )
        return torch.cat(terms, dim=1)

    def forward(self, terms: Tensor, push: Tensor | None = None) -> Tensor:
        """The balance part of the action ``(n, 33)`` for rows of ``terms``.

        Args:
            terms: of ``terms``.
            push: outputs of the network in m/s^2, in S: ``(n, 3)`` an additional acceleration, then
                those for ``FootPlacement``.
        """
        basis = terms[:, : LEG_DOFS * PUSHES].unflatten(1, (LEG_DOFS, PUSHES))
        place, speed = terms[:, LEG_DOFS * PUSHES : SIZE].split(PUSHES, dim=1)
        kp, kd, limit = self.gains()
        wanted = kp * place + kd * speed
        excess = (wanted[:, :2] / limit).square().sum(1, keepdim=True)
        wanted = wanted * torch.rsqrt(1.0 + excess)
        if push is not None:
            wanted = wanted + push[:, :PUSHES]
        legs = (basis * wanted[:, None]).sum(-1)
        if self.stepping is not None:
            legs = legs + self.stepping(terms[:, SIZE:])
        if self.placement is not None and push is not None:
            legs = legs + self.placement(terms[:, SIZE:], push[:, PUSHES:])
        return nn.functional.pad(legs, (0, NUM_DOFS - LEG_DOFS))

    def softness(self, terms: Tensor) -> Tensor | None:
        """Factors ``(n, 33)`` of the springs; None if they are always 1."""
        law = self.stepping if self.placement is None else self.placement
        return None if law is None else law.softness(terms[:, SIZE:])

    def gains(self) -> tuple[Tensor, Tensor, Tensor]:
        """Kp in 1/s^2 and kd in 1/s, ``(3,)`` each: forwards, left and up; limit in m/s^2."""
        limit = self.least_limit + self.log_limit.exp()
        return self.least_kp + self.log_kp.exp(), self.least_kd + self.log_kd.exp(), limit

    def _mean(self, of_links: Tensor) -> Tensor:
        """Mass-weighted mean over links: ``(n, 3)`` of ``(n, 16, 3)``."""
        return (of_links * self.mass_share[:, None]).sum(1)

    def _basis(self, state: ObservedState, hinges: tuple[Tensor, Tensor], centre: Tensor) -> Tensor:
        """``(n, 12, 3)`` action of each hinge of the legs for an acceleration."""
        axes, anchors = hinges
        # -(axis x (c - anchor)) . F: the hinge torque for which the floor force is F.
        lever = torch.linalg.cross(centre[:, None] - anchors, axes)
        load = state.load / (state.load.sum(1, keepdim=True) + FLIGHT * self.weight_n)
        share = load.repeat_interleave(LEG_DOFS // 2, dim=1)
        return lever * (share * self.strength)[:, :, None]

    def _from_reference(
        self, state: ObservedState, errors: Tensor, offset: Tensor, arm: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Position and velocity of the centre of mass, reference minus avatar, ``(n, 3)`` each."""
        place, turn, velocity, spin = errors.unbind(2)
        # 2 sin(angle / 2) times the axis: a quaternion's vector part is half of it.
        half = 0.5 * turn
        real = (1.0 - half.square().sum(-1, keepdim=True)).clamp_min(0.0).sqrt()
        twice = 2.0 * torch.linalg.cross(half, arm)
        moved = real * twice + torch.linalg.cross(half, twice)
        speed = velocity + torch.linalg.cross(state.spin + spin, arm + moved)
        speed = speed - torch.linalg.cross(state.spin, arm)
        return self._mean(place + moved), self._mean(speed)

    def _from_feet(
        self, state: ObservedState, centre: Tensor, velocity: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The same errors, horizontal, with the midpoint of the feet as target, ``(n, 3)`` each."""
        feet = list(FOOT_LINKS)
        flat = torch.tensor([1.0, 1.0, 0.0])
        # In front of the ankles, where a standing person's centre of mass is above the sole.
        ahead = state.first[:, feet] * (FOOT_AHEAD_M * state.ratio[:, None])
        middle = (state.position[:, feet] + ahead).mean(1)
        return flat * (middle - centre), flat * state.velocity[:, feet].mean(1) - velocity


def _logarithm(value: np.ndarray) -> nn.Parameter:
    return nn.Parameter(torch.as_tensor(np.log(value), dtype=torch.float32))
