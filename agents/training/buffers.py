"""Rollout storage as torch tensors: no copies or casts between rollout and update."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from gymnasium import spaces
from torch import Tensor

from agents.training.peers import ALONE, Peers


@dataclass(frozen=True)
class Targets:
    """Rows of a rollout: actions and means ``(R, A)``, the others ``(R,)``."""

    actions: Tensor
    means: Tensor
    log_probs: Tensor
    advantages: Tensor
    returns: Tensor


class TensorRolloutBuffer:
    """One rollout of ``T`` steps in ``N`` environments; replaces SB3's RolloutBuffer.

    Args:
        buffer_size: steps ``T``.
        observation_space: box ``(D,)``.
        action_space: box ``(A,)``.
        device: device of the tensors.
        gae_lambda: lambda of generalised advantage estimation.
        gamma: discount per step.
        n_envs: environments ``N``.
    """

    def __init__(
        self,
        buffer_size: int,
        observation_space: spaces.Box,
        action_space: spaces.Box,
        device: torch.device | str = "cpu",
        gae_lambda: float = 0.95,
        gamma: float = 0.99,
        n_envs: int = 1,
    ) -> None:
        self.gamma, self.gae_lambda = gamma, gae_lambda
        steps, actions = (buffer_size, n_envs), action_space.shape[0]
        self.observations = torch.zeros(*steps, observation_space.shape[0], device=device)
        self.actions = torch.zeros(*steps, actions, device=device)
        self.means = torch.zeros(*steps, actions, device=device)
        self.rewards = torch.zeros(steps, device=device)
        self.dones = torch.zeros(steps, device=device)
        self.values = torch.zeros(steps, device=device)
        self.log_probs = torch.zeros(steps, device=device)
        self.advantages = torch.zeros(steps, device=device)

    def reset(self) -> None:
        """Does nothing: the next rollout overwrites every entry."""

    def compute_advantages(self, last_values: Tensor) -> None:
        """Generalised advantage estimation (Schulman et al. 2016, eq. 16).

        Args:
            last_values: ``(N,)`` values of the observations after the last step.
        """
        following, running = last_values, torch.zeros_like(last_values)
        for t in range(len(self.rewards) - 1, -1, -1):
            alive = 1.0 - self.dones[t]
            delta = self.rewards[t] + self.gamma * alive * following - self.values[t]
            running = delta + self.gamma * self.gae_lambda * alive * running
            self.advantages[t] = running
            following = self.values[t]

    def flat_observations(self) -> Tensor:
        """All observations ``(T * N, D)``."""
        return self.observations.flatten(0, 1)

    def learning_targets(self, peers: Peers = ALONE) -> Targets:
        """The samples of an update; advantages are normalised over the rollouts of all peers."""
        advantages = self.advantages.flatten()
        mean, std = peers.mean_and_std(advantages)
        return Targets(
            actions=self.actions.flatten(0, 1),
            means=self.means.flatten(0, 1),
            log_probs=self.log_probs.flatten(),
            advantages=(advantages - mean) / (std + 1e-8),
            returns=advantages + self.values.flatten(),
        )

    def orders(self, size: int, epochs: int, generator: torch.Generator) -> list[Tensor]:
        """Row indices of every minibatch of an update: all rows once per epoch, in random order.

        Args:
            size: rows per minibatch; the last one of an epoch may have fewer.
            epochs: passes over the rollout.
            generator: random generator of the order.
        """
        rows = self.rewards.numel()
        return [
            part
            for _ in range(epochs)
            for part in torch.randperm(rows, generator=generator).split(size)
        ]
