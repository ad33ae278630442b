"""Teacher steps/s with and without Ray workers, and what to expect of more cores.

    python -m benchmarks.cluster [--json] [--envs 256] [--repeats 5]

The teacher of the preset `cpu` learns by PPO: here with one and with two threads, and with one
Ray worker of two threads and two of one thread. Iterations of all of them alternate, so that a busy
machine slows all alike. A model with the measured costs predicts larger clusters, with 256 avatars
and one core a worker. Seconds of an iteration:

    rollouts to the learner:  s * p + N * s * b / B + N * s * u
    gradients of the workers: s * p + s * u1 + k * 2 * g / B

with s = avatars of a worker * steps; p, u1 seconds to play and to learn from one step on one core;
u those to learn from it on the learner's two cores; N the workers, B the bandwidth, b the bytes of
a step, k the minibatches of an iteration of one worker, g the bytes of a gradient. Workers play
side by side. In the first line, which is what the project does, the learner alone receives and
learns. The second is the best case of averaging the gradients: no worker waits for another.
"""

from __future__ import annotations

import statistics
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import torch

from agents.training.cluster import ActorPool
from agents.training.make_learner import make_ppo
from agents.training.ppo import AdaptivePPO
from agents.training.presets import PRESETS, PPOConfig
from agents.training.ray_session import ray_cluster
from agents.training.rollout_worker import BatchSpec
from benchmarks.common import arguments, clips, report, seconds
from envs.config import EnvConfig

CORES = (8, 64, 512)
BANDWIDTH = {"1 Gbit/s": 1e9 / 8, "10 Gbit/s": 1e10 / 8}
STAGE = PRESETS["cpu"].stages["teacher"]


@dataclass(frozen=True)
class Costs:
    """What the model is made of.

    Attributes:
        play, learn: seconds of one core to play a step of one avatar and to learn from it.
        update: seconds of the learner's two cores to learn from it.
        size: bytes of it that a worker returns.
        gradient: bytes of a gradient.
        minibatch, epochs: of the update.
    """

    play: float
    learn: float
    update: float
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
        moved = workers * samples * self.size / bandwidth
        return workers * samples / (samples * (self.play + workers * self.update) + moved)

    def rate_of_gradients(self, workers: int, samples: int, bandwidth: float) -> float:
        """Predicted environment steps/s if workers learn and their gradients are averaged."""
        moved = 2.0 * self.gradient * self.minibatches(samples) / bandwidth
        return workers * samples / (samples * (self.play + self.learn) + moved)

    def minibatches(self, samples: int) -> float:
        """Gradients of an iteration."""
        return self.epochs * samples / self.minibatch


class Timed:
    """A teacher whose iterations and updates are timed."""

    def __init__(self, env: Any, threads: int) -> None:
        self.env = env
        self.ppo: AdaptivePPO = make_ppo(STAGE, STAGE.learning, env, 0, threads)  # type: ignore[arg-type]
        self.whole: list[float] = []
        self.update: list[float] = []
        train = self.ppo.train
        self.ppo.train = lambda: self.update.append(seconds(train))  # type: ignore[method-assign]
        for _ in range(2):  # measures the observations, then compiles and warms
            self.iterate()
        self.whole, self.update = [], []

    def iterate(self) -> None:
        """One rollout and update."""
        self.whole.append(seconds(lambda: self.ppo.iterate(lambda *_: None, 0.0)))

    @property
    def seconds(self) -> tuple[float, float]:
        """Median of the rollouts' and of the updates' times."""
        updates = statistics.median(self.update)
        return statistics.median(self.whole) - updates, updates


def measured(envs: int, repeats: int) -> tuple[dict[str, float], Costs]:
    """Steps/s of every variant, and the costs for the model."""
    learning = STAGE.learning
    assert isinstance(learning, PPOConfig)
    config = EnvConfig(privileged=True, sampling=STAGE.sampling, reward=STAGE.reward)
    batch = BatchSpec(clips(), config, envs, seed=0)
    two, samples = replace(batch, threads=2), envs * learning.rollout_steps
    with ray_cluster(None, 4), ExitStack() as stack:
        runs = {
            "1 thread": Timed(batch.make(), 1),
            "2 threads": Timed(two.make(), 2),
            "1 worker, 2 threads": Timed(ActorPool(two, 1), 2),
            "2 workers, 1 thread": Timed(ActorPool(batch, 2), 2),
        }
        for run in runs.values():
            stack.callback(run.env.close)
        for _ in range(repeats):
            for run in runs.values():
                run.iterate()
        size = runs["1 worker, 2 threads"].env.bytes_a_rollout / samples
    rates = {name: samples / sum(run.seconds) for name, run in runs.items()}
    play, learn = runs["1 thread"].seconds
    both = rates["2 threads"]
    weights = sum(p.numel() for p in runs["1 thread"].ppo.policy.parameters())
    costs = Costs(
        play / samples,
        learn / samples,
        runs["2 threads"].seconds[1] / samples,
        size,
        4.0 * weights,
        learning.minibatch,
        learning.epochs,
    )
    return {
        **{f"{name}, steps/s": rate for name, rate in rates.items()},
        "1 worker, 2 threads, over 2 threads": rates["1 worker, 2 threads"] / both,
        "2 workers, 1 thread, over 2 threads": rates["2 workers, 1 thread"] / both,
        "overlapped at best, over 2 threads": samples / max(play, learn) / both,
        "MB a rollout": size * samples / 1e6,
        "MB of gradients instead": costs.gradient * costs.minibatches(samples) / 1e6,
        "play, us a step and core": 1e6 * costs.play,
        "learn, us a step and core": 1e6 * costs.learn,
        "learn, us a step, two cores": 1e6 * costs.update,
    }, costs


def main() -> None:
    """Measure, predict and print."""
    args = arguments(__doc__ or "", envs=256, repeats=5)
    torch.set_num_threads(1)
    figures, costs = measured(args.envs, args.repeats)
    samples = args.envs * STAGE.learning.rollout_steps  # type: ignore[union-attr]
    figures["limit of one learner, steps/s"] = 1.0 / costs.update
    for cores in CORES:
        for name, bandwidth in BANDWIDTH.items():
            at = f"{cores} cores, {name}"
            figures[f"predicted, {at}"] = costs.rate(cores, samples, bandwidth)
            figures[f"gradients at best, {at}"] = costs.rate_of_gradients(cores, samples, bandwidth)
    report(figures, args.json)


if __name__ == "__main__":
    main()
