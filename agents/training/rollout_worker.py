"""A worker of a training: it plays whole rollouts of its part of the batch, with or without Ray."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from agents.policy.networks import TorquePolicy
from agents.run_folder import versions
from agents.training.buffers import TensorRolloutBuffer
from agents.training.players import PolicyPlayer, StudentPlayer, Truncated
from agents.training.workers import Workers
from envs.config import EnvConfig
from envs.sb3 import QuestVecEnv
from questsim.extensions import load_extensions
from questsim.motion.clip import Clip

Weights = dict[str, np.ndarray]
PROGRAM_BYTES, AVATAR_BYTES = 500_000_000, 500_000
"""Memory of a worker without avatars, and of each avatar with its rollout; see ``memory``."""
ROLLOUT = ("observations", "actions", "means", "rewards", "dones")
"""Arrays of a policy's rollout per step and avatar, named as in ``TensorRolloutBuffer``."""


@dataclass(frozen=True)
class BatchSpec:
    """Settings of a batch of avatars; see ``QuestVecEnv``."""

    clips: Sequence[Clip]
    config: EnvConfig
    num_envs: int
    seed: int
    threads: int = 1
    shown: Sequence[Clip] | None = None
    begin_at: Mapping[str, Clip] | None = None

    @property
    def memory(self) -> int:
        """Bytes that a worker with this batch needs, by a rule that is a third above the measured.

        Measured: 0.4 GB of libraries and 0.3 MB an avatar; the clips are held twice.
        """
        clips = sum(
            array.nbytes
            for clip in (*self.clips, *(self.shown or ()))
            for array in (clip.qpos, clip.qvel, clip.link_position, clip.link_quat)
        )
        return PROGRAM_BYTES + self.num_envs * AVATAR_BYTES + 3 * clips

    def make(self) -> QuestVecEnv:
        """Create the batch."""
        return QuestVecEnv(
            self.clips,
            self.config,
            self.num_envs,
            self.seed,
            self.threads,
            self.shown,
            begin_at=self.begin_at,
        )


@dataclass(frozen=True)
class Played:
    """A worker's result of one rollout of ``T`` steps of ``n`` avatars.

    Attributes:
        arrays: by name, each ``(T, n, ...)``; a student's are ``(T * n, ...)``.
        rewards, dones: ``(T, n)``.
        terms: ``(T, n, terms)`` of the reward.
        ended: for each step, the environments whose episode ended, with their infos.
        truncated: truncated episodes of the rollout; see ``Truncated``.
        episodes: arguments of ``Sampler.record``, in order.
        observation: ``(n, D)`` after the last step.
        state: the worker's state after the rollout.
        unstable: number of simulations that have failed so far.
    """

    arrays: dict[str, np.ndarray]
    rewards: np.ndarray
    dones: np.ndarray
    terms: np.ndarray
    ended: list[list[tuple[int, dict[str, Any]]]]
    truncated: Truncated
    episodes: list[tuple[np.ndarray, ...]]
    observation: np.ndarray
    state: dict[str, Any]
    unstable: int


