"""The torque policy: actor and critic with input normalisers, and a proportional torque head."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.distributions import Distribution
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import Schedule
from torch import Tensor, nn

from agents.policy.balance import OUTPUTS, Balance
from agents.policy.spec import (
    ACTIVATIONS,
    JOINT_BLOCK,
    REFERENCE_BLOCK,
    TORQUE_BLOCK,
    Layout,
    PolicySpec,
)
from agents.precision import native_bfloat16

_ACTIVATIONS = dict(zip(ACTIVATIONS, (nn.Tanh, nn.ELU, nn.SiLU), strict=True))

CLIP = 10.0
"""Normalised observations are clipped to this many standard deviations."""

MIN_STD = 0.01
"""Smallest standard deviation: keeps constant inputs (a single height) from being amplified."""

OfAll = Callable[[Tensor], list[Tensor]]
"""Gives a tensor of every worker for one's own."""

PUSH_SCALE = 10.0
"""Scale in m/s^2 of the network's acceleration outputs; other outputs have scale 1."""


class RunningNorm(nn.Module):
    """Subtracts the running mean of each input and divides by its standard deviation.

    It changes only when ``merge`` is called, so that a rollout and its update compute the same
    probabilities.
    """

    mean: Tensor
    var: Tensor
    count: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("var", torch.ones(size))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))
        self.held: Tensor | None = None

    def hold(self) -> None:
        """From now on, keep the statistics of all inputs that have varied so far.

        A network that is trained further would be another function with other statistics: in a
        trial, avatars of a good tracker fell more often before its weights had changed at all.
        Inputs that were constant, like the stature in a training of one body, get statistics yet.
        """
        if self.count.item() > 0:
            self.held = self.var.sqrt() > MIN_STD

    def forward(self, x: Tensor) -> Tensor:
        """Normalise ``x`` ``(n, size)``."""
        return ((x - self.mean) / self.var.sqrt().clamp_min(MIN_STD)).clamp_(-CLIP, CLIP)

    @torch.no_grad()
    def merge(self, rows: int, mean: Tensor, var: Tensor) -> None:
        """Merge the statistics of ``rows`` rows (Chan et al. 1979).

        Args:
            rows: their number.
            mean, var: ``(size,)`` mean and variance of each input over them.
        """
        total = self.count + rows
        share = (rows / total).item()
        delta = mean - self.mean
        new_var = (1 - share) * self.var + share * var + share * (1 - share) * delta**2
        if self.held is not None:
            delta, new_var = delta.masked_fill(self.held, 0.0), self.var.where(self.held, new_var)
        self.mean += share * delta
        self.var.copy_(new_var)
        self.count.copy_(total)


def mean_and_variance(rows: Tensor) -> Tensor:
    """Mean and variance ``(2, D)`` over the rows ``(n, D)``.

    Two passes take a sixth of the time of ``torch.var_mean`` over the first dimension.
    """
    mean = rows.mean(0)
    return torch.stack([mean, (rows - mean).square_().mean(0)])


class Network(nn.Module):
    """A normaliser of some columns of the observation, and a multi-layer perceptron on them."""

    columns: Tensor

    def __init__(
        self, columns: np.ndarray, spec: PolicySpec, outputs: int, output_gain: float
    ) -> None:
        super().__init__()
        # Not saved: column positions depend on the environment; the policy stores block names.
        self.register_buffer("columns", torch.as_tensor(columns), persistent=False)
        self.norm = RunningNorm(len(columns))
        layers: list[nn.Module] = []
        width = len(columns)
        for hidden in spec.hidden:
            layers += [_linear(width, hidden, np.sqrt(2)), _ACTIVATIONS[spec.activation]()]
            width = hidden
        self.layers = nn.Sequential(*layers, _linear(width, outputs, output_gain))
        self.low_precision = False

    def forward(self, obs: Tensor) -> Tensor:
        """Outputs ``(n, outputs)`` for full observations ``(n, D)``.

        With ``low_precision`` set in training, matrix products use bfloat16 at twice the speed.
        Rollout and update agree, since both use this method.
        """
        return self.of_inputs(self.inputs(obs))

    def inputs(self, obs: Tensor) -> Tensor:
        """Normalised input columns of observations ``(n, D)``.

        An update computes them once for a whole rollout; the normaliser is constant meanwhile.
        """
        inputs = self.norm(obs.index_select(1, self.columns))
        return inputs.bfloat16() if self.low_precision else inputs

    def of_inputs(self, inputs: Tensor) -> Tensor:
        """Outputs ``(n, outputs)`` for the result of ``inputs``."""
        with torch.autocast("cpu", torch.bfloat16, enabled=self.low_precision):
            return self.layers(inputs).float()


