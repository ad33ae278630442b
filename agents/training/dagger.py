"""DAgger: a teacher labels the states that the student visits; the student imitates it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor, nn

from agents.policy.networks import TorquePolicy
from agents.policy.policy_agent import PolicyAgent
from agents.training.learner import StepObserver, TrainingError
from agents.training.players import Labels, StudentPlayer
from agents.training.workers import Workers
from questsim.errors import within


@dataclass(frozen=True)
class DaggerConfig:
    """Settings of DAgger.

    Attributes:
        rollout_steps: steps of every environment between updates.
        updates: gradient steps between rollouts.
        minibatch: visited states per gradient step.
        capacity: size of the memory of visited states.
        learning_rate: at the start.
        final_learning_rate: at the end of the budget; cosine schedule.
        mix_steps: environment steps over which the share of environments that the teacher
            drives falls from 1 to 0.
        exploration: noise on the executed actions, as a share of the teacher's noise.
        learn_head: whether the gains of the student's torque head are trained too.
    """

    rollout_steps: int = 16
    updates: int = 16
    minibatch: int = 1024
    capacity: int = 400_000
    learning_rate: float = 1e-3
    final_learning_rate: float = 1e-4
    mix_steps: int = 400_000
    exploration: float = 0.3
    learn_head: bool = True

    def __post_init__(self) -> None:
        within("DAgger", 0.0, 1.0, learning_rate=self.learning_rate)
        within("DAgger", 0.0, 1.0, final_learning_rate=self.final_learning_rate)
        within("DAgger", 0.0, 10.0, exploration=self.exploration)


class Memory:
    """Ring buffer of visited states and the teacher's actions in them.

    Args:
        capacity: rows.
        inputs: size of a sparse observation.
        actions: size of an action.
    """

    def __init__(self, capacity: int, inputs: int, actions: int) -> None:
        self.observations = torch.empty(capacity, inputs)
        self.labels = torch.empty(capacity, actions)
        self.size = self._next = 0

    def add(self, observations: Tensor, labels: Tensor) -> None:
        """Add ``n`` states; they replace the oldest ones."""
        capacity = len(self.labels)
        observations, labels = observations[-capacity:], labels[-capacity:]
        rows = (self._next + torch.arange(len(labels))) % capacity
        self.observations[rows], self.labels[rows] = observations, labels
        self._next = (self._next + len(labels)) % capacity
        self.size = min(self.size + len(labels), capacity)

    def sample(self, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Random states ``(count, D)`` and labels ``(count, 33)``."""
        rows = torch.randint(self.size, (count,), generator=generator)
        return self.observations.index_select(0, rows), self.labels.index_select(0, rows)


