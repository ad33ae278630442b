"""Teacher steps/s with and without Ray workers, and what to expect of more cores.

    python -m benchmarks.cluster [--json] [--envs 256] [--repeats 5]

The same teacher PPO as the preset `cpu` learns with: here, and with one and two workers of half
the batch each. A model of playing, updating and moving data predicts larger clusters:

    seconds of an iteration = avatars a worker * steps * p + N * bytes a worker / bandwidth
                              + N * avatars a worker * steps * u

with p the seconds to play one step on one core, u those to learn from one on the learner's two
cores, N the workers. Workers play side by side; the learner receives and learns alone.
"""

from __future__ import annotations

import statistics
from dataclasses import dataclass
from typing import Any

import torch

from agents.training.cluster import ActorPool
from agents.training.make_learner import make_ppo
from agents.training.ppo import AdaptivePPO
from agents.training.presets import PRESETS
from agents.training.ray_session import ray_cluster
from agents.training.rollout_worker import BatchSpec
from benchmarks.common import arguments, clips, report, seconds
from envs.config import EnvConfig

CORES = (2, 8, 64, 512)
BANDWIDTH = {"1 Gbit/s": 1e9 / 8, "10 Gbit/s": 1e10 / 8}


@dataclass(frozen=True)
class Costs:
    """What the model is made of.

    Attributes:
        play: seconds of one core to play a step of one avatar.
        update: seconds of the learner to learn from it.
        size: bytes of it that a worker returns.
    """

    play: float
    update: float
    size: float

    def rate(self, workers: int, avatars: int, steps: int, bandwidth: float) -> float:
        """Predicted environment steps/s of so many workers of one core, each with ``avatars``."""
        samples = workers * avatars * steps
        moved = samples * self.size / bandwidth
        return samples / (avatars * steps * self.play + moved + samples * self.update)


def _teacher(env: Any, threads: int) -> AdaptivePPO:
    config = PRESETS["cpu"].stages["teacher"]
    return make_ppo(config, config.learning, env, 0, threads)  # type: ignore[arg-type]


def _timed(ppo: AdaptivePPO, repeats: int) -> tuple[float, float]:
    """Median seconds of an iteration, and of its update alone."""
    whole, update = [], []
    train = ppo.train

    def timed_update() -> None:
        update.append(seconds(train))

    ppo.train = timed_update  # type: ignore[method-assign]
    for _ in range(2):  # measures the observations, then compiles and warms
        ppo.iterate(lambda *_: None, 0.0)
    update.clear()
    for _ in range(repeats):
        whole.append(seconds(lambda: ppo.iterate(lambda *_: None, 0.0)))
    return statistics.median(whole), statistics.median(update)


def main() -> None:
    """Measure, fit, predict and print."""
    args = arguments(__doc__ or "", envs=256, repeats=5)
    torch.set_num_threads(1)
    stage = PRESETS["cpu"].stages["teacher"]
    steps = stage.learning.rollout_steps  # type: ignore[union-attr]
    config = EnvConfig(privileged=True, sampling=stage.sampling, reward=stage.reward)
    batch = BatchSpec(clips(), config, args.envs, seed=0)
    samples = args.envs * steps

    env = batch.make()
    alone, update = _timed(_teacher(env, 2), args.repeats)
    play = alone - update  # one thread plays
    env.close()
    figures: dict[str, float] = {"no Ray, steps/s": samples / alone}
    size = 0.0
    with ray_cluster(None, 2):
        for count in (1, 2):
            pool = ActorPool(batch, count)
            whole, _ = _timed(_teacher(pool, 2), args.repeats)
            size = pool.bytes_a_rollout / samples
            pool.close()
            figures[f"{count} worker(s), steps/s"] = samples / whole
            figures[f"{count} worker(s) over no Ray"] = alone / whole
    costs = Costs(play / samples, update / samples, size)
    figures |= {
        "play, us a step and core": 1e6 * costs.play,
        "update, us a step": 1e6 * costs.update,
        "bytes a step": costs.size,
        "MB a rollout": size * samples / 1e6,
        "limit of one learner, steps/s": 1.0 / costs.update,
    }
    for cores in CORES:
        for name, bandwidth in BANDWIDTH.items():
            figures[f"predicted, {cores} cores, {name}"] = costs.rate(
                cores, args.envs, steps, bandwidth
            )
    report(figures, args.json)


if __name__ == "__main__":
    main()
