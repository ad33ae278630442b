"""``Follower``: converts a user's device poses to avatar poses, frame by frame."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from pathlib import Path

import mujoco
import numpy as np

from agents.agent import Agent
from agents.follower.bridge import Bridge, DeviceMoment
from agents.follower.calibration import Calibration, calibrate
from agents.follower.engines import Engine, PoseEngine, TorqueEngine
from agents.follower.physics_engine import PhysicsEngine
from agents.follower.scene import PLAIN, Scene
from agents.follower.stance import estimated_pose
from agents.follower.states import AvatarState, between_states, resting_state
from agents.kinematic.interface import KinematicSystem
from agents.kinematic.store import load_system
from agents.loading import load_agent
from agents.resolve import DEFAULT_POLICY, ESTIMATE_TRACKER, resolve
from envs.objects import WorldObject
from envs.terrain import Terrain
from questsim import rotations as rot
from questsim.avatar_pose import AvatarPose
from questsim.body import build_body
from questsim.devices import DeviceFrame
from questsim.errors import InputError
from questsim.motion.clip import FPS
from questsim.motion.kinematics import standing_clip
from questsim.skeleton import NUM_DOFS, NUM_LINKS

LOST_M, LOST_S = 0.6, 0.3
"""An avatar whose head is this far from its user's for this long has fallen and is set up again."""
_KEPT = 32
"""Number of states to interpolate between: half a second at 60 Hz."""


