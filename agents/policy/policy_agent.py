"""A trained policy as an agent."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from torch import nn

from agents.agent import Needs
from agents.policy.networks import TorquePolicy
from agents.policy.spec import Layout, PolicySpec
from agents.policy.stepping import start_gains
from questsim.bodies import OwnBody
from questsim.body import build_body
from questsim.errors import InputError
from questsim.sensors import sensor_set
from questsim.skeleton import NUM_DOFS

if TYPE_CHECKING:
    from envs.config import EnvConfig


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
        config, layout = getattr(env, "config", None), Layout.of(self.blocks(env.layout))
        check_body(self.name, self.needs.body, getattr(config, "body", None))
        if config is not None:
            self._check_observes(config)
        layout.check_provides(self.policy.layout, self.name)
        preset = getattr(config, "body_preset", self.needs.body_preset)
        if preset != self.needs.body_preset:
            raise InputError(
                f"was trained with body_preset {self.needs.body_preset!r}, not {preset!r}",
                self.name,
                "make the environment with the policy's own",
            )
        self.policy.use_layout(layout)

    def blocks(self, layout: dict[str, slice]) -> dict[str, slice]:
        """The blocks of an environment's observation, by the names under which it reads them."""
        return layout

    def devices(self, config: EnvConfig) -> tuple[str, int]:
        """Sensor set and number of future frames of an environment's block that it reads."""
        return config.sensors, config.future_frames

    def _check_observes(self, config: EnvConfig) -> None:
        """Refuse devices, frames or proportions that it was not trained with.

        Different ones can have the same number of columns: two future frames of three devices and
        six of one, or the present frame and the next one.
        """
        reads, needs = self.policy.layout.blocks, self.needs
        sensors, frames = self.devices(config)
        other = sensor_set(sensors) != sensor_set(needs.sensors) or frames != needs.future_frames
        if other and "o_user" in reads:
            raise InputError(
                f"observes {needs.sensors} with {needs.future_frames} future frames, not {sensors} "
                f"with {frames}",
                self.name,
                "use the sensors and number of future frames it was trained with",
            )
        if needs.observe_proportions != config.observe_proportions and "o_scale" in reads:
            does, fix = (
                ("observes", "on") if needs.observe_proportions else ("does not observe", "off")
            )
            what = f"{does} the avatar's proportions"
            raise InputError(what, self.name, f"turn observe_proportions {fix}")

    def reset(self, n: int) -> None:
        """Does nothing: the policy has no state."""

    def act(self, obs: np.ndarray) -> np.ndarray:
        """Deterministic actions ``(n, 33)`` for observations ``(n, D)``."""
        return self.policy.predict_batch(obs)


def check_body(name: str, trained: OwnBody | None, found: OwnBody | None) -> None:
    """Refuse a policy on another body than it was trained for."""
    if (trained and trained.digest) == (found and found.digest):
        return
    if trained is None:
        assert found is not None
        raise InputError(
            f"was trained for our own body, not for {found.name!r}", name, "leave out --body"
        )
    other = "ours" if found is None else repr(found.name)
    raise InputError(
        f"was trained for the body {trained.name!r}, not for {other}",
        name,
        f"add --body {trained.path}",
    )


def head_alone(spec: PolicySpec, layout: Layout) -> TorquePolicy:
    """A policy for our body whose network outputs zero, so that it acts by its head alone."""
    body = build_body()
    gains = start_gains(spec.balance, body.torque_limits, body.damping)
    policy = new_policy(spec, layout, gains=gains)
    last = policy.actor.layers[-1]
    assert isinstance(last, nn.Linear)
    nn.init.zeros_(last.weight)
    return policy


class Tracker(PolicyAgent):
    """A policy that observes the full-body reference of any motion and outputs torques."""


def new_policy(
    spec: PolicySpec,
    layout: Layout,
    learning_rate: float = 1e-3,
    hinges: int = NUM_DOFS,
    **settings: Any,
) -> TorquePolicy:
    """A policy that is not yet bound to an environment.

    Args:
        spec: networks and head.
        layout: the observation blocks it reads.
        learning_rate: learning rate of its optimiser.
        hinges: number of actions.
        **settings: other arguments of ``TorquePolicy``.
    """
    columns = max(stop for _, stop in layout.blocks.values())
    if spec.torque_head and settings.get("gains") is None:
        settings["gains"] = np.ones(hinges)
    return TorquePolicy(
        spaces.Box(-np.inf, np.inf, (columns,), np.float32),
        spaces.Box(-1.0, 1.0, (hinges,), np.float32),
        lambda _: learning_rate,
        spec=spec,
        layout=layout,
        **settings,
    )
