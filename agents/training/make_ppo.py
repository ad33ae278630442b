"""PPO with a new policy, as a stage's settings say."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from agents.policy.networks import TorquePolicy
from agents.policy.spec import Layout, noise_by_joint
from agents.policy.stepping import start_gains
from agents.training.ppo import AdaptivePPO
from agents.training.presets import PPOConfig, StageConfig
from envs import QuestVecEnv

if TYPE_CHECKING:
    from agents.training.cluster import ActorPool


def exploration_noise(ppo: PPOConfig, env: QuestVecEnv | ActorPool) -> np.ndarray:
    """Standard deviation of the exploration noise of each hinge."""
    strong = env.avatar.strong
    return noise_by_joint(strong, ppo.noise_legs_and_trunk, ppo.noise_arms_and_neck)


def make_ppo(
    config: StageConfig,
    ppo: PPOConfig,
    env: QuestVecEnv | ActorPool,
    seed: int,
    threads: int = 1,
    kind: type[AdaptivePPO] = AdaptivePPO,
) -> AdaptivePPO:
    """PPO with a new policy for ``env``."""
    noise = exploration_noise(ppo, env)
    return kind(
        TorquePolicy,
        env,
        desired_kl=ppo.desired_kl,
        final_kl=ppo.final_kl,
        reward_scale=ppo.reward_scale,
        bfloat16=ppo.bfloat16,
        threads=threads,
        learning_rate=ppo.learning_rate,
        n_steps=ppo.rollout_steps,
        batch_size=min(ppo.minibatch, ppo.rollout_steps * env.num_envs),
        n_epochs=ppo.epochs,
        gamma=ppo.gamma,
        gae_lambda=ppo.gae_lambda,
        clip_range=ppo.clip,
        vf_coef=1.0,
        max_grad_norm=ppo.max_grad_norm,
        seed=seed,
        policy_kwargs={
            "spec": config.policy,
            "layout": Layout.of(env.layout),
            "gains": start_gains(config.policy.balance, env.torque_limits, env.damping),
            "noise": noise,
            "learn_noise": ppo.learn_noise,
            "critic_learning_rate": ppo.critic_learning_rate,
        },
    )
