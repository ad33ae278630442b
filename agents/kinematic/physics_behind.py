"""Kinematic system with physics: a tracker's torques make the avatar follow its poses.

The poses are retargeted to the avatar of the user's stature. The policy ``ESTIMATE_TRACKER``
observes them as its reference; it was trained to follow the true motion in spite of estimation
errors (``train.py --estimates``). The avatar starts in the user's first state, as in every episode,
and its motion is compared with the user's. The tracker reads five frames ahead and velocities need
one more, so the avatar shows the pose of six frames ago, like QuestSim with as many future
frames. No later data is used except two constants of each clip, the heights of the floor and of the
ankle, which a calibration would measure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from agents.evaluation.assisted import AssistUse
from agents.evaluation.mapping import Mapper
from agents.evaluation.rollout import env_config, roll_out
from agents.kinematic.interface import Poses
from agents.loading import load_agent
from agents.resolve import ESTIMATE_TRACKER as TRACKER
from questsim.body import build_body
from questsim.metrics import Rollout
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import clip_from_qpos
from questsim.motion.motion import Motion
from questsim.motion.retarget import to_clip
from questsim.motion.retarget_back import to_motion
from questsim.pose_metrics import ENDS, HEAD, pose_samples
from questsim.root_force import root_force

BEGINNING_FRAMES = 6
"""Length of the blend from the user's first state to the estimates: the tracker's future window,
167 ms. On 48 clips of HMD-Poser it lowers the MPJPE from 3.32 to 3.18 cm."""
_FEWEST = 4
"""Number of frames needed to compute jitter and accelerations."""


def on_own_body(poses: Poses, motion: Motion) -> Motion:
    """Estimated poses on the user's measured bones, with the head at its estimated position.

    Args:
        poses: one per frame of ``motion``; their body may be estimated.
        motion: provides the bones and the name.
    """
    there, _ = poses.forward_kinematics()
    origin = np.zeros_like(poses.root_position)
    turned = replace(motion, root_position=origin, rotations=poses.rotations)
    head = turned.forward_kinematics()[0][:, HEAD]
    return replace(turned, root_position=there[:, HEAD] - head)


def reference_of(poses: Poses, motion: Motion) -> Clip:
    """The tracker's reference: the poses on the avatar, at its frame rate.

    Raises:
        InputError: the stature is outside the range of bodies.
    """
    return to_clip(on_own_body(poses, motion))


def follow_poses(
    references: Sequence[Clip],
    motions: Sequence[Motion],
    threads: int = 1,
    assist: AssistUse | None = None,
    mapper: Mapper = map,
) -> list[Rollout]:
    """Let the avatar follow a system's estimates, and compare its motion with the true motions.

    Args:
        references: one result of ``reference_of`` per motion.
        motions: the users' true motions.
        threads: physics threads.
        assist: applies an assisting force; None for physics without one.
        mapper: runs the batches, see ``roll_out``.
    """
    tracker, truths = load_agent(TRACKER), [to_clip(motion) for motion in motions]
    shown = [begun_as(clip, truth) for clip, truth in zip(references, truths, strict=True)]
    config = env_config(tracker)
    return roll_out(tracker, truths, config, threads, shown=shown, assist=assist, mapper=mapper)


def begun_as(estimate: Clip, truth: Clip) -> Clip:
    """An estimate that starts in the first state of another clip, in which the avatar starts.

    A system's first estimates, made without past frames, are inaccurate and change quickly, which
    misleads the tracker. Over ``BEGINNING_FRAMES`` the result therefore blends from that state's
    pose, extrapolated at its velocity, to the estimate. Only the first state is used.

    Args:
        estimate: the estimate to follow.
        truth: the user's motion; the estimate itself if the avatar starts in its first state.
    """
    count = min(BEGINNING_FRAMES, len(estimate))
    model = build_body(estimate.height_m).model
    qpos = estimate.qpos.copy()
    for frame in range(count):
        carried = truth.qpos[0].copy()
        mujoco.mj_integratePos(model, carried, truth.qvel[0], frame / FPS)
        share = frame / BEGINNING_FRAMES
        if carried[3:7] @ qpos[frame, 3:7] < 0:
            carried[3:7] *= -1.0
        qpos[frame] = (1 - share) * carried + share * qpos[frame]
        qpos[frame, 3:7] /= np.linalg.norm(qpos[frame, 3:7])
    return clip_from_qpos(
        estimate.name, qpos, estimate.height_m, kind=estimate.kind, style=estimate.style
    )


def until_lost(rollout: Rollout) -> Clip:
    """The avatar's motion until it was lost."""
    return clip_from_qpos(rollout.name, rollout.qpos[: rollout.scored_frames], rollout.height_m)


def avatar_samples(clip: Clip, truth: Clip, ends: Sequence[int] = ENDS) -> dict[str, np.ndarray]:
    """``pose_samples`` of two clips of the avatar on its 22 joints, and the force on the root.

    Args:
        clip: the motion to score.
        truth: the user's motion, at least as long.
        ends: see ``pose_samples``.
    """
    if len(clip) < _FEWEST:
        return {}
    got, want = to_motion(clip), to_motion(truth)
    there = want.forward_kinematics()[0][: len(clip)]
    rotations = want.rotations[: len(clip)]
    samples = pose_samples(got.forward_kinematics()[0], got.rotations, there, rotations, FPS, ends)
    return samples | {"root_force_bw": root_force(clip)}


def rollout_samples(rollout: Rollout, ends: Sequence[int] = ENDS) -> dict[str, np.ndarray]:
    """``avatar_samples`` of a rollout until it was lost, and its success in percent."""
    success = {"success_percent": np.array([100.0 * rollout.completed])}
    return avatar_samples(until_lost(rollout), rollout.reference, ends) | success
