"""A worker that plays the next rollout during the update, against two threads in turn.

    python -m benchmarks.overlap [--json] [--envs 256] [--repeats 6] [--steps 0] [--seeds 1]

The teacher of the preset `cpu` learns by PPO: with `--threads 2`, and with one worker of one core
that always plays with the weights from before the update (one update behind), beside a learner of
one core. Iterations alternate and their wall times are compared, so that other programs disturb
both alike. With `--steps` it also learns so many steps from rollouts that are one update behind and
from present ones, with the same seeds, and prints the mean rewards of each quarter.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from agents.policy.networks import TorquePolicy
from agents.training.buffers import TensorRolloutBuffer
from agents.training.cluster import ActorPool, RemotePolicyPlayer
from agents.training.make_ppo import make_ppo
from agents.training.players import AfterStep, Truncated
from agents.training.ppo import AdaptivePPO, Player
from agents.training.presets import PPOConfig
from agents.training.ray_session import ray_cluster, result
from agents.training.rollout_worker import BatchSpec, load_weights, weights_of
from benchmarks.cluster import STAGE
from benchmarks.common import arguments, clips, report, seconds
from envs.config import EnvConfig


class Ahead(RemotePolicyPlayer):
    """Lets the workers of a pool play the next rollout while the learner updates."""

    _waiting: list[Any] | None = None

    def play(
        self, policy: TorquePolicy, buffer: TensorRolloutBuffer, after: AfterStep
    ) -> Truncated | None:
        """The rollout that was begun at the last call; begins the next one."""
        pool, steps = self._pool, len(buffer.rewards)
        if self._waiting is None:
            pool.get_ready("learn_policy", policy)
            self._waiting = self._begin(policy, steps)
        played = [result(reference) for reference in self._waiting]
        pool._take(played, steps, after)
        self._waiting = self._begin(policy, steps)
        return self._filled(played, buffer)

    def _begin(self, policy: TorquePolicy, steps: int) -> list[Any]:
        pool, weights = self._pool, weights_of(policy)
        return [a.call.remote("play", weights, pool._episodes, steps, 0.0) for a in pool._actors]


class Behind:
    """Plays each rollout with the policy from before the last update.

    Args:
        player: plays it.
    """

    def __init__(self, player: Player) -> None:
        self._player = player
        self._old: TorquePolicy | None = None
        self._weights: Any = None

    @property
    def observation(self) -> np.ndarray | None:
        """See ``Player``."""
        return self._player.observation

    def play(
        self, policy: TorquePolicy, buffer: TensorRolloutBuffer, after: AfterStep
    ) -> Truncated | None:
        """See ``Player.play``."""
        if self._old is None:
            self._old, self._weights = deepcopy(policy), weights_of(policy)
        load_weights(self._old, self._weights)
        self._weights = weights_of(policy)
        return self._player.play(self._old, buffer, after)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._player, name)


def learner(env: Any, seed: int, threads: int, ahead: bool = False) -> AdaptivePPO:
    """The teacher before its first step."""
    assert isinstance(STAGE.learning, PPOConfig)
    ppo = make_ppo(STAGE, STAGE.learning, env, seed, threads)
    if ahead:
        ppo.player = Ahead(env)
    return ppo


def nothing(*_: object) -> None:
    """Observes nothing."""


def times(batch: BatchSpec, repeats: int) -> dict[str, float]:
    """Wall times of both, and their ratio."""
    alone = replace(batch, threads=2).make()
    with ray_cluster(None, 1):
        pool = ActorPool(batch, 1)
        runs = {
            "two threads in turn": learner(alone, 0, 2),
            "a worker ahead": learner(pool, 0, 1, True),
        }
        found: dict[str, list[float]] = {name: [] for name in runs}
        for repeat in range(repeats + 2):  # two to compile, warm and measure the first rate
            for name, ppo in runs.items():
                elapsed = seconds(lambda ppo=ppo: ppo.iterate(nothing, 0.0))
                if repeat >= 2:
                    found[name].append(elapsed)
        pool.close()
    alone.close()
    first, second = (np.array(each) for each in found.values())
    figures = {f"{name}, s an iteration": statistics.median(t) for name, t in found.items()}
    figures["steps/s of a worker ahead over two threads, median"] = float(np.median(first / second))
    figures["lowest"], figures["highest"] = float(min(first / second)), float(max(first / second))
    return figures


def rewards(batch: BatchSpec, steps: int, behind: bool) -> list[float]:
    """Mean rewards of the quarters of a training."""
    env, found = batch.make(), []
    ppo = learner(env, batch.seed, 1)
    if behind:
        ppo.player = Behind(ppo.player)  # type: ignore[assignment]
    observe: Callable[..., None] = lambda values, *_: found.append(float(np.mean(values)))  # noqa: E731
    while ppo.num_timesteps < steps:
        ppo.iterate(observe, ppo.num_timesteps / steps)
    env.close()
    return [float(np.mean(part)) for part in np.array_split(found, 4)]


def main() -> None:
    """Measure and print."""
    args = arguments(__doc__ or "", envs=256, repeats=6, steps=0, seeds=1)
    torch.set_num_threads(1)
    config = EnvConfig(privileged=True, sampling=STAGE.sampling, reward=STAGE.reward)
    figures = {}
    for seed in range(args.seeds if args.steps else 0):
        for name, behind in (("present", False), ("one update behind", True)):
            batch = BatchSpec(clips(), config, args.envs, seed)
            for quarter, mean in enumerate(rewards(batch, args.steps, behind), 1):
                figures[f"reward, {name}, seed {seed}, quarter {quarter}"] = mean
                print(f"reward, {name}, seed {seed}, quarter {quarter}: {mean:.4f}", flush=True)
    if args.repeats:
        figures |= times(BatchSpec(clips(), config, args.envs, 0), args.repeats)
    report(figures, args.json)


if __name__ == "__main__":
    main()
