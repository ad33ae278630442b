"""Small learners for tests."""

from __future__ import annotations

from dataclasses import replace

from fake_env import FakeVecEnv

from agents.policy.spec import TRACKER_BLOCKS, PolicySpec
from agents.training.make_ppo import make_ppo
from agents.training.ppo import AdaptivePPO
from agents.training.presets import PPOConfig, StageConfig

SMALL = PolicySpec(TRACKER_BLOCKS, TRACKER_BLOCKS, (32, 32), "elu", reference_head=True)
QUICK = PPOConfig(minibatch=128, rollout_steps=16)


def nothing(*_: object) -> None:
    """An observer that looks away."""


def small_ppo(env: FakeVecEnv, seed: int = 0, threads: int = 1, **changes) -> AdaptivePPO:
    config = StageConfig(1.0, SMALL, replace(QUICK, **changes))
    assert isinstance(config.learning, PPOConfig)
    return make_ppo(config, config.learning, env, seed, threads)  # type: ignore[arg-type]