def _adam(parameters: Iterable[nn.Parameter], rate: float) -> torch.optim.Adam:
    return torch.optim.Adam(parameters, lr=rate, eps=1e-5, fused=True)


def _linear(inputs: int, outputs: int, gain: float) -> nn.Linear:
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


class TorqueHead(nn.Module):
    """gain * (q_ref - q) + tau_ref + balance: the torque policy's action before training.

    ``tau_ref`` are the inverse-dynamics torques of the reference motion; without a reference,
    ``tau_ref`` and ``q_ref`` are zero. ``balance``, if the policy has it, controls the centre of
    mass through the legs (``balance.py``). The action is one torque per joint, held for one step.
    The gains are trained with the network and stay positive.

    Args:
        gains: ``(33,)`` start values, action per radian.
        layout: the observation's blocks.
        spec: the policy's spec.
    """

    joint_columns: Tensor
    reference_columns: Tensor | None
    torque_columns: Tensor | None

    def __init__(self, gains: np.ndarray, layout: Layout, spec: PolicySpec) -> None:
        super().__init__()
        self.log_gain = nn.Parameter(torch.as_tensor(np.log(gains), dtype=torch.float32))
        self.reference = spec.reference_head
        self.balance = None if spec.balance == "none" else Balance(layout, spec.balance)
        for name in ("joint_columns", "reference_columns", "torque_columns"):
            self.register_buffer(name, None, persistent=False)
        self.use_layout(layout)

    def use_layout(self, layout: Layout) -> None:
        """Find the columns of the joint angles (and the reference's) in the observation."""
        self.joint_columns = torch.as_tensor(layout.columns((JOINT_BLOCK,)))
        if self.reference:
            self.reference_columns = torch.as_tensor(layout.columns((REFERENCE_BLOCK,)))
            self.torque_columns = torch.as_tensor(layout.columns((TORQUE_BLOCK,)))
        if self.balance is not None:
            self.balance.use_layout(layout)

    def terms(self, obs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The head's inputs from observations ``(n, D)``.

        Returns:
            q_ref - q in radians ``(n, 33)``; tau_ref ``(n, 33)``, or ``(n, 0)`` without a
            reference; and the terms of ``Balance``, or ``(n, 0)`` without it.
        """
        error, none = -obs.index_select(1, self.joint_columns), obs[:, :0]
        balance = none if self.balance is None else self.balance.terms(obs)
        if self.reference_columns is None or self.torque_columns is None:
            return error, none, balance
        error = error + obs.index_select(1, self.reference_columns)
        return error, obs.index_select(1, self.torque_columns), balance

    def forward(
        self, error: Tensor, torque: Tensor, balance: Tensor, push: Tensor | None = None
    ) -> Tensor:
        """The head's part of the action ``(n, 33)`` for rows of ``terms``.

        Args:
            error, torque, balance: see ``terms``.
            push: accelerations from the network in m/s^2, see ``Balance.forward``.
        """
        action = self.log_gain.exp() * error
        softness = None if self.balance is None else self.balance.softness(balance)
        if softness is not None:
            action = action * softness
        if torque.shape[1]:
            action = action + torque
        return action if self.balance is None else action + self.balance(balance, push)


def with_head(outputs: Tensor, head: TorqueHead | None, terms: tuple[Tensor, ...]) -> Tensor:
    """Mean action ``(n, 33)`` from the actor's outputs and the head's ``terms``.

    Outputs beyond the 33 of the hinges are accelerations for ``Balance``, in units of
    ``PUSH_SCALE``.
    """
    if head is None:
        return outputs
    hinges = terms[0].shape[1]
    if outputs.shape[1] == hinges:
        return outputs + head(*terms)
    return outputs[:, :hinges] + head(*terms, PUSH_SCALE * outputs[:, hinges:])


class TorquePolicy(ActorCriticPolicy):
    """Gaussian policy over torques in [-1, 1], for stable-baselines3's on-policy algorithms.

    The mean is ``actor(o) + gain * (q_ref - q) + tau_ref + balance``. It is not squashed; the
    environment clips the action.

    Args:
        observation_space: box of shape ``(D,)``.
        action_space: box of shape ``(33,)``.
        lr_schedule: stable-baselines3's learning rate schedule.
        spec: networks and head.
        layout: the environment's observation blocks.
        gains: ``(33,)`` start values of the head, action per radian; needed with a head.
        noise: ``(33,)`` start values of the standard deviation.
        learn_noise: whether the standard deviation is trained.
        critic_learning_rate: learning rate of the critic; None for the actor's.
    """

    def __init__(
        self,
        observation_space: spaces.Space,
        action_space: spaces.Space,
        lr_schedule: Schedule,
        *,
        spec: PolicySpec,
        layout: Layout,
        gains: np.ndarray | None = None,
        noise: np.ndarray | float = 0.03,
        learn_noise: bool = True,
        critic_learning_rate: float | None = None,
        use_sde: bool = False,
    ) -> None:
        if use_sde:
            raise ValueError("TorquePolicy has no state-dependent exploration")
        self.spec, self.layout = spec, layout
        self.settings: dict[str, Any] = {
            "spec": spec,
            "layout": layout,
            "gains": gains,
            "noise": noise,
            "learn_noise": learn_noise,
            "critic_learning_rate": critic_learning_rate,
        }
        super().__init__(observation_space, action_space, lr_schedule)

    def _build(self, lr_schedule: Schedule) -> None:
        """Networks and optimiser; called by stable-baselines3's constructor."""
        spec, settings = self.spec, self.settings
        assert self.action_space.shape is not None
        actions = self.action_space.shape[0]
        # With a small last layer, the initial policy is the head alone (or zero torque).
        actor_columns = self.layout.columns(spec.actor_blocks)
        outputs = actions + OUTPUTS.get(spec.balance, 0)
        self.actor = Network(actor_columns, spec, outputs, output_gain=0.01)
        self.critic = (
            Network(self.layout.columns(spec.critic_blocks), spec, 1, output_gain=0.01)
            if spec.critic_blocks
            else None
        )
        self.head = TorqueHead(settings["gains"], self.layout, spec) if spec.torque_head else None
        noise = np.broadcast_to(settings["noise"], (actions,))
        self.log_std = nn.Parameter(
            torch.as_tensor(np.log(noise), dtype=torch.float32),
            requires_grad=settings["learn_noise"],
        )
        rate = float(lr_schedule(1))
        # Two optimisers, since actor and critic are trained in parallel.
        self.optimizer = _adam(self.actor_parameters(), rate)
        self.critic_optimizer = (
            _adam(self.critic.parameters(), settings["critic_learning_rate"] or rate)
            if self.critic is not None
            else None
        )

    def actor_parameters(self) -> list[nn.Parameter]:
        """The parameters that the policy gradient trains."""
        head = list(self.head.parameters()) if self.head is not None else []
        return [*self.actor.parameters(), *head, self.log_std]

    def action_mean(self, obs: Tensor) -> Tensor:
        """Mean action ``(n, 33)``, not clipped, for observations ``(n, D)``."""
        return self.action_mean_of(*self.action_inputs(obs))

    def action_inputs(self, obs: Tensor) -> tuple[Tensor, ...]:
        """Inputs of the mean action: the actor's inputs and the terms of the head."""
        terms = () if self.head is None else self.head.terms(obs)
        return self.actor.inputs(obs), *terms

    def action_mean_of(self, inputs: Tensor, *terms: Tensor) -> Tensor:
        """Mean action ``(n, 33)`` for rows of the result of ``action_inputs``."""
        return with_head(self.actor.of_inputs(inputs), self.head, terms)

    def predict_values(self, obs: Tensor) -> Tensor:  # type: ignore[override]
        """Value ``(n, 1)`` of observations ``(n, D)``; zeros for a policy without critic."""
        return self.critic(obs) if self.critic is not None else obs.new_zeros(len(obs), 1)

    def use_bfloat16(self, on: bool) -> None:
        """Choose the precision of matrix products: bfloat16 for training, float32 for acting.

        It stays float32 on processors without native bfloat16.
        """
        self.actor.low_precision = on and native_bfloat16()
        if self.critic is not None:
            self.critic.low_precision = self.actor.low_precision

    def log_prob(self, mean: Tensor, actions: Tensor) -> Tensor:
        """Log density ``(n,)`` of actions ``(n, 33)`` around the mean."""
        z = (actions - mean) * torch.exp(-self.log_std)
        constant = 0.5 * np.log(2 * np.pi) * actions.shape[1]
        return -0.5 * (z * z).sum(1) - self.log_std.sum() - constant

    @torch.no_grad()
    def update_norm(self, obs: Tensor, of_all: OfAll = lambda own: [own]) -> None:
        """Merge observations ``(n, D)`` into the normalisers of both networks.

        Args:
            obs: own observations.
            of_all: gives the statistics of every worker's observations, for one's own.
        """
        networks = [self.actor] if self.critic is None else [self.actor, self.critic]
        for mean, var in of_all(mean_and_variance(obs)):  # all have as many rows
            for network in networks:
                columns = network.columns
                network.norm.merge(len(obs), mean[columns], var[columns])

    def held_inputs(self) -> dict[str, Tensor]:
        """Which inputs keep their statistics, by network; see ``RunningNorm.hold``."""
        networks = {"actor": self.actor, "critic": self.critic}
        norms = {name: network.norm for name, network in networks.items() if network is not None}
        return {name: norm.held for name, norm in norms.items() if norm.held is not None}

    def hold_inputs(self, held: Mapping[str, Tensor]) -> None:
        """Take over the result of ``held_inputs``."""
        for name, mask in held.items():
            getattr(self, name).norm.held = mask

    def predict_batch(self, obs: np.ndarray) -> np.ndarray:
        """Deterministic actions ``(n, 33)`` in [-1, 1] for observations ``(n, D)``."""
        with torch.inference_mode():
            return self.action_mean(torch.from_numpy(obs)).clamp_(-1.0, 1.0).numpy()

    def use_layout(self, layout: Layout) -> None:
        """Read the same blocks from an observation with other column positions."""
        for module, blocks in (
            (self.actor, self.spec.actor_blocks),
            (self.critic, self.spec.critic_blocks),
        ):
            if module is not None:
                module.columns = torch.as_tensor(layout.columns(blocks))
        if self.head is not None:
            self.head.use_layout(layout)

    # The remaining methods are called by stable-baselines3.

    def get_distribution(self, obs: Tensor) -> Distribution:  # type: ignore[override]
        """The action distribution for observations ``(n, D)``."""
        return self.action_dist.proba_distribution(self.action_mean(obs), self.log_std)  # type: ignore[call-arg]

    def forward(self, obs: Tensor, deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        """Actions, values and log probabilities for observations ``(n, D)``."""
        distribution = self.get_distribution(obs)
        actions = distribution.get_actions(deterministic=deterministic)
        return actions, self.predict_values(obs), distribution.log_prob(actions)

    def evaluate_actions(  # type: ignore[override]
        self, obs: Tensor, actions: Tensor
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        """Values, log probabilities and entropy of given actions."""
        distribution = self.get_distribution(obs)
        return self.predict_values(obs), distribution.log_prob(actions), distribution.entropy()

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {
            "observation_space": self.observation_space,
            "action_space": self.action_space,
            "lr_schedule": self._dummy_schedule,
            **self.settings,
        }
