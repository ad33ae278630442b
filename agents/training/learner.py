"""What the two ways of learning, PPO and DAgger, have in common."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from agents.policy.networks import TorquePolicy
from questsim.errors import InputError

StepObserver = Callable[[np.ndarray, np.ndarray, list[dict[str, Any]]], None]
"""Called after each environment step with rewards ``(n,)``, dones ``(n,)`` and infos."""


class Learner(Protocol):
    """Something that improves a policy, an iteration at a time."""

    policy: TorquePolicy
    num_timesteps: int

    def iterate(self, observe: StepObserver, progress: float) -> dict[str, float]:
        """One rollout and the update after it; returns figures to log.

        Args:
            observe: told of every environment step.
            progress: share of the budget that is used, 0 to 1.
        """
        ...

    def begin_anew(self) -> None:
        """Begin episodes anew before the next iteration: the environment has other motions."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """What going on needs, in plain values and tensors."""
        ...

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from ``state_dict``."""
        ...


class TrainingError(InputError):
    """Training cannot go on; what was saved before is good.

    Args:
        what: what went wrong, e.g. ``"the loss is not finite"``.
        steps: environment steps of the stage at which it was noticed.
    """

    def __init__(self, what: str, steps: int) -> None:
        super().__init__(what, f"training step {steps}", "the last checkpoint before it is kept")
