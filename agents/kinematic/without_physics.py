"""What a kinematic system estimates, on the avatar and without physics."""

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
    """Poses on the avatar over the floor that the user stands on, which the user's motion tells.

    Retargeting puts the floor where a motion's soles are, so an estimate that floats would stand.
    """
    estimate = on_own_body(poses, motion)
    return to_clip(estimate, measure_footing(motion, round(stature(estimate), 3)))


def pose_rollout(poses: Poses, motion: Motion, seconds: float = 0.0) -> Rollout:
    """Estimated poses on the avatar as a rollout: nothing bears, and nothing falls.

    Args:
        poses: of all frames of ``motion``.
        motion: what the user did.
        seconds: that the estimate took.
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
