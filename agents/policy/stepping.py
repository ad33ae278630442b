"""Stepping terms of the torque head: where the swing foot lands, and an upright pelvis.

With them a policy that has learnt nothing follows slow steps in all directions. Three laws:

- Foot placement. A foot in swing is pulled to its reference position, moved by ``ahead`` times the
  error of the capture point c + v / w, w = sqrt(g / h), so that the next stance is under the centre
  of mass again (capture point: Pratt et al. 2006; placement by position and velocity of the centre
  of mass: Raibert 1986, Yin et al. 2007).
- Pelvis. The hips of the standing legs turn the pelvis towards its reference orientation.
- A foot in swing is softer: its springs would stop the body when it lands early.

A student does not observe the reference. Its network gives the accelerations of the swing feet and
of the pelvis itself (``FootPlacement``); the hinges' torques follow from them in the same way.

A foot is in swing while it carries less than ``SWING`` of the weight. Forces are per kilogram of
the body, so that they hold for all statures. The start values were found by a search over the 20
numbers of the head on training clips (docs/torque-head.md).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor, nn

from agents.policy.observed_state import LEG_DOFS, LEG_HINGES, ObservedState
from agents.policy.spec import initial_gains
from questsim.skeleton import DOFS, FOOT_LINKS, NUM_DOFS

SWING = 0.15
"""A foot that carries less than this share of the weight is in swing."""
CAPTURE_RATE = 3.3
"""w of the capture point in 1/s: sqrt(g / h) of a centre of mass 0.9 m above the floor."""
POSITION = 0.6
"""Share of the position in the capture point's error: steps correct a velocity more than a lag."""
LARGEST_ERROR_M = 0.25
"""The capture point's error counts at most this much."""

PLACEMENTS = 7
"""What a network gives to ``FootPlacement``: horizontal accelerations of both feet in
S, and a rotation of the pelvis about the axes of S."""

SIZE = 4 * LEG_DOFS + 2
"""Terms of one observation: actions of the 12 hinges for four laws of unit strength, and the share
of swing of both feet."""

FIRST = {"ahead": 1.5, "place": 10.5, "damp": 1.1, "pelvis": 4.2}
"""Start values: share of the capture point's error; 1/s^2; 1/s; and m^2/s^2 per radian."""
LEAST = 0.3
"""Trained values stay above this share of the start values."""

SOFTER: dict[str, float] = dict(zip(LEG_HINGES, (1.1, 1.1, 1.1, 1.6, 1.4, 1.4), strict=True))
"""A spring of a leg in swing is weaker by the factor exp(-value)."""
STIFFER: dict[str, float] = dict(zip(LEG_HINGES, (0.85, 2.0, 1.1, 1.1, 1.6, 1.3), strict=True))
SLIGHTLY = 0.05
"""``softer`` at the start of a student: its springs are around the zero pose."""
TRUNK, ARMS = 1.35, 0.5
"""Factors of ``start_gains``; ``ARMS`` is also of the neck."""
HIPS = torch.tensor([1.0, 1.0, 1.0, 0.0, 0.0, 0.0] * 2)


