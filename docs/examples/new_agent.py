"""A new agent: springs that hold the joints straight, whatever the headset does."""

from typing import Any

import numpy as np

from agents.agent import Needs
from agents.evaluation import env_config, roll_out
from questsim.evaluation_report import format_table
from questsim.metrics import evaluate
from questsim.motion.synthesis.synthetic import synthesise


class SpringAgent:
    """Holds the zero pose with critically damped springs."""

    name, needs = "springs", Needs()

    def bind(self, env: Any) -> None:
        """Find the joint angles in the observation, and how strong the joints are."""
        self._columns = env.layout["joint_angles"]
        self._gain = 4.0 * env.body.damping / 0.04 / env.body.torque_limits

    def reset(self, n: int) -> None:
        """Nothing to forget."""

    def act(self, obs: np.ndarray) -> np.ndarray:
        """Actions ``(n, 33)`` for observations ``(n, D)``."""
        return -self._gain * obs[:, self._columns]


def main() -> dict[str, Any]:
    """Score it on a clip of standing."""
    agent = SpringAgent()
    return evaluate(roll_out(agent, [synthesise("stand", duration=2.0)], env_config(agent)))


if __name__ == "__main__":
    print(format_table(main()))
