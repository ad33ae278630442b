"""What moves the avatar of a live session on by one step."""

from __future__ import annotations

from typing import Protocol

from agents.agent import Agent, Needs, PolicyAgent
from agents.spec import Layout
from envs.config import EnvConfig
from envs.core import BatchSim
from envs.layout import observation_layout
from questsim.errors import InputError
from questsim.sensors import DEVICES, SENSOR_SETS


class Driver(Protocol):
    """Anything that can drive a session's one avatar: by torques, or by poses."""

    @property
    def needs(self) -> Needs:
        """The environment that it was made for."""
        ...

    def fits(self, config: EnvConfig) -> bool:
        """Whether it can be used in such an environment."""
        ...

    def bind(self, sim: BatchSim) -> None:
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

    def __init__(self, agent: Agent) -> None:
        self.agent = agent

    @property
    def needs(self) -> Needs:
        """The environment that the agent was made for."""
        return self.agent.needs

    def fits(self, config: EnvConfig) -> bool:
        """Whether such an environment shows all that the agent reads."""
        if not isinstance(self.agent, PolicyAgent):
            return True
        try:
            Layout.of(observation_layout(config)).check_provides(self.agent.policy.layout)
        except InputError:
            return False
        return True

    def bind(self, sim: BatchSim) -> None:
        """Find what the agent reads in the simulation's observation; see ``Agent.bind``."""
        self.agent.bind(sim)

    def reset(self) -> None:
        """A clip begins."""
        self.agent.reset(1)

    def advance(self, sim: BatchSim) -> None:
        """Act on what is observed now, for one step."""
        sim.step(self.agent.act(sim.observation))


def usable_sensors(driver: Driver) -> tuple[str, ...]:
    """Names of the sensor sets without IMUs that give the driver what it reads."""
    names = []
    for name, devices in SENSOR_SETS.items():
        if all(DEVICES[device].kind != "imu" for device in devices):
            config = config_for(driver, name)
            if driver.fits(config):
                names.append(name)
    return tuple(names)


def config_for(driver: Driver, sensors: str, height_m: float | None = None) -> EnvConfig:
    """The environment that a driver needs, with these sensors and all avatars of one height."""
    needs = driver.needs
    return EnvConfig(
        sensors=sensors,
        future_frames=needs.future_frames,
        privileged=needs.privileged,
        body_preset=needs.body_preset,
        heights=None if height_m is None else (height_m, height_m),
        fixed_start=True,
    )
