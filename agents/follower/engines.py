"""Engines: convert device moments at a fixed rate into avatar states, one per kind of agent.

- ``TorqueEngine``: a policy that reads devices at 36 Hz, on simulated physics.
- ``PoseEngine``: a kinematic system at 60 Hz; its poses are shown directly.
- ``PhysicsEngine`` (``physics_engine.py``): a tracker follows a kinematic system's poses on
  simulated physics.

Each processes one moment of the devices at a time, in constant time and memory.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from agents.agent import Agent
from agents.follower.moving import MovingUser, estimator
from agents.follower.scene import PLAIN, Scene
from agents.follower.states import (
    NO_OBJECTS,
    AvatarState,
    resting_state,
)
from agents.follower.system_poses import SystemPoses, live_set
from agents.kinematic.interface import KinematicSystem
from agents.policy.policy_agent import PolicyAgent
from agents.policy.spec import Layout
from agents.resolve import PHYSICS
from envs.assist import Assist, checked_bound, headsets
from envs.config import EnvConfig
from envs.layout import observation_layout
from envs.stream import NOW, StreamSim
from envs.terrain import Terrain, height_field
from questsim.errors import InputError
from questsim.joint_sensors import SENSOR_FPS
from questsim.motion.clip import FPS
from questsim.sensors import sensor_set
from questsim.skeleton import NUM_DOFS

QPOS = 7 + NUM_DOFS


class Engine(ABC):
    """Moves one avatar.

    Attributes:
        names: the devices that it reads, in order.
        rate_hz: device moments per second.
        latency_s: delay of its interpolated states behind the newest moment.
        physics: whether the avatar is simulated and can fall.
        height_m: the avatar's stature, once it is set.
        assist_n: bound of the assisting force in N.
    """

    names: tuple[str, ...]
    rate_hz: float
    latency_s: float
    physics: bool
    height_m: float
    assist_n: float = 0.0
    _assist: Assist | None = None

    @property
    def objects(self) -> np.ndarray:
        """Positions and quaternions ``(K, 7)`` of the objects; none without physics."""
        return NO_OBJECTS

    def set_assist(self, bound_n: float) -> None:
        """Set the largest assisting force in newtons; 0 for none.

        Raises:
            InputError: the engine has no physics, or the force is out of range.
        """
        if bound_n and not self.physics:
            raise InputError(
                "an agent without physics cannot be assisted", "assist", "leave it out"
            )
        checked_bound(bound_n)
        self.assist_n = bound_n
        if self._assist is not None:
            self._assist.bound_n = bound_n

    @abstractmethod
    def build(self, height_m: float) -> None:
        """Create an avatar of that stature; nothing is shown yet."""

    @abstractmethod
    def begin(self, position: np.ndarray, quat: np.ndarray) -> None:
        """Start a new stream with devices at ``(D, 3)``, ``(D, 4)``."""

    @abstractmethod
    def put(self, qpos: np.ndarray, qvel: np.ndarray, in_motion: bool = False) -> None:
        """Put the avatar into a pose ``(40,)`` with velocities ``(39,)``.

        Args:
            qpos, qvel: of the avatar.
            in_motion: whether they are those of ``moving_user``.
        """

    def moving_user(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Estimated pose and velocities of a user in motion, as ``put`` takes them, or None."""
        return None

    @abstractmethod
    def feed(
        self, time_s: float, position: np.ndarray, quat: np.ndarray, present: np.ndarray
    ) -> AvatarState | None:
        """Process the next moment of the devices; the new state, or None if none is due.

        Args:
            time_s: of this moment.
            position, quat: ``(D, 3)`` and ``(D, 4)`` of the devices.
            present: ``(D,)`` bool; poses of devices that do not report are estimated.
        """

    @abstractmethod
    def user_devices(self) -> tuple[np.ndarray, np.ndarray]:
        """The device poses at the time of the avatar's present state."""


class SimulatedEngine(Engine):
    """An avatar on simulated physics, driven by the torques of an agent and the assist.

    Args:
        agent: outputs torques.
        config: of the simulation.
    """

    physics = True

    def __init__(self, agent: Agent, config: EnvConfig) -> None:
        self._agent, self._config = agent, config

    def build(self, height_m: float) -> None:
        """See ``Engine``."""
        self.height_m = height_m
        self._sim = StreamSim(self._config, height_m)
        self._agent.bind(self._sim)
        self._agent.reset(1)
        self._assist = Assist(self._sim, self.assist_n)

    @property
    def objects(self) -> np.ndarray:
        """See ``Engine``."""
        return self._sim.objects.pose[0].copy()

    def put(self, qpos: np.ndarray, qvel: np.ndarray, in_motion: bool = False) -> None:
        """See ``Engine``."""
        self._sim.put(qpos, qvel)
        self._agent.reset(1)
        assert self._assist is not None
        self._assist.reset()

    def _step(self, headset: tuple[np.ndarray, np.ndarray], time_s: float) -> AvatarState:
        """One step of physics; the simulation's window is already advanced.

        Args:
            headset: ``(3,)``, ``(4,)`` world pose of the user's headset at the avatar's present.
            time_s: of the state after the step.
        """
        sim, assist = self._sim, self._assist
        assert assist is not None
        apart = float(np.linalg.norm(headset[0] - headsets(sim)[0]))
        assist.apply(headset[0][None], headset[1][None])
        sim.step(self._agent.act(sim.look()))
        return AvatarState(
            time_s=time_s,
            qpos=sim.qpos[0, :QPOS].copy(),
            contact_force=sim.contact_force[0].copy(),
            assist_force=assist.force[0].copy(),
            assist_torque=assist.torque[0].copy(),
            headset_error_m=apart if not sim.unstable[0] else np.inf,
            objects=sim.objects.pose[0].copy(),
        )


