"""A new reward term: a penalty on mechanical power, for policies that waste no energy.

To train with it, set ``QUESTSIM_EXTENSIONS=docs.examples.new_reward`` and give ``train.py``
the option ``--set stages.teacher.reward.energy=0.1``.
"""

import numpy as np

from envs import EnvConfig, QuestVecEnv
from questsim.motion.synthesis.synthetic import synthesise
from questsim.reward import Moment, RewardConfig, register_term


def energy(moment: Moment, k: float) -> np.ndarray:
    """-k * mean over joints of |torque * velocity| ``(n,)``: k per watt."""
    return -k * np.abs(moment.torque * moment.joint_velocities).mean(axis=-1)


register_term("energy", energy, k=0.01)


def main() -> list[np.ndarray]:
    """Values ``(4,)`` of the term in a step at rest and in one under random torques."""
    config = EnvConfig(reward=RewardConfig(energy=0.1))
    env = QuestVecEnv([synthesise("stand", duration=2.0)], config, num_envs=4)
    values = []
    for scale in (0.0, 0.5):
        env.seed(0)
        env.reset()
        actions = np.random.default_rng(0).normal(0.0, scale, (4, 33)).astype(np.float32)
        env.step(actions)
        values.append(env.sim.reward_terms[:, env.sim.reward_names.index("energy")].copy())
    return values


if __name__ == "__main__":
    print("energy at rest and under random torques:", *main())
