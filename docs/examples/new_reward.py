"""A new reward term: torques that are small earn a little more."""

import numpy as np

from envs import EnvConfig, QuestVecEnv
from questsim.motion.synthesis.synthetic import synthesise


def effort(action: np.ndarray, k: float = 20.0) -> np.ndarray:
    """exp(-k * mean square action) ``(n,)`` of actions ``(n, 33)`` in [-1, 1]."""
    return np.exp(-k * np.mean(np.clip(action, -1.0, 1.0) ** 2, axis=-1))


class FrugalVecEnv(QuestVecEnv):
    """The task with 90 % of its reward, and 10 % for ``effort``."""

    def _advance(self) -> None:
        super()._advance()
        good = ~self.sim.unstable  # physics that failed earns nothing
        self.sim.reward[good] *= 0.9
        self.sim.reward[good] += 0.1 * effort(self._action[good])


def main() -> tuple[np.ndarray, np.ndarray]:
    """The same step at rest and under random torques; rewards ``(4,)`` of each."""
    env = FrugalVecEnv([synthesise("stand", duration=2.0)], EnvConfig(), num_envs=4)
    rewards = []
    for scale in (0.0, 0.5):
        env.seed(0)
        env.reset()
        actions = np.random.default_rng(0).normal(0.0, scale, (4, 33)).astype(np.float32)
        rewards.append(env.step(actions)[1])
    return rewards[0], rewards[1]


if __name__ == "__main__":
    print("rewards at rest and under random torques:", *main())
