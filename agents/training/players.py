"""Players step a batch of avatars and collect the rollouts that learners train on."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import numpy as np
import torch
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor

from agents.policy.networks import TorquePolicy
from agents.training.buffers import TensorRolloutBuffer
from agents.training.workers import Workers

Truncated = list[tuple[int, int, np.ndarray]]
"""Step, environment and last observation of each episode truncated at the end of its reference."""
AfterStep = Callable[[np.ndarray, np.ndarray, list[dict[str, Any]]], bool]
"""Called after each step with rewards ``(n,)``, dones ``(n,)`` and infos; False stops it."""


class Labels(Protocol):
    """Anything that has mean actions for observations."""

    def action_mean(self, observations: Tensor, /) -> Tensor:
        """Mean actions ``(n, 33)`` for observations ``(n, D)``."""
        ...


class _Player:
    """Base of the players: the batch, the random generator and the last observation.

    Args:
        env: a stable-baselines3 VecEnv.
        seed: seed of the random numbers.
        workers: threads of the networks.
    """

    def __init__(self, env: VecEnv, seed: int, workers: Workers) -> None:
        self.env, self._workers = env, workers
        self.generator = torch.Generator().manual_seed(seed)
        self.observation: np.ndarray | None = None

    def get_state(self) -> dict[str, Any]:
        """The random generator's state; the environment saves its episodes."""
        return {"generator": self.generator.get_state()}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a state from ``get_state``; the environment's restored episodes continue."""
        if "generator" in state:  # a training with workers has it elsewhere
            self.generator.set_state(state["generator"])
        self.observation = None


class PolicyPlayer(_Player):
    """Plays a policy with exploration noise and stores the rollout.

    Args:
        env: a stable-baselines3 VecEnv of ``n`` avatars.
        seed: seed of the noise.
        workers: threads of the networks.
    """

    def play(
        self, policy: TorquePolicy, buffer: TensorRolloutBuffer, after: AfterStep
    ) -> Truncated | None:
        """Fill a buffer's observations, actions, means, rewards and dones.

        Args:
            policy: the acting policy.
            buffer: a buffer of ``T`` steps.
            after: called after each step.

        Returns:
            Truncated episodes, or None if ``after`` stopped the rollout.
        """
        if self.observation is None:
            self.observation = np.asarray(self.env.reset())
        noise = policy.log_std.detach().exp()
        truncated: Truncated = []
        for t in range(len(buffer.rewards)):
            obs = buffer.observations[t]
            obs.copy_(torch.from_numpy(self.observation))
            mean = self._workers.by_halves(policy.action_mean, obs)
            action = mean + noise * torch.randn(mean.shape, generator=self.generator)
            buffer.means[t], buffer.actions[t] = mean, action
            new, rewards, dones, infos = self.env.step(action.clamp(-1.0, 1.0).numpy())
            buffer.rewards[t] = torch.from_numpy(rewards)
            buffer.dones[t] = torch.from_numpy(dones)
            for i in np.flatnonzero(dones):
                if infos[i].get("TimeLimit.truncated", False):
                    truncated.append((t, int(i), infos[i]["terminal_observation"]))
            self.observation = np.asarray(new)
            if not after(rewards, dones, infos):
                return None
        return truncated


class StudentPlayer(_Player):
    """Plays a student, mixed with its teacher, and labels each state with the teacher's action.

    Args:
        env: VecEnv with the privileged observation; the student's part comes first.
        teacher, student: policies bound to ``env``.
        exploration: noise on the executed actions, as a share of the teacher's own noise.
        seed: seed of the noise and of the choice between teacher and student.
        workers: threads of the networks.
        labels: gives the actions in place of ``teacher``, whose noise is still used.
    """

    def __init__(
        self,
        env: VecEnv,
        teacher: TorquePolicy,
        student: TorquePolicy,
        exploration: float,
        seed: int,
        workers: Workers,
        labels: Labels | None = None,
    ) -> None:
        super().__init__(env, seed, workers)
        self.student, self._exploration = student, exploration
        self._labels: Labels = teacher if labels is None else labels
        self.inputs = max(stop for _, stop in student.layout.blocks.values())
        self.noise = teacher.log_std.detach().exp()

    def play(self, steps: int, teacher_share: float, after: AfterStep) -> tuple[Tensor, Tensor]:
        """Sparse observations ``(steps * n, D)`` of visited states and the teacher's actions.

        Args:
            steps: steps of each avatar.
            teacher_share: probability that the teacher drives an avatar in this rollout.
            after: called after each step.
        """
        if self.observation is None:
            self.observation = np.asarray(self.env.reset())
        by_teacher = torch.rand(self.env.num_envs, 1, generator=self.generator) < teacher_share
        visited, labels = [], []
        for _ in range(steps):
            obs = torch.from_numpy(self.observation)
            # The teacher observes the true motion, even where the student observes an estimate.
            truth = torch.from_numpy(getattr(self.env, "true_observation", self.observation))
            label, own = self._workers.run(
                partial(_mean, self._labels, truth), partial(_mean, self.student, obs)
            )
            noise = torch.randn(label.shape, generator=self.generator) * self.noise
            action = torch.where(by_teacher, label, own) + self._exploration * noise
            visited.append(obs[:, : self.inputs].clone())
            labels.append(label)
            new, rewards, dones, infos = self.env.step(action.clamp(-1.0, 1.0).numpy())
            self.observation = np.asarray(new)
            after(rewards, dones, infos)
        return torch.cat(visited), torch.cat(labels)


def _mean(policy: Labels, obs: Tensor) -> Tensor:
    """Mean actions ``(n, 33)``, clipped as the environment would."""
    with torch.no_grad():
        return policy.action_mean(obs).clamp_(-1.0, 1.0)
