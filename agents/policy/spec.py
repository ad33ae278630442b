"""The spec of a policy: its networks and head, and the observation blocks that it needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from questsim.errors import InputError

SPARSE_BLOCKS: tuple[str, ...] = ("o_sim", "o_user", "o_scale")
"""Observation blocks of a headset-driven policy (QuestSim, section 4.2)."""

TRACKER_BLOCKS: tuple[str, ...] = ("o_sim", "o_scale", "privileged")
"""Observation blocks of a full-body tracker: the reference instead of the devices."""

JOINT_BLOCK, REFERENCE_BLOCK = "joint_angles", "midway_joint_angles"
"""The blocks of joint angles that the torque head compares."""

TORQUE_BLOCK = "reference_torques"
"""The block that a torque head around the reference adds unchanged."""

ACTIVATIONS: tuple[str, ...] = ("tanh", "elu", "silu")

BALANCE: tuple[str, ...] = ("none", "reference", "steps", "feet", "placement")

# Exploration noise by joint: large for strong joints, where errors do not end the episode, small
# for light limbs, which would only tremble (found by trial: 0.12 for legs and trunk, 0.04 for arms
# and neck).

HEAD_SETTLING_TIME_S = 0.08
"""The initial stiffness is 4 x damping over this time.

A torque held for T acts with a delay of T / 2, which reduces a joint's damping c by kp T / 2. Above
kp = 2 c / T = 72 c the spring oscillates by itself. 0.08 s gives 50 c, 0.04 s would give 100 c."""


@dataclass(frozen=True)
class PolicySpec:
    """The shape of a policy's networks and of its torque head.

    Attributes:
        actor_blocks: names of the observation blocks that the actor reads, in order.
        critic_blocks: those that the critic reads; empty for a policy without critic.
        hidden: widths of the hidden layers of both actor and critic.
        activation: ``tanh``, ``elu`` or ``silu``.
        torque_head: whether to add the proportional term to the actor's output.
        reference_head: whether the proportional term is around the reference pose and added to the
            inverse-dynamics torques of the motion (otherwise it is around the zero pose).
        balance: feedback on the centre of mass through the standing legs as a term of the head,
            see ``balance.py``: towards the ``reference``; ``steps``, the same with foot placement
            (``stepping.py``); towards the midpoint of the ``feet``, plus an acceleration from the
            network; ``placement``, the same with forces on the swing feet and a moment on the
            pelvis from the network; or ``none``.
    """

    actor_blocks: tuple[str, ...] = SPARSE_BLOCKS
    critic_blocks: tuple[str, ...] = SPARSE_BLOCKS
    hidden: tuple[int, ...] = (400, 300, 200)
    activation: str = "tanh"
    torque_head: bool = True
    reference_head: bool = False
    balance: str = "none"

    def __post_init__(self) -> None:
        if self.activation not in ACTIVATIONS:
            known = ", ".join(ACTIVATIONS)
            raise InputError(
                f"unknown activation {self.activation!r}", "PolicySpec", f"use {known}"
            )
        if self.balance not in BALANCE:
            known = ", ".join(BALANCE)
            raise InputError(f"balance is {self.balance!r}, not one of {known}", "PolicySpec")
        if self.balance != "none" and not self.torque_head:
            raise InputError("balance is a term of the torque head", "PolicySpec", "add the head")
        if "o_teacher" in (*self.actor_blocks, *self.critic_blocks):
            what = "a policy cannot read 'o_teacher', which only its training has, for the teacher"
            raise InputError(what, "PolicySpec", "use 'o_user'")

    @property
    def read_blocks(self) -> tuple[str, ...]:
        """Blocks that actions depend on: the actor's, and the stature for the balance term."""
        stature = ("o_scale",) if self.balance != "none" else ()
        return tuple(dict.fromkeys((*self.actor_blocks, *stature)))


@dataclass(frozen=True)
class Layout:
    """The named blocks of a flat observation.

    Attributes:
        blocks: first and one-past-last column of each block.
    """

    blocks: dict[str, tuple[int, int]] = field(default_factory=dict)

    @classmethod
    def of(cls, slices: Mapping[str, slice]) -> Layout:
        """The layout of an environment's ``layout`` dictionary of slices."""
        return cls({name: (int(s.start), int(s.stop)) for name, s in slices.items()})

    def columns(self, names: tuple[str, ...]) -> np.ndarray:
        """Column indices of the named blocks, one after the other.

        Raises:
            InputError: if there is no such block.
        """
        for name in names:
            if name not in self.blocks:
                raise InputError(
                    f"the observation has no block {name!r}; it has {', '.join(self.blocks)}",
                    fix="use an environment with that block (privileged=True for a teacher)",
                )
        if not names:
            return np.zeros(0, dtype=np.int64)
        return np.concatenate([np.arange(*self.blocks[name]) for name in names])

    def within(self, names: tuple[str, ...]) -> Layout:
        """The blocks whose columns all belong to the named blocks: those a policy depends on."""
        used = set(self.columns(names).tolist())
        return Layout({n: b for n, b in self.blocks.items() if used.issuperset(range(*b))})

    def sizes(self) -> dict[str, int]:
        """Number of columns of each block."""
        return {name: stop - start for name, (start, stop) in self.blocks.items()}

    def check_provides(self, needed: Layout, where: str | None = None) -> None:
        """Refuse an observation without a needed block, or with another block size or inner order.

        Args:
            needed: the blocks a policy was trained with.
            where: the policy's name, for the message.

        Raises:
            InputError: names the first block that differs.
        """
        sizes = self.sizes()
        for name, size in needed.sizes().items():
            if sizes.get(name) != size:
                have = f"has {sizes[name]}" if name in sizes else "lacks it"
                raise InputError(
                    f"the policy reads {size} numbers of {name!r}, the observation {have}",
                    where,
                    "use the sensors and number of future frames it was trained with",
                )
        for outer, (start, stop) in needed.blocks.items():
            for inner, (inner_start, inner_stop) in needed.blocks.items():
                inside = start <= inner_start and inner_stop <= stop
                shift = self.blocks[inner][0] - self.blocks[outer][0]
                if inside and shift != inner_start - start:
                    raise InputError(f"block {inner!r} has another place in {outer!r}", where)


def initial_gains(torque_limits: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Start values of the torque head, as action per radian ``(33,)``.

    Args:
        torque_limits: ``(33,)`` N m.
        damping: ``(33,)`` passive joint damping in N m s/rad.
    """
    # A joint without damping (preset `paper`) still needs a positive gain: 1 % of its limit.
    stiffness = 4.0 * damping / HEAD_SETTLING_TIME_S
    return np.maximum(stiffness / torque_limits, 0.01)


def noise_by_joint(strong: np.ndarray, legs_and_trunk: float, arms_and_neck: float) -> np.ndarray:
    """Standard deviation of the exploration noise ``(33,)``, in units of the action.

    Args:
        strong: ``(33,)`` bool, the hinges of legs and trunk.
        legs_and_trunk, arms_and_neck: standard deviations of the two groups.
    """
    return np.where(strong, legs_and_trunk, arms_and_neck)
