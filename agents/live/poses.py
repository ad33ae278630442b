"""Kinematic systems in a live session: the avatar shows their poses, without physics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from agents.agent import Needs
from agents.kinematic.interface import KinematicSystem, Poses, UserBody
from agents.kinematic.physics_behind import on_own_body
from envs.config import EnvConfig
from envs.core import BatchSim
from envs.placement import moved, turn_quat
from questsim import rotations as rot
from questsim.errors import InputError
from questsim.joint_sensors import SENSOR_FPS, readings
from questsim.motion.clip import FPS, Clip
from questsim.motion.motion import Motion
from questsim.motion.retarget_stream import StreamRetargeter
from questsim.sensors import SENSOR_SETS

LEFT_OPEN = "H"
"""Sensors of the simulation, which are not read here; it does not display IMUs."""


class PoseDriver:
    """Shows the poses of a kinematic system.

    Args:
        system: reads the user's devices at 60 Hz.
        recording: returns the user's motion of a clip by name, the source of the device signals.
    """

    physics = False

    def __init__(self, system: KinematicSystem, recording: Callable[[str], Motion]) -> None:
        self._system, self._recording = system, recording
        self._stream: PoseStream | None = None

    @property
    def needs(self) -> Needs:
        """The set with all trackers that it can use, otherwise the first usable set."""
        usable = self.sensor_sets()
        return Needs(sensors="6T" if "6T" in usable else usable[0], future_frames=0)

    def sensor_sets(self) -> tuple[str, ...]:
        """Names of the sensor sets that it can read, IMUs included."""
        return tuple(name for name in SENSOR_SETS if self._can_use(name))

    def _can_use(self, sensors: str) -> bool:
        try:
            self._system.usable(sensors)
        except InputError:
            return False
        return True

    def config(self, sensors: str, height_m: float | None = None) -> EnvConfig:
        """The environment; its observation is not used."""
        heights = None if height_m is None else (height_m, height_m)
        return EnvConfig(sensors=LEFT_OPEN, future_frames=0, heights=heights, fixed_start=True)

    def shown(self, clip: Clip, sensors: str) -> list[Clip] | None:
        """None: the observation is not used."""
        return None

    def bind(self, sim: BatchSim, sensors: str) -> None:
        """Prepare the device signals of the clip's user, scaled to the avatar's height."""
        height, reference = float(sim.heights[0]), sim.reference
        ratio = height / float(reference.heights[0])
        user = scaled(self._recording(reference.names[0]), ratio)
        self._stream = PoseStream(self._system, user, height, sensors)

    def reset(self) -> None:
        """Reset the system; the next pose is the first of a new stream."""
        if self._stream is not None:
            self._stream.reset()

    def advance(self, sim: BatchSim) -> None:
        """Show the pose of the next frame at the clip's place on the terrain."""
        assert self._stream is not None
        start, end = int(sim.reference.start[0]), int(sim.reference.end[0])
        frame = min(int(sim.frame[0]) + 1, end - 1) - start
        sim.show(in_world(sim, self._stream.at(frame)))


class PoseStream:
    """A system's estimates from a user's devices, on the avatar at 36 Hz.

    Device frames arrive at 60 Hz, in order. The pose of a 36 Hz frame is interpolated between the
    two poses of 60 Hz around it, as retargeting does for a whole motion. A pose is therefore late
    by up to two thirds of a 60 Hz frame (11 ms) plus the system's ``future_frames``. Only the last
    two poses are stored.

    Args:
        system: the system.
        user: the user's motion, which also provides the bones.
        height_m: the avatar's stature.
        sensors: name of the set of worn devices.

    Raises:
        InputError: the system cannot use these devices.
    """

    def __init__(
        self, system: KinematicSystem, user: Motion, height_m: float, sensors: str
    ) -> None:
        self._system, self._user = system, user
        self._names = system.usable(sensors)
        self._frames = readings(user.resampled(SENSOR_FPS), self._names)
        self._retarget = StreamRetargeter(user, height_m)
        self.reset()

    def reset(self) -> None:
        """Restart at the frame requested next."""
        self._system.reset(UserBody.of(self._user), self._names)
        self._retarget.reset()
        self._frame: int | None = None
        self._before: Poses | None = None
        self._after: Poses | None = None
        self._pose = np.zeros(0)

    def at(self, frame: int) -> np.ndarray:
        """The avatar's ``qpos`` ``(40,)`` in a frame at 36 Hz; request frames in order."""
        if frame == self._frame:  # the clip has ended
            return self._pose
        place = frame * SENSOR_FPS / FPS
        whole = int(place + 1e-9)
        share = place - whole
        last = whole if share < 1e-9 else whole + 1
        if self._frame is None:
            first = int(max(frame - 1, 0) * SENSOR_FPS / FPS + 1e-9)
            self._fed, self._answered = first, first - 1
        while self._answered < last:
            self._feed()
        self._frame = frame
        self._pose = self._retarget(self._between(share if last > whole else 1.0))[0]
        return self._pose

    def _feed(self) -> None:
        """Give the system the next frame; after the end, the last frame is repeated."""
        frame = self._frames[min(self._fed, len(self._frames) - 1)]
        pose = self._system.step(replace(frame, time_s=self._fed / SENSOR_FPS))
        self._fed += 1
        late = self._fed - 1 - self._system.future_frames
        if late > self._answered:
            self._before, self._after = self._after or pose, pose
            self._answered = late

    def _between(self, share: float) -> Motion:
        """A pose on the user's bones, interpolated between the last two; 1 is the last."""
        assert self._before is not None and self._after is not None
        motion = on_own_body(Poses.joined([self._before, self._after]), self._user)
        a, b = motion.rotations
        b = b * np.where((a * b).sum(-1, keepdims=True) < 0.0, -1.0, 1.0)
        turn = (1.0 - share) * a + share * b
        root = (1.0 - share) * motion.root_position[0] + share * motion.root_position[1]
        turn /= np.linalg.norm(turn, axis=-1, keepdims=True)
        return replace(motion, root_position=root[None], rotations=turn[None])


def scaled(motion: Motion, ratio: float) -> Motion:
    """The same motion of a person scaled by ``factor``, as ``Clip.scaled`` scales clips."""
    root, offsets = ratio * motion.root_position, ratio * motion.offsets
    return replace(motion, root_position=root, offsets=offsets)


def in_world(sim: BatchSim, pose: np.ndarray) -> np.ndarray:
    """A pose ``(40,)`` over level ground, moved to the clip's place and ground, ``(1, 40)``."""
    place, field = sim.placement.place, sim.placement.field
    there = pose[None].copy()
    there[:, :3] = moved(place, there[:, :3])
    there[:, 3:7] = rot.quat_multiply(turn_quat(place), there[:, 3:7])
    if field is not None:
        there[:, 2] += field.ground_at(there[:, :3])
    return there
