"""Reward and error of every simulation, compiled.

Plain loops over simulations and links, compiled by Numba, like ``observation_kernel``.
``questsim.reward`` has the same terms as readable array functions; the tests compare the two.
"""

from __future__ import annotations

import math

import numpy as np

from envs.kernel_arguments import Episodes, ReferenceRows, Scores, State, Target
from envs.lookups import turned, unplaced
from questsim.compiled import jit


@jit
def _joint_errors(i, state, episodes, reference, target):
    """Sums over joints of squared differences of angles in rad, and of velocities in rad/s."""
    row = episodes.frame[i]
    angles = 0.0
    velocities = 0.0
    for j in range(target.angles.shape[2]):
        difference = state.qpos[i, 7 + j] - target.angles[i, 0, j]
        angles += difference * difference
        difference = state.qvel[i, 6 + j] - reference.qvel[row, 6 + j]
        velocities += difference * difference
    return angles, velocities


@jit
def _link_errors(i, state, episodes, reference, target):
    """Sums over links: squared distance (m), squared velocity (m/s), distance, squared angle."""
    xpos, xquat, cvel, com = state.xpos, state.xquat, state.cvel, state.com
    place, velocity = episodes.place, reference.velocity
    row, scale = episodes.frame[i], episodes.ratio[i]
    squared = 0.0
    speed = 0.0
    distance = 0.0
    turn = 0.0
    for b in range(velocity.shape[1]):
        quat = unplaced(place[i], xquat[i, b + 1])
        dot = 0.0
        for k in range(4):
            dot += quat[k] * target.quat[i, 0, b, k]
        angle = 2.0 * math.acos(min(abs(dot), 1.0))
        turn += angle * angle
        x, y, z = xpos[i, b + 1, 0], xpos[i, b + 1, 1], xpos[i, b + 1, 2]
        wanted = target.position[i, 0, b]
        dx, dy, dz = x - wanted[0], y - wanted[1], z - wanted[2]
        square = dx * dx + dy * dy + dz * dz
        squared += square
        distance += math.sqrt(square)
        wx, wy, wz = cvel[i, b + 1, 0], cvel[i, b + 1, 1], cvel[i, b + 1, 2]
        rx, ry, rz = x - com[i, 1, 0], y - com[i, 1, 1], z - com[i, 1, 2]
        ref_x, ref_y = turned(
            place[i],
            velocity[row, b, 0] * scale,
            velocity[row, b, 1] * scale,
        )
        dx = cvel[i, b + 1, 3] + wy * rz - wz * ry - ref_x
        dy = cvel[i, b + 1, 4] + wz * rx - wx * rz - ref_y
        dz = cvel[i, b + 1, 5] + wx * ry - wy * rx
        dz -= velocity[row, b, 2] * scale + target.rise[i, 0, b]
        speed += dx * dx + dy * dy + dz * dz
    return squared, speed, distance, turn


@jit
def score(
    first: int,
    last: int,
    state: State,
    previous_force: np.ndarray,
    episodes: Episodes,
    reference: ReferenceRows,
    target: Target,
    kernels: np.ndarray,
    weights: np.ndarray,
    scores: Scores,
) -> None:
    """Fill ``scores`` of simulations ``first`` to ``last``.

    Args:
        first, last, state, reference: as of ``observation_kernel.observe``.
        previous_force: ``(n, 2)`` vertical force on each foot one step earlier, N.
        episodes: ``frame`` is the reference row of the new state.
        target: target poses; the first frame is compared with the state.
        kernels, weights: ``(6,)`` of the terms, see ``questsim.reward``.
        scores: output.
    """
    terms, force = scores.terms, state.foot_force
    links, dofs = reference.velocity.shape[1], reference.qvel.shape[1] - 6
    for i in range(first, last):
        angles, velocities = _joint_errors(i, state, episodes, reference, target)
        squared, speed, distance, turn = _link_errors(i, state, episodes, reference, target)
        drop = 0.0
        for foot in range(2):
            drop += max(0.0, previous_force[i, foot] - force[i, foot, 2])
        terms[i, 0] = math.exp(-kernels[0] * angles / dofs)
        terms[i, 1] = math.exp(-kernels[1] * velocities / dofs)
        terms[i, 2] = math.exp(-kernels[2] * squared / links)
        terms[i, 3] = math.exp(-kernels[3] * speed / links)
        terms[i, 4] = math.exp(-kernels[4] * drop)
        terms[i, 5] = math.exp(-kernels[5] * turn / links)
        total = 0.0
        for t in range(terms.shape[1]):
            total += weights[t] * terms[i, t]
        scores.reward[i] = total
        scores.error[i] = distance / links
