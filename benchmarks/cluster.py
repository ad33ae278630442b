"""Cost of a teacher's training with and without Ray workers, and what to expect of more cores.

    python -m benchmarks.cluster [--json] [--envs 256] [--repeats 5]

The teacher of the preset `cpu` learns by PPO on one thread: without Ray, with one worker, with two
workers of half the avatars each, and with two that compute the gradients themselves. Times are CPU
times of the learner and its workers, so that other programs do not disturb them. A model with these
costs predicts larger clusters, with 256 avatars and one core a worker. Seconds of an iteration:

    rollouts to the learner:  s * p + N * s * b / B + N * s * u / 2
    gradients of the workers: s * p + s * u + k * 2 * g / B

with s = avatars of a worker * steps; p, u seconds to play and to learn from one step on one core;
N the workers, B the bandwidth, b the bytes of a step, k the minibatches of an iteration of one
worker, g the bytes of a gradient. Workers play side by side. In the first line (the default) the
learner alone receives and learns, on two cores that share the work evenly. The second is
`--gradients workers` at best: no worker waits for another.
"""

from __future__ import annotations

import statistics
import time
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import torch

from agents.training.cluster import ActorPool
from agents.training.make_ppo import make_ppo
from agents.training.ppo import AdaptivePPO
from agents.training.presets import PRESETS, PPOConfig
from agents.training.ray_session import ray_cluster
from agents.training.rollout_worker import BatchSpec
from agents.training.shared_update import LearningPool, make_shared_ppo
from benchmarks.common import arguments, clips, report
from envs.config import EnvConfig

CORES = (8, 64, 512)
BANDWIDTH = {"1 Gbit/s": 1e9 / 8, "10 Gbit/s": 1e10 / 8}
STAGE = PRESETS["cpu"].stages["teacher"]


@dataclass(frozen=True)
class StepCosts:
    """What the model is made of.

    Attributes:
        play, learn: seconds of one core to play a step of one avatar and to learn from it.
        size: bytes of it that a worker returns.
        gradient: bytes of a gradient.
        minibatch, epochs: of the update.
    """

    play: float
    learn: float
    size: float
    gradient: float
    minibatch: int
    epochs: int

    def rate(self, workers: int, samples: int, bandwidth: float) -> float:
        """Predicted environment steps/s if rollouts go to one learner.

        Args:
            workers: of one core each.
            samples: steps of all avatars of a worker in an iteration.
            bandwidth: bytes/s into the learner.
        """
        together = workers * samples
        return together / (
            samples * self.play + together * (self.size / bandwidth + self.learn / 2)
        )

    def rate_of_gradients(self, workers: int, samples: int, bandwidth: float) -> float:
        """Predicted environment steps/s if workers learn and their gradients are averaged."""
        moved = 2.0 * self.gradient * self.minibatches(samples) / bandwidth
        return workers * samples / (samples * (self.play + self.learn) + moved)

    def minibatches(self, samples: int) -> float:
        """Gradients of an iteration."""
        return self.epochs * samples / self.minibatch


class Timed:
    """A teacher whose CPU times are measured, with those of its workers."""

    def __init__(self, env: Any) -> None:
        self.env = env
        make: Any = make_shared_ppo if isinstance(env, LearningPool) else make_ppo
        self.ppo: AdaptivePPO = make(STAGE, STAGE.learning, env, 0, 1)
        self.whole: list[float] = []
        self.update: list[float] = []
        train = self.ppo.train

        def timed_update() -> None:
            began = time.process_time()
            train()
            self.update.append(time.process_time() - began)

        self.ppo.train = timed_update  # type: ignore[method-assign]
        for _ in range(2):  # measures the observations, then compiles and warms
            self.iterate()
        self.whole, self.update = [], []

    def _spent(self) -> float:
        workers = self.env.cpu_seconds() if isinstance(self.env, ActorPool) else 0.0
        return time.process_time() + workers

    def iterate(self) -> None:
        """One rollout and update."""
        began = self._spent()
        self.ppo.iterate(lambda *_: None, 0.0)
        self.whole.append(self._spent() - began)

    @property
    def seconds(self) -> tuple[float, float]:
        """Median of the rollouts' and of the updates' times."""
        updates = statistics.median(self.update)
        return self.iteration - updates, updates

    @property
    def iteration(self) -> float:
        """Median time of an iteration."""
        return statistics.median(self.whole)


def measured(envs: int, repeats: int) -> tuple[dict[str, float], StepCosts]:
    """CPU times of every variant, and the costs for the model."""
    learning = STAGE.learning
    assert isinstance(learning, PPOConfig)
    config = EnvConfig(privileged=True, sampling=STAGE.sampling, reward=STAGE.reward)
    batch, samples = BatchSpec(clips(), config, envs, seed=0), envs * learning.rollout_steps
    learners = "2 workers that learn"
    with ray_cluster(None, 5), ExitStack() as stack:
        runs = {"no Ray": Timed(batch.make())}
        runs |= {f"{count} worker(s)": Timed(ActorPool(batch, count)) for count in (1, 2)}
        runs[learners] = Timed(LearningPool(batch, 2))
        for run in runs.values():
            stack.callback(run.env.close)
        for _ in range(repeats):
            for run in runs.values():
                run.iterate()
        size = runs["1 worker(s)"].env.bytes_a_rollout / samples
    whole = {name: run.iteration for name, run in runs.items()}
    play, learn = runs["no Ray"].seconds
    weights = sum(p.numel() for p in runs["no Ray"].ppo.policy.parameters())
    costs = StepCosts(
        play / samples, learn / samples, size, 4.0 * weights, learning.minibatch, learning.epochs
    )
    return {
        **{f"{name}, steps per CPU second": samples / spent for name, spent in whole.items()},
        **{f"{n} worker(s) over no Ray": whole["no Ray"] / whole[f"{n} worker(s)"] for n in (1, 2)},
        f"{learners} over no Ray": whole["no Ray"] / whole[learners],
        "play, us a step": 1e6 * costs.play,
        "learn, us a step": 1e6 * costs.learn,
        "MB a rollout": size * samples / 1e6,
        "MB of gradients instead": costs.gradient * costs.minibatches(samples) / 1e6,
        "overlapped over in turn, two cores, at best": 0.5 * (play + learn) / max(play, learn),
    }, costs


def main() -> None:
    """Measure, predict and print."""
    args = arguments(__doc__ or "", envs=256, repeats=5)
    torch.set_num_threads(1)
    figures, costs = measured(args.envs, args.repeats)
    samples = args.envs * STAGE.learning.rollout_steps  # type: ignore[union-attr]
    figures["limit of one learner, steps/s"] = 2.0 / costs.learn
    for cores in CORES:
        for name, bandwidth in BANDWIDTH.items():
            at = f"{cores} cores, {name}"
            figures[f"predicted, {at}"] = costs.rate(cores, samples, bandwidth)
            figures[f"gradients at best, {at}"] = costs.rate_of_gradients(cores, samples, bandwidth)
    report(figures, args.json)


if __name__ == "__main__":
    main()