class Follower:
    """An avatar that follows a stream of devices, in constant time and memory a frame.

    Torque policies and kinematic systems with or without physics are used in the same way. Call
    ``calibrate`` once (or give a stature), then ``step`` with every frame.

    Args:
        agent: any name or folder that ``agents.resolve`` accepts, or a loaded agent.
        sensors: name of the sensor set; by default the agent's own.
        height_m: the user's stature, if known.
        assist_n: largest external assisting force in N, see ``envs.assist``; 0 for none.
        terrain: the ground under the avatar; None for a plane.
        objects: on the ground before the avatar, for agents with physics.

    Attributes:
        calibration: the user's calibration; None before calibration.
        names: the devices that are read.
        scene: ground and objects.
        physics: whether the avatar is simulated: it can fall, be assisted and touch objects.
        latency_s: delay of a pose behind the newest frame: the agent's window of future frames
            plus the delay of interpolation.

    Raises:
        InputError: no such agent, or it cannot be used with these devices.
    """

    def __init__(
        self,
        agent: str | Path | Agent | KinematicSystem = DEFAULT_POLICY,
        sensors: str | None = None,
        *,
        height_m: float | None = None,
        assist_n: float = 0.0,
        terrain: Terrain | None = None,
        objects: Sequence[WorldObject] = (),
    ) -> None:
        self.scene = Scene(terrain, tuple(objects))
        self._engine = engine_of(agent, sensors, self.scene)
        self._engine.set_assist(assist_n)
        self._carry = terrain is None
        self.names, self.latency_s = self._engine.names, self._engine.latency_s
        self.physics = self._engine.physics
        self.calibration: Calibration | None = None
        if height_m is not None:
            self.use(Calibration(height_m))

    @property
    def assist_n(self) -> float:
        """Bound of the assisting force in N; can be set at any time."""
        return self._engine.assist_n

    @assist_n.setter
    def assist_n(self, bound_n: float) -> None:
        self._engine.set_assist(bound_n)

    def calibrate(
        self,
        frames: Iterable[DeviceFrame],
        *,
        height_m: float | None = None,
        floor_m: float | None = None,
        pose: str = "hanging",
        palms: Iterable[DeviceFrame] = (),
    ) -> Calibration:
        """Calibrate on a user who stands still and upright for about three seconds.

        See ``calibration.calibrate`` for the arguments and errors. The next ``step`` sets the
        avatar up again.
        """
        calibration = calibrate(frames, height_m=height_m, floor_m=floor_m, pose=pose, palms=palms)
        self.use(calibration)
        return calibration

    def use(self, calibration: Calibration) -> None:
        """Use an existing calibration; the avatar is set up again."""
        height = round(calibration.height_m, 4)
        self._engine.build(height)
        self._model = build_body(height).model
        self._data = mujoco.MjData(self._model)
        self.calibration = calibration
        self.reset()

    def reset(self) -> None:
        """Reset; the next frame is the first of a new stream."""
        assert self.calibration is not None
        engine = self._engine
        self._bridge = Bridge(engine.names, engine.rate_hz, engine.height_m, self._carry)
        self._states: deque[AvatarState] = deque(maxlen=_KEPT)
        self._events: list[str] = []
        self._lost_s = 0.0

    def step(self, frame: DeviceFrame) -> AvatarPose:
        """Process one frame of the devices.

        Frames may arrive at any rate from 36 Hz, irregularly, late, twice or not at all, and
        devices may be missing; see ``agents.follower.bridge``. The avatar starts at the user's
        place; before the headset reports, it stands at the origin.

        Args:
            frame: in this project's axes, see ``DeviceFrame.of``.

        Returns:
            The avatar ``latency_s`` before the frame, interpolated to exactly that time.

        Raises:
            InputError: the user's stature is not known yet.
        """
        if self.calibration is None:
            raise InputError(
                "the user's stature is not known", "Follower", "calibrate, or give height_m"
            )
        for moment in self._bridge.push(self.calibration.apply(frame)):
            self._advance(moment)
        return self._pose_at(frame.time_s - self.latency_s)

    def _advance(self, moment: DeviceMoment) -> None:
        engine = self._engine
        if moment.fresh:
            engine.begin(moment.position, moment.quat)
            self._set_up(moment.time_s - self.latency_s, np.zeros(3))
            return
        state = engine.feed(moment.time_s, moment.position, moment.quat, moment.present)
        if state is None:
            return
        if engine.physics and state.headset_error_m > LOST_M:
            self._lost_s += 1.0 / FPS
            if self._lost_s > LOST_S or not np.isfinite(state.headset_error_m):
                self._events.append("the avatar fell: set up again")
                self._set_up(state.time_s, self._bridge.velocity)
                return
        else:
            self._lost_s = 0.0
        if np.isfinite(state.qpos).all():
            self._states.append(state)

    def _set_up(self, time_s: float, velocity: np.ndarray) -> None:
        """Place the avatar at the user's estimated pose; never interpolate with earlier states.

        Args:
            time_s: of the state.
            velocity: ``(3,)`` of the whole body, unless the user's motion can be estimated.
        """
        engine = self._engine
        moving = engine.moving_user()
        if moving is not None:
            qpos, qvel = moving
        else:
            qpos = estimated_pose(engine.names, *engine.user_devices(), engine.height_m)
            qvel = np.concatenate([velocity, np.zeros(3 + NUM_DOFS)])
        engine.put(qpos, qvel, in_motion=moving is not None)
        self._states.clear()
        self._states.append(resting_state(time_s, qpos, engine.objects))
        self._lost_s = 0.0

    def _pose_at(self, time_s: float) -> AvatarPose:
        """The pose at a time, or at the nearest available state."""
        events = (*self._bridge.events, *self._events)
        self._bridge.events.clear()
        self._events.clear()
        if not self._states:
            qpos = standing_clip(self._engine.height_m).qpos[0]
            return self._posed(resting_state(time_s, qpos), events)
        after = next((i for i, s in enumerate(self._states) if s.time_s >= time_s), None)
        if after is None or after == 0:
            return self._posed(self._states[-1 if after is None else 0], events)
        return self._posed(
            between_states(self._states[after - 1], self._states[after], time_s), events
        )

    def _posed(self, state: AvatarState, events: tuple[str, ...]) -> AvatarPose:
        """A state in the space of the devices; links by forward kinematics."""
        assert self.calibration is not None
        qpos, alignment = state.qpos.copy(), self._bridge.alignment
        qpos[:3], qpos[3:7] = alignment.undo(qpos[:3], qpos[3:7])
        qpos[2] += self.calibration.floor_m
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        back = rot.yaw_quat(np.array(-alignment.yaw))
        floor = np.array([0.0, 0.0, self.calibration.floor_m])
        object_position, object_quat = alignment.undo(state.objects[:, :3], state.objects[:, 3:])
        return AvatarPose(
            time_s=state.time_s,
            height_m=self._engine.height_m,
            root_position=qpos[:3],
            root_quat=qpos[3:7],
            joint_angles=qpos[7:],
            link_position=self._data.xpos[1 : NUM_LINKS + 1].copy(),
            link_quat=self._data.xquat[1 : NUM_LINKS + 1].copy(),
            contact_force=rot.quat_rotate(back, state.contact_force),
            assist_force=rot.quat_rotate(back, state.assist_force),
            assist_torque=rot.quat_rotate(back, state.assist_torque),
            events=events,
            object_position=object_position + floor,
            object_quat=object_quat,
        )


def engine_of(
    agent: str | Path | Agent | KinematicSystem,
    sensors: str | None,
    scene: Scene = PLAIN,
) -> Engine:
    """The engine of an agent; a name is loaded first.

    Raises:
        InputError: see ``Follower``.
    """
    if isinstance(agent, KinematicSystem):
        system, physics = agent, False
    elif not isinstance(agent, str | Path):
        return TorqueEngine(agent, sensors, scene)
    else:
        found = resolve(agent)
        if found.torques:
            return TorqueEngine(load_agent(found), sensors, scene)
        physics = found.kind == "physics"
        system = load_system(found.base if physics else found)
    if physics and scene.terrain is not None:
        raise InputError(f"{agent} only supports level ground", "terrain", "leave it out")
    if physics:
        return PhysicsEngine(system, load_agent(ESTIMATE_TRACKER), sensors, scene.objects)
    if scene.objects:
        raise InputError(
            "an agent without physics cannot touch objects", "objects", "leave them out"
        )
    return PoseEngine(system, sensors, scene.terrain)
