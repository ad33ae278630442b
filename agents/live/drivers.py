"""What moves the avatar of a live session on by one step."""

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
    """Anything that can drive a session's one avatar: by torques, or by poses.

    Attributes:
        physics: whether torques move the avatar; without, it takes poses as they are, and nothing
            can push it.
    """

    physics: bool

    @property
    def needs(self) -> Needs:
        """The environment that it was made for."""
        ...

    def sensor_sets(self) -> tuple[str, ...]:
        """Names of the sensor sets that give it what it reads."""
        ...

    def config(self, sensors: str, height_m: float | None = None) -> EnvConfig:
        """The environment that it needs, with these sensors and all avatars of one height."""
        ...

    def shown(self, clip: Clip, sensors: str) -> list[Clip] | None:
        """What it sees in place of a clip, see ``BatchSim``; None for the clip itself."""
        ...

    def bind(self, sim: BatchSim, sensors: str) -> None:
        """Get to know a simulation; an ``InputError`` leaves the one before in force."""
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
        """The environment that the agent was made for."""
        return self.agent.needs

    def sensor_sets(self) -> tuple[str, ...]:
        """Names of the sensor sets without IMUs that show all that the agent reads."""
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
            heights=None if height_m is None else (height_m, height_m),
            fixed_start=True,
        )

    def shown(self, clip: Clip, sensors: str) -> list[Clip] | None:
        """Nothing in place of the clip."""
        return None

    def bind(self, sim: BatchSim, sensors: str) -> None:
        """Find what the agent reads in the simulation's observation; see ``Agent.bind``."""
        self.agent.bind(sim)

    def reset(self) -> None:
        """A clip begins."""
        self.agent.reset(1)

    def advance(self, sim: BatchSim) -> None:
        """Act on what is observed now, for one step."""
        sim.step(self.agent.act(sim.observation))