class RolloutWorker:
    """Plays a part of the batch, as a Ray actor or without Ray.

    Args:
        batch: the worker's part.
    """

    def __init__(self, batch: BatchSpec) -> None:
        load_extensions()
        torch.set_num_threads(1)
        self.env = batch.make()
        self._seed, self._threads = batch.seed, Workers(batch.threads)
        self._player: PolicyPlayer | StudentPlayer | None = None
        self._policy: TorquePolicy | None = None
        self._buffer: TensorRolloutBuffer | None = None
        self.env.sim.sampler.log = []
        self._sampler = self.env.sim.sampler.get_state()

    def describe(self) -> dict[str, Any]:
        """Properties of the environment that a learner needs, and the worker's versions."""
        env = self.env
        return {
            "layout": dict(env.layout),
            "size": env.observation_space.shape[0],  # type: ignore[index]
            "torque_limits": env.torque_limits,
            "damping": env.damping,
            "reward_names": tuple(env.reward_names),
            "versions": self.versions(),
        }

    def versions(self) -> dict[str, str]:
        """Versions of the libraries on the worker's node."""
        return versions()

    def apply(self, function: Callable[[Any], Any], job: Any) -> Any:
        """Call a function; for work between rollouts."""
        return function(job)

    def pid(self) -> int:
        """Process id of the worker."""
        return os.getpid()

    def cpu_seconds(self) -> float:
        """CPU time of the worker so far."""
        return time.process_time()

    def node(self) -> str:
        """Id of the Ray node that the worker is on."""
        import ray

        return ray.get_runtime_context().get_node_id()

    def learn_policy(self, policy: TorquePolicy) -> None:
        """Prepare for rollouts of a policy."""
        self._policy = policy
        self.env.seed(self._seed)  # like stable-baselines3 with its own environment
        self._player = PolicyPlayer(self.env, self._seed, self._threads)

    def learn_student(
        self, teacher: TorquePolicy, student: TorquePolicy, exploration: float
    ) -> None:
        """Prepare for rollouts of a student."""
        self._policy = student
        self._player = StudentPlayer(
            self.env, teacher, student, exploration, self._seed, self._threads
        )

    def play(
        self, weights: Weights, episodes: list[tuple[np.ndarray, ...]], steps: int, share: float
    ) -> Played:
        """Play one rollout.

        Args:
            weights: weights of the policy.
            episodes: episodes ended in all workers since the last rollout, in the workers' order.
            steps: steps of each avatar.
            share: share of avatars that a teacher drives.
        """
        assert self._policy is not None
        assert self._player is not None
        load_weights(self._policy, weights)
        self._merge(episodes)
        kept = Kept(self.env)
        truncated: Truncated = []
        if isinstance(self._player, PolicyPlayer):
            buffer = self._buffer_of(steps)
            truncated = self._player.play(self._policy, buffer, kept.after) or []
            arrays = {name: getattr(buffer, name).numpy() for name in ROLLOUT}
        else:
            visited, labels = self._player.play(steps, share, kept.after)
            arrays = {"visited": visited.numpy(), "labels": labels.numpy()}
        return self._played(kept, arrays, truncated)

    def _played(self, kept: Kept, arrays: dict[str, np.ndarray], truncated: Truncated) -> Played:
        assert self._player is not None
        sampler, observation = self.env.sim.sampler, self._player.observation
        assert observation is not None
        ended, sampler.log = sampler.log, []
        return Played(
            arrays=arrays,
            rewards=np.stack(kept.rewards),
            dones=np.stack(kept.dones),
            terms=np.stack(kept.terms),
            ended=kept.ended,
            truncated=truncated,
            episodes=ended or [],
            observation=observation,
            state=self.get_state(),
            unstable=int(self.env.sim.unstable_count),
        )

    def _merge(self, episodes: list[tuple[np.ndarray, ...]]) -> None:
        """Record the episodes of all workers in the sampler, as if played by one batch."""
        sampler = self.env.sim.sampler
        sampler.set_state(self._sampler)
        sampler.log = None
        for ended in episodes:
            sampler.record(*ended)
        sampler.log = []
        self._sampler = sampler.get_state()

    def _buffer_of(self, steps: int) -> TensorRolloutBuffer:
        if self._buffer is None or len(self._buffer.rewards) != steps:
            spaces = self.env.observation_space, self.env.action_space
            self._buffer = TensorRolloutBuffer(steps, *spaces, n_envs=self.env.num_envs)  # type: ignore[arg-type]
        return self._buffer

    def change_clips(self, clips: Sequence[Clip], seed: int) -> None:
        """Replace the clips; the next rollout begins new episodes."""
        self.env.change_clips(clips, seed)
        self.env.sim.sampler.log = []
        self._sampler = self.env.sim.sampler.get_state()
        if self._player is not None:
            self._player.observation = None

    def get_state(self) -> dict[str, Any]:
        """State that the next rollouts depend on, besides weights and episodes."""
        player = self._player
        noise = None if player is None else player.generator.get_state().numpy().copy()
        return {"env": self.env.get_state(), "noise": noise, "sampler": self._sampler}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a state from ``get_state``."""
        self.env.set_state(state["env"])
        self._sampler = {name: np.array(rates) for name, rates in state["sampler"].items()}
        if self._player is not None and state["noise"] is not None:
            self._player.generator.set_state(torch.as_tensor(np.array(state["noise"])))
            self._player.observation = None  # the restored episodes continue


class Kept:
    """Figures of each step for the learner's monitor."""

    def __init__(self, env: QuestVecEnv) -> None:
        self._env = env
        self.rewards: list[np.ndarray] = []
        self.dones: list[np.ndarray] = []
        self.terms: list[np.ndarray] = []
        self.ended: list[list[tuple[int, dict[str, Any]]]] = []

    def after(self, rewards: np.ndarray, dones: np.ndarray, infos: list[dict[str, Any]]) -> bool:
        """Store a step; the player keeps the last observations of episodes."""
        self.rewards.append(rewards)
        self.dones.append(dones)
        self.terms.append(np.asarray(self._env.reward_terms, np.float32).copy())
        self.ended.append(
            [
                (int(i), {k: v for k, v in infos[i].items() if k != "terminal_observation"})
                for i in np.flatnonzero(dones)
            ]
        )
        return True


def weights_of(policy: TorquePolicy) -> Weights:
    """Weights needed for acting: networks, normaliser and noise, without the critic."""
    state = policy.state_dict()
    return {k: v.numpy().copy() for k, v in state.items() if not k.startswith("critic.")}


def load_weights(policy: TorquePolicy, weights: Weights) -> None:
    """Load weights from ``weights_of`` into a policy."""
    state = {name: torch.as_tensor(np.array(value)) for name, value in weights.items()}
    policy.load_state_dict(state, strict=False)