class TorqueEngine(SimulatedEngine):
    """A policy on simulated physics.

    Args:
        agent: reads devices, not the full body.
        sensors: name of the sensor set; by default the one that the agent was trained with.
        scene: the ground and objects.

    Raises:
        InputError: the agent has inputs that no device reports, or another body than the avatar.
    """

    rate_hz = FPS

    def __init__(
        self,
        agent: Agent,
        sensors: str | None = None,
        scene: Scene = PLAIN,
    ) -> None:
        needs = agent.needs
        if needs.privileged:
            raise InputError(
                f"{agent.name} reads the user's whole body, which no device reports",
                "Follower",
                f"name a kinematic system followed by {PHYSICS}",
            )
        if needs.body is not None:
            raise InputError(
                f"was trained for the body {needs.body.name!r}, and a device stream drives only "
                "the avatar",
                agent.name,
                "film it with questsim evaluate --video",
            )
        config = EnvConfig(
            sensors=sensors or needs.sensors,
            future_frames=needs.future_frames,
            body_preset=needs.body_preset,
            observe_proportions=needs.observe_proportions,
            terrain=scene.terrain,
            objects=scene.objects,
        )
        super().__init__(agent, config)
        if isinstance(agent, PolicyAgent):
            layout = Layout.of(observation_layout(self._config))
            layout.check_provides(agent.policy.layout, agent.name)
        self.names = sensor_set(self._config.sensors)
        estimator(self.names)  # loaded now, not while a user waits for the avatar
        self._window = self._config.future_frames
        self.latency_s = self._window / FPS

    def build(self, height_m: float) -> None:
        """See ``Engine``."""
        super().build(height_m)
        self._moving = MovingUser(self.names, height_m, (self._window - 1) / FPS)

    def begin(self, position: np.ndarray, quat: np.ndarray) -> None:
        """See ``Engine``."""
        self._sim.show_devices(position, quat, fill=True)
        self._moving.reset()

    def moving_user(self) -> tuple[np.ndarray, np.ndarray] | None:
        """See ``Engine``."""
        return self._moving.state()

    def user_devices(self) -> tuple[np.ndarray, np.ndarray]:
        """See ``Engine``; over level ground."""
        position, quat = self._sim.shown_devices(NOW + 1)
        position[:, 2] -= self._sim.floor[0]
        return position, quat

    def feed(
        self, time_s: float, position: np.ndarray, quat: np.ndarray, present: np.ndarray
    ) -> AvatarState | None:
        """See ``Engine``."""
        self._moving.show(position, quat)
        self._sim.show_devices(position, quat)
        position, quat = self._sim.shown_devices()
        return self._step((position[0], quat[0]), time_s - (self._window - 1) / FPS)


class PoseEngine(Engine):
    """A kinematic system whose poses are shown without physics.

    Args:
        system: reads devices at 60 Hz.
        sensors: name of the set of devices; by default the first one with which it can be used.
        terrain: the ground, None for a plane; lifts the poses.

    Raises:
        InputError: the system cannot use these devices, or they are IMUs.
    """

    rate_hz, physics = SENSOR_FPS, False

    def __init__(
        self, system: KinematicSystem, sensors: str | None = None, terrain: Terrain | None = None
    ) -> None:
        self.names = live_set(system, sensors)
        self._system = system
        self._field = None if terrain is None else height_field(terrain)
        self.latency_s = (system.future_frames + 1) / SENSOR_FPS

    def build(self, height_m: float) -> None:
        """See ``Engine``."""
        self.height_m = height_m
        self._poses = SystemPoses(self._system, self.names, height_m)

    def begin(self, position: np.ndarray, quat: np.ndarray) -> None:
        """See ``Engine``."""
        self._poses.reset()
        self._user = position, quat

    def put(self, qpos: np.ndarray, qvel: np.ndarray, in_motion: bool = False) -> None:
        """Does nothing: the next pose is the system's."""

    def user_devices(self) -> tuple[np.ndarray, np.ndarray]:
        """See ``Engine``; the newest poses, independent of the system's delay."""
        return self._user

    def feed(
        self, time_s: float, position: np.ndarray, quat: np.ndarray, present: np.ndarray
    ) -> AvatarState | None:
        """See ``Engine``."""
        self._user = position, quat
        qpos = self._poses.retargeted(self._poses.feed(position, quat, present))
        if self._field is not None:
            qpos[2] += float(self._field.ground_at(qpos[None, :3])[0])
        time_s -= self._system.future_frames / SENSOR_FPS
        return resting_state(time_s, qpos)