class Dagger:
    """Dataset aggregation (Ross et al. 2011): the student acts, the teacher labels.

    The loss is the squared error of the actions divided by the teacher's variance of each joint,
    which is twice the KL divergence of two Gaussians with that variance. A joint on which the
    teacher explores little counts more, so the legs do not dominate light joints with small
    torques.

    Args:
        env: VecEnv with the privileged observation; the student's columns come first.
        teacher: bound to ``env``.
        student: reads only the first columns of the observation.
        config: see ``DaggerConfig``.
        seed: seed of mixing, noise and minibatches.
        threads: parallel threads; the result does not depend on their number.
        labels: gives the actions in place of ``teacher``, which then only sets noise and weights.
    """

    def __init__(
        self,
        env: VecEnv,
        teacher: PolicyAgent,
        student: TorquePolicy,
        config: DaggerConfig,
        seed: int,
        threads: int = 1,
        labels: Labels | None = None,
    ) -> None:
        self.env, self.teacher, self.policy, self.config = env, teacher.policy, student, config
        # Labels are computed in float32; only the student's training uses low precision.
        student.use_bfloat16(True)
        if student.head is not None:
            student.head.requires_grad_(config.learn_head)
        self.num_timesteps = 0
        self.generator = torch.Generator().manual_seed(seed)
        inputs = max(stop for _, stop in student.layout.blocks.values())
        self.memory = Memory(config.capacity, inputs, student.log_std.numel())
        self.noise = self.teacher.log_std.detach().exp()
        self._workers = Workers(threads)
        exploration = config.exploration
        # Workers elsewhere bring a player of their own.
        self.player = (
            env.student_player(self.teacher, student, exploration)  # pyright: ignore
            if hasattr(env, "student_player")
            else StudentPlayer(env, self.teacher, student, exploration, seed, self._workers, labels)
        )

    def iterate(self, observe: StepObserver, progress: float) -> dict[str, float]:
        """One rollout and the updates after it.

        Args:
            observe: called after every environment step.
            progress: used share of the budget, 0 to 1.

        Returns:
            Figures to log.
        """
        self._collect(observe)
        low, high = self.config.final_learning_rate, self.config.learning_rate
        rate = low + 0.5 * (high - low) * (1 + float(np.cos(np.pi * min(progress, 1.0))))
        return self._learn(rate) | {"train/learning_rate": rate, "train/teacher_share": self.beta}

    @property
    def beta(self) -> float:
        """Share of environments that the teacher drives."""
        return max(0.0, 1.0 - self.num_timesteps / max(1, self.config.mix_steps))

    def _collect(self, observe: StepObserver) -> None:
        def after(rewards: np.ndarray, dones: np.ndarray, infos: list[dict[str, Any]]) -> bool:
            self.num_timesteps += self.env.num_envs
            observe(rewards, dones, infos)
            return True

        self.memory.add(*self.player.play(self.config.rollout_steps, self.beta, after))

    def _learn(self, rate: float) -> dict[str, float]:
        policy, optimizer = self.policy, self.policy.optimizer
        if policy.actor.norm.count.item() < self.config.capacity:
            # Then the statistics are fixed: the network need not adapt to changing inputs.
            newest = self.config.rollout_steps * self.env.num_envs
            end = self.memory._next or len(self.memory.labels)
            policy.update_norm(self.memory.observations[max(0, end - newest) : end])
        actor = [p for p in policy.actor_parameters() if p.requires_grad]
        total, parameters = 0.0, [p for p in actor if p is not policy.log_std]
        for group in optimizer.param_groups:
            group["lr"] = rate
        for _ in range(self.config.updates):
            sample = self.memory.sample(self.config.minibatch, self.generator)
            halves = zip(*(part.chunk(2) for part in sample), strict=True)
            (loss, gradients), *others = self._workers.run(
                *(partial(self._gradients, *half, parameters) for half in halves)
            )
            for other_loss, other_gradients in others:
                loss = loss + other_loss
                gradients = [a + b for a, b in zip(gradients, other_gradients, strict=True)]
            if not bool(torch.isfinite(loss)):
                raise TrainingError("the loss is not finite", self.num_timesteps)
            for parameter, gradient in zip(parameters, gradients, strict=True):
                parameter.grad = gradient
            torch.nn.utils.clip_grad_norm_(policy.actor_parameters(), 1.0)
            optimizer.step()
            total += loss.item()
        return {"train/imitation_loss": total / self.config.updates}

    def _gradients(
        self, observations: Tensor, labels: Tensor, parameters: list[nn.Parameter]
    ) -> tuple[Tensor, list[Tensor]]:
        """A part's contribution to the minibatch loss; computes its gradients."""
        error = (self.policy.action_mean(observations) - labels) / self.noise
        loss = error.square().sum() / (self.config.minibatch * labels.shape[1])
        return loss.detach(), list(torch.autograd.grad(loss, parameters))

    def begin_anew(self) -> None:
        """Restart all episodes before the next rollout; visited states stay in memory."""
        self.player.observation = None

    def state_dict(self) -> dict[str, Any]:
        """State for resuming, without the memory of visited states, which fills up again."""
        return {
            "steps": self.num_timesteps,
            "policy": self.policy.state_dict(),
            "held": self.policy.held_inputs(),
            "optimizer": self.policy.optimizer.state_dict(),
            "generator": self.generator.get_state(),
            "player": self.player.get_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from ``state_dict``."""
        self.num_timesteps = state["steps"]
        self.policy.load_state_dict(state["policy"])
        self.policy.hold_inputs(state.get("held", {}))
        self.policy.optimizer.load_state_dict(state["optimizer"])
        self.generator.set_state(state["generator"])
        self.player.set_state(state["player"])