def start_gains(balance: str, torque_limits: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Start values of the head's springs, as action per radian ``(33,)``.

    Args:
        balance: of the policy's spec.
        torque_limits, damping: see ``initial_gains``.
    """
    gains = initial_gains(torque_limits, damping)
    if balance != "steps":
        return gains
    rest = [TRUNK if dof.startswith(("spine", "chest")) else ARMS for dof in DOFS[LEG_DOFS:]]
    return gains * [*_by_hinge(STIFFER), *rest]


def _by_hinge(values: Mapping[str, float]) -> list[float]:
    """Values of the 12 hinges of both legs."""
    return [values[name.split("_", 1)[1]] for name in DOFS[:LEG_DOFS]]


class Stepping(nn.Module):
    """Torques of the legs that place the swing foot and turn the pelvis."""

    log_ahead: nn.Parameter
    log_place: nn.Parameter
    log_damp: nn.Parameter
    log_pelvis: nn.Parameter

    def __init__(self) -> None:
        super().__init__()
        for name, value in FIRST.items():
            first = torch.tensor(np.log(value * (1.0 - LEAST)), dtype=torch.float32)
            self.register_parameter(f"log_{name}", nn.Parameter(first))
        self.softer = nn.Parameter(torch.tensor(_by_hinge(SOFTER), dtype=torch.float32))

    def strengths(self) -> dict[str, Tensor]:
        """The trained strengths of the laws, by the names of ``FIRST``."""
        return {
            name: LEAST * value + getattr(self, f"log_{name}").exp()
            for name, value in FIRST.items()
        }

    def terms(
        self,
        state: ObservedState,
        hinges: tuple[Tensor, Tensor],
        errors: Tensor,
        capture: Tensor,
        strength: Tensor,
        weight_n: float,
    ) -> Tensor:
        """Terms ``(n, SIZE)``, in which the action is linear.

        Args:
            state: of ``n`` avatars.
            hinges: axes of the legs' hinges and points on them, see ``ObservedState.hinges``.
            errors: ``(n, 16, 4, 3)`` the observation's tracking errors.
            capture: ``(n, 3)`` capture point, avatar minus reference, in m.
            strength: ``(12,)`` mass over torque limit of each hinge, kg / (N m).
            weight_n: of the 1.75 m body, whose contact forces the observation has.
        """
        feet = list(FOOT_LINKS)
        flat = torch.tensor([1.0, 1.0, 0.0])
        length = capture.mul(flat).square().sum(1, keepdim=True).sqrt().clamp_min(1e-9)
        aside = capture * flat * (length.clamp_max(LARGEST_ERROR_M) / length)
        forces = torch.stack(
            [
                aside[:, None].expand(-1, 2, -1),
                errors[:, feet, 0] * flat,
                errors[:, feet, 2] * flat,
            ],
            dim=1,
        )  # (n, law, foot, 3)
        swing = _swing(state, weight_n)
        on_foot = (forces * swing[:, None, :, None]).repeat_interleave(LEG_DOFS // 2, dim=2)
        placed = (_lever(state, hinges, strength)[:, None] * on_foot).sum(-1)
        moment = -(hinges[0] * errors[:, 0, 1][:, None]).sum(-1)
        turned = moment * _hip_share(state, weight_n) * strength
        return torch.cat([placed.flatten(1), turned, swing], dim=1)

    def forward(self, terms: Tensor) -> Tensor:
        """Actions ``(n, 12)`` of the hinges of the legs for rows of ``terms``."""
        ahead, foot, moving, turned, _ = terms.split((*[LEG_DOFS] * 4, 2), dim=1)
        gain = self.strengths()
        place = gain["place"] * (gain["ahead"] * ahead + foot) + gain["damp"] * moving
        return place + gain["pelvis"] * turned

    def softness(self, terms: Tensor) -> Tensor:
        """Factors ``(n, 33)`` of the springs: below 1 for a leg in swing."""
        return _softness(self.softer, terms[:, -2:])


class FootPlacement(nn.Module):
    """Torques of the legs for the accelerations that a network asks of swing feet and pelvis."""

    def __init__(self) -> None:
        super().__init__()
        self.softer = nn.Parameter(torch.full((LEG_DOFS,), SLIGHTLY))

    def terms(
        self, state: ObservedState, hinges: tuple[Tensor, Tensor], strength: Tensor, weight_n: float
    ) -> Tensor:
        """Terms ``(n, 62)``; see ``Stepping.terms`` for the arguments.

        They are the actions of the 12 hinges for a unit acceleration forwards and left of the foot
        of the hinge's leg, ``(12, 2)``, and for a unit rotation of the pelvis, ``(12, 3)``; then
        the share of swing of both feet.
        """
        swing = _swing(state, weight_n)
        of_leg = swing.repeat_interleave(LEG_DOFS // 2, dim=1)[:, :, None]
        placed = _lever(state, hinges, strength)[:, :, :2] * of_leg
        share = _hip_share(state, weight_n) * strength
        turned = -hinges[0] * share[:, :, None]
        return torch.cat([placed.flatten(1), turned.flatten(1), swing], dim=1)

    def forward(self, terms: Tensor, asked: Tensor) -> Tensor:
        """Actions ``(n, 12)`` of the hinges of the legs.

        Args:
            terms: of ``terms``.
            asked: ``(n, 7)``, see ``PLACEMENTS``.
        """
        placed, turned, _ = terms.split((2 * LEG_DOFS, 3 * LEG_DOFS, 2), dim=1)
        feet = asked[:, :4].unflatten(1, (2, 2)).repeat_interleave(LEG_DOFS // 2, dim=1)
        legs = (placed.unflatten(1, (LEG_DOFS, 2)) * feet).sum(-1)
        return legs + (turned.unflatten(1, (LEG_DOFS, 3)) * asked[:, None, 4:]).sum(-1)

    def softness(self, terms: Tensor) -> Tensor:
        """Factors ``(n, 33)`` of the springs: below 1 for a leg in swing."""
        return _softness(self.softer, terms[:, -2:])


def _swing(state: ObservedState, weight_n: float) -> Tensor:
    """Share of swing ``(n, 2)`` of both feet: 1 without load, 0 from ``SWING`` of the weight."""
    return (1.0 - state.load / (SWING * weight_n)).clamp(0.0, 1.0)


def _lever(state: ObservedState, hinges: tuple[Tensor, Tensor], strength: Tensor) -> Tensor:
    """``(n, 12, 3)`` action of each hinge for a unit acceleration of the body on its foot."""
    axes, anchors = hinges
    foot = state.position[:, list(FOOT_LINKS)].repeat_interleave(LEG_DOFS // 2, dim=1)
    return torch.linalg.cross(axes, foot - anchors) * strength[:, None]


def _hip_share(state: ObservedState, weight_n: float) -> Tensor:
    """Share ``(n, 12)`` of each hip hinge in turning the pelvis, by its leg's load; others 0."""
    load = state.load / (state.load.sum(1, keepdim=True) + SWING * weight_n)
    return load.repeat_interleave(LEG_DOFS // 2, dim=1) * HIPS


def _softness(softer: Tensor, swing: Tensor) -> Tensor:
    legs = torch.exp(-softer.clamp_min(0.0) * swing.repeat_interleave(LEG_DOFS // 2, dim=1))
    return nn.functional.pad(legs, (0, NUM_DOFS - LEG_DOFS), value=1.0)
