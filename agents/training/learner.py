"""The common interface of the learners, PPO and DAgger."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from agents.policy.networks import TorquePolicy
from questsim.errors import InputError

StepObserver = Callable[[np.ndarray, np.ndarray, list[dict[str, Any]]], None]
"""Called after each environment step with rewards ``(n,)``, dones ``(n,)`` and infos."""


class Learner(Protocol):
    """Trains a policy, one iteration at a time."""

    policy: TorquePolicy
    num_timesteps: int

    def iterate(self, observe: StepObserver, progress: float) -> dict[str, float]:
        """One rollout and the update after it; returns figures to log.

        Args:
            observe: called after every environment step.
            progress: used share of the budget, 0 to 1.
        """
        ...

    def begin_anew(self) -> None:
        """Restart all episodes before the next iteration, after the motions changed."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """State for resuming, as plain values and tensors."""
        ...

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from ``state_dict``."""
        ...


class TrainingError(InputError):
    """Training cannot continue; earlier checkpoints are valid.

    Args:
        what: what went wrong, e.g. ``"the loss is not finite"``.
        steps: environment steps of the stage when it was noticed.
    """

    def __init__(self, what: str, steps: int) -> None:
        super().__init__(what, f"training step {steps}", "the last checkpoint before it is kept")
