"""The agent protocol, from observation to action, and two baselines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from agents.resolve import RANDOM, ZERO
from questsim.bodies import OwnBody
from questsim.lazy import imported_on_use
from questsim.skeleton import NUM_DOFS


@dataclass(frozen=True)
class Needs:
    """The environment an agent was made for.

    Attributes:
        sensors: name of the sensor set, e.g. ``H+2C``.
        future_frames: number of future frames of the sensors in the observation.
        privileged: whether it observes the reference itself.
        body_preset: name of the body's preset.
        body: a body of the user's own; None for our avatar.
        observe_proportions: whether it observes the avatar's proportions.
    """

    sensors: str = "H+2C"
    future_frames: int = 6
    privileged: bool = False
    body_preset: str = "default"
    body: OwnBody | None = None
    observe_proportions: bool = False


class Agent(Protocol):
    """Protocol of everything that drives a batch of avatars by torques."""

    name: str
    needs: Needs

    def bind(self, env: Any) -> None:
        """Check that ``env`` provides the agent's inputs, and find their columns.

        Raises:
            InputError: names the part that does not fit.
        """
        ...

    def reset(self, n: int) -> None:
        """Restart ``n`` avatars."""
        ...

    def act(self, obs: np.ndarray) -> np.ndarray:
        """Actions ``(n, 33)`` in [-1, 1] for observations ``(n, D)``."""
        ...


def _hinges(env: Any) -> int:
    """Number of hinges of an environment's avatar: of our own, if it does not say."""
    avatar = getattr(env, "avatar", None)
    return NUM_DOFS if avatar is None else len(avatar.dofs)


class ZeroAgent:
    """Zero torques; shows how long an avatar takes to fall."""

    name, needs = ZERO, Needs()

    def __init__(self) -> None:
        self._hinges = NUM_DOFS

    def bind(self, env: Any) -> None:
        """Anything fits."""
        self._hinges = _hinges(env)

    def reset(self, n: int) -> None:
        """Nothing to forget."""

    def act(self, obs: np.ndarray) -> np.ndarray:
        """Zeros ``(n, 33)``, or as many columns as the body has hinges."""
        return np.zeros((len(obs), self._hinges), dtype=np.float32)


class RandomAgent:
    """Torques drawn uniformly from [-1, 1] each step; every reset repeats the sequence."""

    name, needs = RANDOM, Needs()

    def __init__(self, seed: int = 0) -> None:
        self._seed = seed
        self._random = np.random.default_rng(seed)
        self._hinges = NUM_DOFS

    def bind(self, env: Any) -> None:
        """Anything fits."""
        self._hinges = _hinges(env)

    def reset(self, n: int) -> None:
        """Restart the random numbers."""
        self._random = np.random.default_rng(self._seed)

    def act(self, obs: np.ndarray) -> np.ndarray:
        """Random numbers ``(n, 33)``, or as many columns as the body has hinges."""
        return self._random.uniform(-1.0, 1.0, (len(obs), self._hinges)).astype(np.float32)


_ELSEWHERE = {
    "PolicyAgent": "agents.policy.policy_agent",
    "Tracker": "agents.policy.policy_agent",
    "load_agent": "agents.loading",
}
"""Public names that are available here and in ``agents``."""

__getattr__ = imported_on_use(__name__, _ELSEWHERE)
