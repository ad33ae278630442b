"""What answers an observation with an action: trained policies and two baselines."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces

from agents.policy.networks import TorquePolicy
from agents.policy.spec import Layout, PolicySpec
from questsim.errors import InputError
from questsim.skeleton import NUM_DOFS


@dataclass(frozen=True)
class Needs:
    """The environment an agent was made for.

    Attributes:
        sensors: name of the sensor set, e.g. ``H+2C``.
        future_frames: number of future frames of the sensors in the observation.
        privileged: whether it reads the reference itself.
        body_preset: name of the body's preset.
    """

    sensors: str = "H+2C"
    future_frames: int = 6
    privileged: bool = False
    body_preset: str = "default"


class Agent(Protocol):
    """Anything that drives a batch of avatars."""

    name: str
    needs: Needs

    def bind(self, env: Any) -> None:
        """Check that ``env`` gives what the agent reads, and find it there.

        Raises:
            InputError: naming what does not fit.
        """
        ...

    def reset(self, n: int) -> None:
        """Start ``n`` avatars anew."""
        ...

    def act(self, obs: np.ndarray) -> np.ndarray:
        """Actions ``(n, 33)`` in [-1, 1] for observations ``(n, D)``."""
        ...


class ZeroAgent:
    """No torque at all: how long an avatar takes to fall."""

    name, needs = "zero", Needs()

    def bind(self, env: Any) -> None:
        """Anything fits."""

    def reset(self, n: int) -> None:
        """Nothing to forget."""

    def act(self, obs: np.ndarray) -> np.ndarray:
        """Zeros ``(n, 33)``."""
        return np.zeros((len(obs), NUM_DOFS), dtype=np.float32)


class RandomAgent:
    """Torques drawn evenly from [-1, 1], anew each step; the same ones after each reset."""

    name, needs = "random", Needs()

    def __init__(self, seed: int = 0) -> None:
        self._seed = seed
        self._random = np.random.default_rng(seed)

    def bind(self, env: Any) -> None:
        """Anything fits."""

    def reset(self, n: int) -> None:
        """Start the random numbers anew."""
        self._random = np.random.default_rng(self._seed)

    def act(self, obs: np.ndarray) -> np.ndarray:
        """Random numbers ``(n, 33)``."""
        return self._random.uniform(-1.0, 1.0, (len(obs), NUM_DOFS)).astype(np.float32)


class PolicyAgent:
    """A trained torque policy, acting without noise.

    Args:
        policy: the networks.
        needs: the environment it was trained in.
        name: for messages and reports.
        card: the rest of its ``policy.yaml``: data, licence, training.
    """

    def __init__(
        self,
        policy: TorquePolicy,
        needs: Needs,
        name: str = "policy",
        card: dict[str, Any] | None = None,
    ) -> None:
        self.policy, self.needs, self.name = policy, needs, name
        self.card = card or {}
        self.policy.eval()

    def bind(self, env: Any) -> None:
        """Take the columns of the policy's inputs from ``env.layout``; see ``Agent.bind``."""
        layout = Layout.of(env.layout)
        layout.check_provides(self.policy.layout, self.name)
        config = getattr(env, "config", None)
        preset = getattr(config, "body_preset", self.needs.body_preset)
        if preset != self.needs.body_preset:
            raise InputError(
                f"trained with body {self.needs.body_preset!r}, the environment has {preset!r}",
                self.name,
            )
        self.policy.use_layout(layout)

    def reset(self, n: int) -> None:
        """Nothing to forget: the policy has no memory."""

    def act(self, obs: np.ndarray) -> np.ndarray:
        """Deterministic actions ``(n, 33)`` for observations ``(n, D)``."""
        return self.policy.predict_batch(obs)


class Tracker(PolicyAgent):
    """A policy that reads the full-body reference: given any motion, it produces torques."""


def new_policy(
    spec: PolicySpec, layout: Layout, learning_rate: float = 1e-3, **settings: Any
) -> TorquePolicy:
    """A policy that belongs to no environment yet.

    Args:
        spec: networks and head.
        layout: the observation blocks it reads.
        learning_rate: of its optimiser.
        **settings: the others of ``TorquePolicy``.
    """
    columns = max(stop for _, stop in layout.blocks.values())
    if spec.torque_head and settings.get("gains") is None:
        settings["gains"] = np.ones(NUM_DOFS)
    return TorquePolicy(
        spaces.Box(-np.inf, np.inf, (columns,), np.float32),
        spaces.Box(-1.0, 1.0, (NUM_DOFS,), np.float32),
        lambda _: learning_rate,
        spec=spec,
        layout=layout,
        **settings,
    )


def load_agent(path_or_name: str | Path) -> Agent:
    """An agent by name (``zero``, ``random`` or a shipped policy), policy folder or run folder.

    Raises:
        InputError: if there is no such agent, or its checkpoint is of another format version,
            joint order, link order or observation layout.
    """
    from agents.policy.checkpoint import find_policy, load_policy

    if path_or_name == "zero":
        return ZeroAgent()
    if path_or_name == "random":
        return RandomAgent()
    return load_policy(find_policy(path_or_name))
