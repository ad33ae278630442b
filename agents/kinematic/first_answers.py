"""Initial states from a kinematic system: its first estimates of a user's motion.

The whole-body state of a live user is unknown. A system such as HMD-Poser estimates it from the
devices alone; ``BatchSim(begin_at=...)`` begins episodes there. The very first estimate knows
nothing of the past; after ``SETTLED_FRAMES`` it is better by a third, and velocities are known.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import floor

from agents.kinematic.interface import UserBody
from agents.kinematic.physics_behind import on_own_body
from agents.kinematic.store import load_system
from agents.resolve import DEFAULT_SYSTEM
from questsim.joint_sensors import SENSOR_FPS, readings
from questsim.motion.clip import FPS, Clip
from questsim.motion.retarget import to_clip
from questsim.motion.retarget_back import to_motion
from questsim.sensors import sensor_set

SETTLED_FRAMES = 7
"""Frames at 36 Hz, 0.2 s, after which an avatar begins in an estimate that has settled."""
_LEAST_FRAMES = 8
"""Frames that are left of a clip then; a shorter one begins earlier."""
_FRAMES = 8
"""Frames at 60 Hz that a system estimates for its first estimate; velocities need a few."""
_SETTLED = 3
"""Frame at 36 Hz whose velocity the first one gets. Before, a recurrent system begins to move: the
velocities of walks are off by 1.0 m/s in the first frame and 0.4 m/s in this one, of 1.1 m/s."""


def first_answers(clips: Sequence[Clip], system: str = DEFAULT_SYSTEM) -> dict[str, Clip]:
    """Estimates of the first frames of each clip, by name.

    Args:
        clips: the users' motions.
        system: name of a kinematic system that uses headset and controllers.
    """
    found = {}
    for estimate in _estimates(clips, [_FRAMES] * len(clips), system):
        velocity = estimate.qvel.copy()
        velocity[0] = velocity[min(_SETTLED, len(velocity) - 1)]
        found[estimate.name] = replace(estimate, qvel=velocity)
    return found


def settled_answers(
    clips: Sequence[Clip], system: str = DEFAULT_SYSTEM
) -> tuple[list[Clip], dict[str, Clip]]:
    """The clips from the moment at which avatars begin, and the estimates of that moment by name.

    Args:
        clips, system: as of ``first_answers``. The estimates use no later frame.
    """
    skipped = [settled_after(clip) for clip in clips]
    frames = [floor(count / FPS * SENSOR_FPS + 1e-6) + 2 for count in skipped]
    found = {
        estimate.name: estimate.first(count + 1).after(count)
        for estimate, count in zip(_estimates(clips, frames, system), skipped, strict=True)
    }
    return [clip.after(count) for clip, count in zip(clips, skipped, strict=True)], found


def settled_after(clip: Clip) -> int:
    """Frames of a clip before its avatar begins."""
    return max(0, min(SETTLED_FRAMES, len(clip) - _LEAST_FRAMES))


def begun(clip: Clip, start: str) -> Clip:
    """The clip from the moment at which the avatar begins; ``start`` as of ``--begin``."""
    return clip.after(settled_after(clip)) if start == "estimate" else clip


def begun_in_estimates(
    clips: Sequence[Clip], start: str
) -> tuple[list[Clip], dict[str, Clip] | None]:
    """The clips from then on, and HMD-Poser's estimates in which avatars begin, if they do."""
    if start == "estimate":
        return settled_answers(clips)
    return list(clips), first_answers(clips) if start == "first-estimate" else None


def _estimates(clips: Sequence[Clip], frames: Sequence[int], system: str) -> Iterator[Clip]:
    """Estimates of the first ``frames`` at 60 Hz of each clip, at 36 Hz and of its stature."""
    poser, devices = load_system(system), sensor_set("H+2C")
    for clip, count in zip(clips, frames, strict=True):
        motion = to_motion(clip).resampled(SENSOR_FPS)
        first = replace(
            motion, root_position=motion.root_position[:count], rotations=motion.rotations[:count]
        )
        poses = poser.predict(readings(first, devices), UserBody.of(first))
        estimate = to_clip(on_own_body(poses, first))
        yield replace(estimate.scaled(clip.height_m), name=clip.name)
