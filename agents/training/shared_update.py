"""PPO whose workers also learn: each computes the gradients of its own rollout.

A worker is a whole learner of its part of the batch. At each gradient step the workers average
their gradients, and all of them make the same step. So the update is shared out too, and what
crosses the network does not grow with the number of avatars. At every iteration all workers begin
with the weights of the command's process, which receives them from the first worker.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch

from agents.training.cluster import ATTEMPTS, ActorPool
from agents.training.learner import StepObserver
from agents.training.make_ppo import make_ppo
from agents.training.peers import Address, Meeting, PeerLostError, join, packed, unpacked
from agents.training.ppo import AdaptivePPO
from agents.training.presets import PPOConfig, StageConfig
from agents.training.ray_session import check_head, first_error, meeting_file, own_host
from agents.training.rollout_worker import Kept, Played, RolloutWorker
from questsim.errors import InputError

LEAST_ROWS = 256
"""Samples per gradient of a worker, at least: with fewer, exchanging them takes longest."""


@dataclass(frozen=True)
class Learned:
    """A worker's result of one iteration.

    Attributes:
        played: its rollout, without the arrays.
        update: ``AdaptivePPO.update_state``, packed; of the first worker only.
        figures: to log; the same of all workers.
    """

    played: Played
    update: bytes
    figures: dict[str, float]


class LearningWorker(RolloutWorker):
    """Plays a part of the batch and learns from it, in step with the other workers."""

    _ppo: AdaptivePPO | None = None
    _meeting: Meeting | None = None
    _rank = 0

    def learn_ppo(self, config: StageConfig, minibatch: int, threads: int) -> None:
        """Prepare to learn.

        Args:
            config: of the stage, with PPO.
            minibatch: own samples per gradient.
            threads: of the networks; the result does not depend on it.
        """
        assert isinstance(config.learning, PPOConfig)
        learning = replace(config.learning, minibatch=minibatch)
        self._ppo = make_ppo(config, learning, self.env, self._seed, threads)
        self._player, self._policy = self._ppo.player, self._ppo.policy  # type: ignore[assignment]

    def meet(self, file: str | None) -> Address:
        """Open the place where all workers meet; called for the first one."""
        self._meeting = Meeting(file, own_host())
        return self._meeting.address

    def join(self, address: Address, rank: int, count: int) -> None:
        """Connect to the other workers."""
        assert self._ppo is not None
        self._rank = rank
        groups = join(address, own_host(), rank, count, 2, self._meeting)
        self._ppo.actor_peers, self._ppo.critic_peers = groups

    def learn(self, update: bytes, episodes: list[Any], frozen: bool, progress: float) -> Learned:
        """Play a rollout and learn from it.

        Args:
            update: packed ``AdaptivePPO.update_state`` to begin with.
            episodes: see ``play``.
            frozen: whether only the critic learns.
            progress: used share of the budget.
        """
        ppo, kept = self._ppo, Kept(self.env)
        assert ppo is not None
        ppo.load_update_state(unpacked(update))
        self._merge(episodes)
        ppo.actor_frozen = frozen
        figures = ppo.iterate(kept.after, progress)  # type: ignore[arg-type]
        played = self._played(kept, {}, [])
        return Learned(played, packed(ppo.update_state()) if self._rank == 0 else b"", figures)

    def get_state(self) -> dict[str, Any]:
        """State that the next iterations depend on, besides the update and the episodes."""
        order = None if self._ppo is None else self._ppo.generator.get_state().numpy().copy()
        return super().get_state() | {"order": order}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a state from ``get_state``."""
        super().set_state(state)
        if self._ppo is not None and state["order"] is not None:
            self._ppo.generator.set_state(torch.as_tensor(state["order"]).clone())


