"""Physics behind a kinematic system, from the data that a live user would have.

The avatar has the body that was measured or that the system estimates, not the user's true bones.
Retargeting uses no later frame. The avatar starts in the system's own estimate, after 0.2 s or in
the first one, in the user's true state, or standing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from agents.comparison.conditions import Start, starts_of
from agents.evaluation.rollout import env_config, roll_out
from agents.kinematic.causal import causal_clip
from agents.kinematic.first_answers import begun, settled_after
from agents.kinematic.interface import Poses
from agents.kinematic.physics_behind import TRACKER, begun_as, on_own_body
from agents.loading import load_agent
from questsim.joint_sensors import SENSOR_FPS
from questsim.metrics import Rollout
from questsim.motion.checks import stature_of
from questsim.motion.clip import Clip
from questsim.motion.kinematics import clip_from_qpos
from questsim.motion.motion import Motion
from questsim.motion.retarget import to_clip

CALIBRATED_S = 1.0
"""Seconds after which an estimated body is taken as the avatar's."""
STATURE_STEP_M = 0.01
"""Statures of avatars of estimated bodies are whole centimetres."""


@dataclass(frozen=True)
class Shown:
    """The clip that a tracker observes and the clip that it is scored against.

    Attributes:
        clip: the system's estimate on the avatar of the body that it knows.
        truth: the user's motion on the same avatar.
    """

    clip: Clip
    truth: Clip


def shown_of(poses: Poses, motion: Motion) -> Shown:
    """A system's poses on the avatar of the body that the system knows.

    Raises:
        InputError: that body's stature is outside the range of avatars.
    """
    body = replace(motion, offsets=body_of(poses, motion))
    there = np.broadcast_to(motion.offsets, (len(motion), *motion.offsets.shape))
    true = Poses(motion.root_position, motion.rotations, there)
    truth = to_clip(on_own_body(true, body))
    return Shown(causal_clip(on_own_body(poses, body)), truth)


def body_of(poses: Poses, motion: Motion) -> np.ndarray:
    """Offsets ``(22, 3)``: measured ones as they are, estimated ones of ``CALIBRATED_S``."""
    if np.allclose(poses.offsets[-1], motion.offsets, atol=1e-6):
        return motion.offsets
    offsets = poses.offsets[min(round(CALIBRATED_S * SENSOR_FPS), len(poses)) - 1]
    tall = stature_of(offsets)
    return offsets * (round(tall / STATURE_STEP_M) * STATURE_STEP_M / tall)


def follow_shown(shown: Sequence[Shown], start: Start, threads: int = 1) -> list[Rollout]:
    """Let the avatar follow estimates from one kind of start.

    Args:
        shown: the estimates.
        start: see ``conditions.Start``. From the user's state or the first estimate, the shown
            motion blends from it to the estimates (``begun_as``); otherwise it is the estimates.
        threads: physics threads.

    Returns:
        One rollout per estimate, from the moment at which the avatar begins.
    """
    tracker, truths = load_agent(TRACKER), [begun(each.truth, start) for each in shown]
    clips = [begun(each.clip, start) for each in shown]
    begin_at = None
    if start == "user":
        clips = [begun_as(clip, truth) for clip, truth in zip(clips, truths, strict=True)]
    if start == "first-estimate":
        begin_at = {clip.name: clip for clip in clips}
        clips = [begun_as(clip, clip) for clip in clips]
    if start == "estimate":
        begin_at = {each.clip.name: _so_far(each.clip) for each in shown}
    config = replace(env_config(tracker), starts=starts_of(start))
    return roll_out(tracker, truths, config, threads, shown=clips, begin_at=begin_at)


def _so_far(clip: Clip) -> Clip:
    """The state at which the avatar begins; its velocity needs no later frame."""
    count = settled_after(clip)
    seen = clip_from_qpos(clip.name, clip.qpos[: count + 1], clip.height_m)
    return seen.after(count)
