"""Estimates of a kinematic system on the avatar, without physics."""

from __future__ import annotations

from agents.kinematic.interface import Poses
from agents.kinematic.physics_behind import on_own_body
from questsim.metrics import Rollout
from questsim.motion.checks import stature
from questsim.motion.clip import FPS, Clip
from questsim.motion.footing import measure_footing
from questsim.motion.kinematics import sole_positions
from questsim.motion.motion import Motion
from questsim.motion.retarget import to_clip
from questsim.skeleton import FOOT_LINKS


def over_users_floor(poses: Poses, motion: Motion) -> Clip:
    """Poses on the avatar above the floor of the user's motion.

    Retargeting would put the floor at the estimate's own soles and hide that it floats.
    """
    estimate = on_own_body(poses, motion)
    return to_clip(estimate, measure_footing(motion, round(stature(estimate), 3)))


def pose_rollout(poses: Poses, motion: Motion, seconds: float = 0.0) -> Rollout:
    """Estimated poses on the avatar as a rollout, without contact forces and falls.

    Args:
        poses: one per frame of ``motion``.
        motion: the user's motion.
        seconds: computing time of the estimate.
    """
    truth, clip = to_clip(motion), over_users_floor(poses, motion)
    frames = min(len(truth), len(clip))
    feet = list(FOOT_LINKS)
    soles = sole_positions(clip.link_position[:, feet], clip.link_quat[:, feet], clip.height_m)
    return Rollout(
        name=truth.name,
        kind=truth.kind,
        style=truth.style,
        height_m=clip.height_m,
        fps=FPS,
        reference=truth,
        link_position=clip.link_position[:frames],
        link_quat=clip.link_quat[:frames],
        joint_angles=clip.qpos[:frames, 7:],
        foot_clearance=soles[:frames, ..., 2].min(axis=-1),
        contact_force=None,
        fell=False,
        seconds_simulated=frames / FPS,
        seconds_wall=seconds,
    )
