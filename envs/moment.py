"""The ``Moment`` of a batch: data of its last step that reward terms read, and the terms of it."""

from __future__ import annotations

import numpy as np

from envs.kernel_arguments import Episodes, ReferenceRows, State, Target
from envs.placement import turn_quat, turned
from questsim import rotations as rot
from questsim.reward import COMPILED, Moment, ReferenceState, RewardConfig, extra_terms


def moment_of(
    state: State,
    episodes: Episodes,
    rows: ReferenceRows,
    target: Target,
    *,
    torque: np.ndarray,
    torque_limits: np.ndarray,
    previous_force: np.ndarray,
) -> Moment:
    """Collect the data of the last step of ``n`` simulations, in the world.

    Args:
        state, episodes, rows, target: as of ``score_kernel.score``.
        torque, torque_limits: ``(n, 33)`` N m.
        previous_force: ``(n, 2)`` vertical force on the feet one step earlier, N.
    """
    dofs, links = target.angles.shape[2], slice(1, 1 + target.position.shape[2])
    now, scale, place = episodes.frame, episodes.ratio[:, None, None], episodes.place
    position, cvel = state.xpos[:, links], state.cvel[:, links]
    arm = position - state.com[:, 1:2]
    velocity = turned(place, rows.velocity[now] * scale)
    velocity[..., 2] += target.rise[:, 0]
    return Moment(
        joint_angles=state.qpos[:, 7 : 7 + dofs],
        joint_velocities=state.qvel[:, 6 : 6 + dofs],
        link_positions=position,
        link_velocities=cvel[..., 3:] + np.cross(cvel[..., :3], arm),
        link_quats=state.xquat[:, links],
        foot_force=state.foot_force[..., 2],
        previous_foot_force=previous_force,
        torque=torque,
        torque_limits=torque_limits,
        reference=ReferenceState(
            joint_angles=target.angles[:, 0],
            joint_velocities=rows.qvel[now, 6:],
            link_positions=target.position[:, 0],
            link_velocities=velocity,
            link_quats=rot.quat_multiply(turn_quat(place)[:, None], target.quat[:, 0]),
        ),
    )


def finite_extra_terms(reward: RewardConfig, moment: Moment, there: np.ndarray) -> np.ndarray:
    """Values ``(n, k)`` of the reward terms that are not compiled.

    Args:
        reward: names and weights.
        moment: of the last step.
        there: ``(n,)`` bool: the physics did not fail. Elsewhere a term may have any value.

    Raises:
        ValueError: a term is not finite.
    """
    extra = extra_terms(reward, moment)
    wrong = ~np.isfinite(extra) & there[:, None]
    if wrong.any():
        name = reward.terms[len(COMPILED) + int(np.flatnonzero(wrong.any(axis=0))[0])]
        raise ValueError(f"reward term {name!r} is not finite")
    return extra
