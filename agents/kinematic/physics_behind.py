"""Physics behind a kinematic system: the avatar follows its poses by a tracker's torques.

The poses are retargeted to the avatar of the user's stature and are what the shipped
``estimate-tracker`` is shown as the reference; it has learnt to do what the user does all the same
(``train.py --estimates``). The avatar begins in the user's first state, as in every episode, and
what it does is compared with what the user did. The tracker reads five frames ahead, and
velocities there take one more: the avatar shows the pose of ``LATENCY_FRAMES`` ago, as QuestSim
does that reads as many frames of the devices. Nothing later than that is used but two constants of
each clip, the heights of the floor and of the ankle, which a calibration would tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from agents.evaluation.assisted import AssistUse
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

LATENCY_FRAMES = 6
BEGINNING_FRAMES = 6
"""From the user's first state to the estimates: as far as the tracker looks ahead, 167 ms.

With it 48 clips of HMD-Poser are followed with an MPJPE of 3.18 instead of 3.32 cm.
"""
_FEWEST = 4
"""Frames that jitter and accelerations take."""


def on_own_body(poses: Poses, motion: Motion) -> Motion:
    """Estimated poses on the user's measured bones, the head where the system has it.

    Args:
        poses: of all frames of ``motion``, perhaps of an estimated body.
        motion: says whose bones, and what the poses are called.
    """
    there, _ = poses.forward_kinematics()
    origin = np.zeros_like(poses.root_position)
    turned = replace(motion, root_position=origin, rotations=poses.rotations)
    head = turned.forward_kinematics()[0][:, HEAD]
    return replace(turned, root_position=there[:, HEAD] - head)


def reference_of(poses: Poses, motion: Motion) -> Clip:
    """What the tracker is asked to follow: the poses on the avatar, at its frame rate.

    Raises:
        InputError: the stature is outside the range of bodies.
    """
    return to_clip(on_own_body(poses, motion))


def follow_poses(
    references: Sequence[Clip],
    motions: Sequence[Motion],
    threads: int = 1,
    assist: AssistUse | None = None,
) -> list[Rollout]:
    """Let the avatar follow what a system made of motions, and hold it against those.

    Args:
        references: one ``reference_of`` a motion.
        motions: what the users did.
        threads: of the physics.
        assist: may help the avatar; None for honest physics.
    """
    tracker, truths = load_agent(TRACKER), [to_clip(motion) for motion in motions]
    shown = [begun_as(clip, truth) for clip, truth in zip(references, truths, strict=True)]
    return roll_out(tracker, truths, env_config(tracker), threads, shown=shown, assist=assist)


def begun_as(estimate: Clip, truth: Clip) -> Clip:
    """An estimate that begins in the user's own state, as an episode does for every agent.

    What a system makes of its first frames, without a past, is off and moves fast towards what it
    makes of the next ones, which leads the avatar astray. So what is shown goes over, within
    ``BEGINNING_FRAMES``, from the user's first pose, carried on at its velocity, to the estimate.
    Of the user nothing but that first state is used.

    Args:
        estimate: to be followed.
        truth: what the user did.
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
    about = {"kind": estimate.kind, "style": estimate.style}
    return clip_from_qpos(estimate.name, qpos, estimate.height_m, **about)


def performed(rollout: Rollout) -> Clip:
    """What the avatar did, until it was lost."""
    return clip_from_qpos(rollout.name, rollout.qpos[: rollout.scored_frames], rollout.height_m)


def avatar_samples(clip: Clip, truth: Clip, ends: Sequence[int] = ENDS) -> dict[str, np.ndarray]:
    """``pose_samples`` of two clips of the avatar on its 22 joints, and the force on the root.

    Args:
        clip: what is measured.
        truth: what the user did, at least as long.
        ends: as ``pose_samples`` has them.
    """
    if len(clip) < _FEWEST:
        return {}
    got, want = to_motion(clip), to_motion(truth)
    there = want.forward_kinematics()[0][: len(clip)]
    rotations = want.rotations[: len(clip)]
    samples = pose_samples(got.forward_kinematics()[0], got.rotations, there, rotations, FPS, ends)
    return samples | {"root_force_bw": root_force(clip)}


def rollout_samples(rollout: Rollout, ends: Sequence[int] = ENDS) -> dict[str, np.ndarray]:
    """``avatar_samples`` of a rollout until it was lost, and whether it never was, in percent."""
    success = {"success_percent": np.array([100.0 * rollout.completed])}
    return avatar_samples(performed(rollout), rollout.reference, ends) | success