class LearningPool(ActorPool):
    """Workers that learn together; see ``ActorPool``."""

    worker = LearningWorker
    _joined = False

    def learn(
        self, update: bytes, frozen: bool, progress: float, observe: StepObserver
    ) -> tuple[bytes, dict[str, float]]:
        """One iteration of all workers.

        Args:
            update: packed ``AdaptivePPO.update_state``.
            frozen: whether only the critic learns.
            progress: used share of the budget.
            observe: called after every step of the rollout.

        Returns:
            The update after it, and figures to log.
        """
        begin, episodes = self._ray.put(update), self._ray.put(self._episodes)
        learned: list[Learned] = self._together(
            lambda actor: actor.call.remote("learn", begin, episodes, frozen, progress)
        )
        played = [each.played for each in learned]

        def after(*step: Any) -> bool:
            observe(*step)
            return True

        self._take(played, len(played[0].rewards), after)
        self.bytes_a_rollout = len(update) * (self.count + 1)
        return learned[0].update, learned[0].figures

    def _together(self, call: Callable[[Any], Any]) -> list[Any]:
        """Results of a call in which the workers exchange gradients.

        If one dies, all start again in their states before the update.
        """
        for _ in range(ATTEMPTS):
            try:
                if not self._joined:
                    self._join()
                return first_error([call(actor) for actor in self._actors])
            except PeerLostError:
                check_head()
                self._restart()
        fix = "see Ray's logs; a worker may need more memory than its node has (fewer --envs)"
        raise InputError(f"died {ATTEMPTS} times in one iteration", "a worker", fix)

    def _join(self) -> None:
        with meeting_file() as file:
            first = self._actors[0].call.remote("meet", file)
            (address,) = first_error([first])
            calls = enumerate(self._actors)
            first_error([a.call.remote("join", address, rank, self.count) for rank, a in calls])
        self._joined = True

    def get_ready(self, method: str, *args: Any) -> None:
        """See ``ActorPool.get_ready``; the learners that it makes have to meet."""
        super().get_ready(method, *args)
        self._joined = False

    def _replace(self, k: int) -> None:
        super()._replace(k)
        self._joined = False

    def _restart(self) -> None:
        for actor in self._actors:
            self._ray.kill(actor)
        self._actors = [self._make(k) for k in range(self.count)]
        for k in range(self.count):
            self._prepare(k)
        self._joined = False


class SharedPPO(AdaptivePPO):
    """The command's part of a PPO whose workers learn: it keeps the policy that they share.

    Args:
        policy, env, options: see ``AdaptivePPO``; ``env`` is a ``LearningPool``.
    """

    def _setup_model(self) -> None:
        envs, self.n_envs = self.n_envs, 1  # the rollouts stay with the workers
        super()._setup_model()
        self.n_envs = envs

    def iterate(self, observe: StepObserver, progress: float) -> dict[str, float]:
        """One rollout and update of all workers; see ``AdaptivePPO.iterate``."""
        pool = self.env
        assert isinstance(pool, LearningPool)

        def count(*step: Any) -> None:
            self.num_timesteps += pool.num_envs
            observe(*step)

        update, figures = pool.learn(
            packed(self.update_state()), self.actor_frozen, progress, count
        )
        self.load_update_state(unpacked(update))
        return figures


def make_shared_ppo(
    config: StageConfig, ppo: PPOConfig, pool: LearningPool, seed: int, threads: int = 1
) -> SharedPPO:
    """PPO with a new policy that the workers of ``pool`` train together."""
    learner = make_ppo(config, ppo, pool, seed, threads, SharedPPO)
    pool.get_ready("learn_ppo", config, rows_of_each(ppo, pool), threads)
    assert isinstance(learner, SharedPPO)
    return learner


def rows_of_each(ppo: PPOConfig, pool: LearningPool) -> int:
    """Samples per gradient of each worker.

    All together have a minibatch of the preset. With many workers it grows instead, since each
    takes at least ``LEAST_ROWS``.
    """
    own = ppo.rollout_steps * pool.num_envs // pool.count
    return min(max(ppo.minibatch // pool.count, LEAST_ROWS), ppo.minibatch, own)


def announce(ppo: PPOConfig, pool: LearningPool) -> str:
    """One line about the gradients, to print."""
    rows = rows_of_each(ppo, pool)
    whole = rows * pool.count
    more = "" if whole <= ppo.minibatch else f" instead of {ppo.minibatch}"
    return f"gradients of {pool.count} workers with {rows} samples each: {whole}{more} a step"
