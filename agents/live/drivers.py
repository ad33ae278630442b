"""Drivers: they advance the avatar of a live session by one step."""

from __future__ import annotations

from typing import Protocol

from agents.agent import Agent, Needs
from agents.policy.policy_agent import PolicyAgent
from agents.policy.spec import Layout
from envs.config import EnvConfig
from envs.core import BatchSim
from envs.layout import observation_layout
from questsim.errors import InputError
from questsim.motion.clip import Clip
from questsim.sensors import DEVICES, SENSOR_SETS


class Driver(Protocol):
    """Protocol of a driver of a session's avatar, by torques or by poses.

    Attributes:
        physics: whether torques move the avatar. Without physics the avatar shows poses directly
            and cannot be pushed.
    """

    physics: bool

    @property
    def needs(self) -> Needs:
        """The environment that it was trained in."""
        ...

    def sensor_sets(self) -> tuple[str, ...]:
        """Names of the sensor sets that provide its inputs."""
        ...

    def config(self, sensors: str, height_m: float | None = None) -> EnvConfig:
        """The environment that it needs, with these sensors and all avatars of one height."""
        ...

    def shown(self, clip: Clip, sensors: str) -> list[Clip] | None:
        """The clip that it observes instead, see ``BatchSim``; None for the clip itself."""
        ...

    def bind(self, sim: BatchSim, sensors: str) -> None:
        """Bind to a simulation; after an ``InputError`` the previous one stays bound."""
        ...

    def reset(self) -> None:
        """A clip begins."""
        ...

    def advance(self, sim: BatchSim) -> None:
        """One step of 1/36 s."""
        ...


class TorqueDriver:
    """Drives by the torques of an agent.

    Args:
        agent: a policy, or one of the baselines.
    """

    physics = True

    def __init__(self, agent: Agent) -> None:
        self.agent = agent

    @property
    def needs(self) -> Needs:
        """The environment that the agent was trained in."""
        return self.agent.needs

    def sensor_sets(self) -> tuple[str, ...]:
        """Names of the sensor sets without IMUs that provide all inputs of the agent."""
        return tuple(
            name
            for name, devices in SENSOR_SETS.items()
            if all(DEVICES[device].kind != "imu" for device in devices)
            and self._fits(self.config(name))
        )

    def _fits(self, config: EnvConfig) -> bool:
        if not isinstance(self.agent, PolicyAgent):
            return True
        try:
            Layout.of(observation_layout(config)).check_provides(self.agent.policy.layout)
        except InputError:
            return False
        return True

    def config(self, sensors: str, height_m: float | None = None) -> EnvConfig:
        """The environment that the agent needs, with these sensors and avatars of one height."""
        needs = self.needs
        return EnvConfig(
            sensors=sensors,
            future_frames=needs.future_frames,
            privileged=needs.privileged,
            body_preset=needs.body_preset,
            observe_proportions=needs.observe_proportions,
            heights=None if height_m is None else (height_m, height_m),
            fixed_start=True,
        )

    def shown(self, clip: Clip, sensors: str) -> list[Clip] | None:
        """None: the agent observes the clip itself."""
        return None

    def bind(self, sim: BatchSim, sensors: str) -> None:
        """Bind the agent to the simulation's observation; see ``Agent.bind``."""
        self.agent.bind(sim)

    def reset(self) -> None:
        """A clip begins."""
        self.agent.reset(1)

    def advance(self, sim: BatchSim) -> None:
        """Act on the present observation for one step."""
        sim.step(self.agent.act(sim.observation))
