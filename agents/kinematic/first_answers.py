"""Initial states from a kinematic system: its first estimates of a user's motion.

The whole-body state of a live user is unknown. A system such as HMD-Poser estimates it from the
devices alone; ``BatchSim(begin_at=...)`` begins episodes there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from agents.kinematic.interface import UserBody
from agents.kinematic.physics_behind import on_own_body
from agents.kinematic.store import load_system
from agents.resolve import DEFAULT_SYSTEM
from questsim.joint_sensors import SENSOR_FPS, readings
from questsim.motion.clip import Clip
from questsim.motion.motion import Motion
from questsim.motion.retarget import to_clip
from questsim.motion.retarget_back import to_motion
from questsim.sensors import sensor_set

_FRAMES = 8
"""Frames at 60 Hz that a system estimates; velocities need a few."""
_SETTLED = 3
"""Frame at 36 Hz whose velocity the first one gets. Before, a recurrent system begins to move: the
velocities of walks are off by 1.0 m/s in the first frame and 0.4 m/s in this one, of 1.1 m/s."""


def first_answers(clips: Sequence[Clip], system: str = DEFAULT_SYSTEM) -> dict[str, Clip]:
    """Estimates of the first frames of each clip, by name.

    Args:
        clips: the users' motions.
        system: name of a kinematic system that uses headset and controllers.
    """
    poser, devices = load_system(system), sensor_set("H+2C")
    found = {}
    for clip in clips:
        motion = to_motion(clip).resampled(SENSOR_FPS)
        first = _first(motion)
        poses = poser.predict(readings(first, devices), UserBody.of(first))
        estimate = to_clip(on_own_body(poses, first))
        estimate = estimate.scaled(clip.height_m)
        velocity = estimate.qvel.copy()
        velocity[0] = velocity[min(_SETTLED, len(velocity) - 1)]
        found[clip.name] = replace(estimate, name=clip.name, qvel=velocity)
    return found


def _first(motion: Motion) -> Motion:
    """The first frames of a motion."""
    return replace(
        motion,
        root_position=motion.root_position[:_FRAMES],
        rotations=motion.rotations[:_FRAMES],
    )
