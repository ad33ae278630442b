"""The environments' inner loop, compiled: observation, reward and error of every simulation.

Plain loops over simulations and links, as Numba compiles them; each simulation is independent
of the others, so that results do not depend on how the batch is split among threads.
``reward.py`` holds the same terms as readable array functions; the tests compare the two.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numba
import numpy as np

_jit: Any = numba.njit(cache=True, nogil=True, error_model="numpy")


@_jit
def _turn_back(c, s, x, y, z, out, at):
    """Write the vector (x, y, z), turned about z by minus the heading, to out[at:at + 3]."""
    out[at] = c * x + s * y
    out[at + 1] = c * y - s * x
    out[at + 2] = z


@_jit
def _columns(c, s, w, x, y, z, out, at):
    """Write the first two columns of the quaternion's matrix in S to out[at:at + 6]."""
    _turn_back(c, s, 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y), out, at)
    _turn_back(c, s, 2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x), out, at + 3)


@_jit
def _turn_between(c, s, p, q, out, at):
    """Write the turn from quaternion p to q, 2 sin(angle / 2) times its axis in S, to out[at:]."""
    w = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    two = 2.0 if w >= 0.0 else -2.0
    _turn_back(
        c, s,
        two * (p[0] * q[1] - p[1] * q[0] - p[3] * q[2] + p[2] * q[3]),
        two * (p[0] * q[2] - p[2] * q[0] - p[1] * q[3] + p[3] * q[1]),
        two * (p[0] * q[3] - p[3] * q[0] - p[2] * q[1] + p[1] * q[2]),
        out, at,
    )  # fmt: skip


@_jit
def _heading(w, x, y, z):
    """Cosine and sine of the heading of a quaternion."""
    forward_x = 1 - 2 * (y * y + z * z)
    forward_y = 2 * (w * z + x * y)
    length = math.sqrt(forward_x * forward_x + forward_y * forward_y)
    if length < 1e-9:
        return 1.0, 0.0
    return forward_x / length, forward_y / length


@_jit
def observe(
    first, last, ids, qpos, qvel, xpos, xquat, cvel, com, force, frame, end, ratio, height,
    ref_qpos, ref_qvel, ref_position, ref_quat, ref_velocity, ref_angular_velocity, ref_torque,
    dev_position, dev_quat, offsets, privileged, floor, obs,
):  # fmt: skip
    """Fill ``obs[ids[first:last]]``.

    Args:
        first, last: the part of ``ids`` this call works on.
        ids: simulations ``(m,)``.
        qpos ... com: bound fields of the batch, ``(n, ...)``; ``com`` is ``subtree_com``.
        force: ``(n, 2, 3)`` force of the floor on each foot, world, N.
        frame, end: ``(n,)`` reference row now, and one past the clip's last row.
        ratio: ``(n,)`` body height over 1.75 m; reference lengths are of the 1.75 m body.
        height: ``(n,)`` metres.
        ref_*, dev_*: reference rows of all clips, one after the other; ``ref_torque`` is empty
            where nothing is privileged.
        offsets: ``(k,)`` frames ahead of each block of o_user.
        privileged: ``(p,)`` frames ahead of each privileged block.
        floor: ``(n,)`` height of the floor below the root, metres.
        obs: ``(n, size)`` float32.
    """
    links = ref_position.shape[1]
    dofs = qpos.shape[1] - 7
    devices = dev_position.shape[1]
    for index in range(first, last):
        i = ids[index]
        out = obs[i]
        root_x, root_y, ground = qpos[i, 0], qpos[i, 1], floor[i]
        c, s = _heading(qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6])
        at = 0
        for j in range(dofs):
            out[at] = qpos[i, 7 + j]
            out[at + dofs] = qvel[i, 6 + j]
            at += 1
        at += dofs
        com_x, com_y, com_z = com[i, 1, 0], com[i, 1, 1], com[i, 1, 2]
        for b in range(links):
            x, y, z = xpos[i, b + 1, 0], xpos[i, b + 1, 1], xpos[i, b + 1, 2]
            _turn_back(c, s, x - root_x, y - root_y, z - ground, out, at + 3 * b)
            _columns(
                c, s, xquat[i, b + 1, 0], xquat[i, b + 1, 1], xquat[i, b + 1, 2],
                xquat[i, b + 1, 3], out, at + 3 * links + 6 * b,
            )  # fmt: skip
            wx, wy, wz = cvel[i, b + 1, 0], cvel[i, b + 1, 1], cvel[i, b + 1, 2]
            rx, ry, rz = x - com_x, y - com_y, z - com_z
            _turn_back(
                c, s, cvel[i, b + 1, 3] + wy * rz - wz * ry, cvel[i, b + 1, 4] + wz * rx - wx * rz,
                cvel[i, b + 1, 5] + wx * ry - wy * rx, out, at + 9 * links + 3 * b,
            )  # fmt: skip
            _turn_back(c, s, wx, wy, wz, out, at + 12 * links + 3 * b)
        at += 15 * links
        for foot in range(2):
            _turn_back(c, s, force[i, foot, 0], force[i, foot, 1], force[i, foot, 2], out, at)
            at += 3
        scale = ratio[i]
        for k in range(offsets.shape[0]):
            row = min(frame[i] + offsets[k], end[i] - 1)
            for d in range(devices):
                _turn_back(
                    c, s, dev_position[row, d, 0] * scale - root_x,
                    dev_position[row, d, 1] * scale - root_y,
                    dev_position[row, d, 2] * scale - ground, out, at,
                )  # fmt: skip
                _columns(
                    c, s, dev_quat[row, d, 0], dev_quat[row, d, 1], dev_quat[row, d, 2],
                    dev_quat[row, d, 3], out, at + 3,
                )  # fmt: skip
                at += 9
        out[at] = height[i]
        at += 1
        for k in range(privileged.shape[0]):
            row = min(frame[i] + privileged[k], end[i] - 1)
            for j in range(dofs):
                out[at] = ref_qpos[row, 7 + j]
                out[at + dofs] = ref_qvel[row, 6 + j]
                at += 1
            at += dofs
            for b in range(links):
                _turn_back(
                    c, s, ref_position[row, b, 0] * scale - xpos[i, b + 1, 0],
                    ref_position[row, b, 1] * scale - xpos[i, b + 1, 1],
                    ref_position[row, b, 2] * scale - xpos[i, b + 1, 2], out, at + 3 * b,
                )  # fmt: skip
                _columns(
                    c, s, ref_quat[row, b, 0], ref_quat[row, b, 1], ref_quat[row, b, 2],
                    ref_quat[row, b, 3], out, at + 3 * links + 6 * b,
                )  # fmt: skip
            at += 9 * links
        if privileged.shape[0] > 0:
            row, after = frame[i], min(frame[i] + 1, end[i] - 1)
            for j in range(dofs):
                out[at + j] = 0.5 * (ref_qpos[row, 7 + j] + ref_qpos[after, 7 + j])
                # Of limits that grow as s^3; what gravity asks of a body grows as s^4.
                torque = 0.5 * (ref_torque[row, j] + ref_torque[after, j])
                out[at + dofs + j] = scale * torque
            at += 2 * dofs
            for b in range(links):
                x, y, z = xpos[i, b + 1, 0], xpos[i, b + 1, 1], xpos[i, b + 1, 2]
                _turn_back(
                    c, s, ref_position[row, b, 0] * scale - x, ref_position[row, b, 1] * scale - y,
                    ref_position[row, b, 2] * scale - z, out, at,
                )  # fmt: skip
                _turn_between(c, s, xquat[i, b + 1], ref_quat[row, b], out, at + 3)
                wx, wy, wz = cvel[i, b + 1, 0], cvel[i, b + 1, 1], cvel[i, b + 1, 2]
                rx, ry, rz = x - com_x, y - com_y, z - com_z
                _turn_back(
                    c, s,
                    ref_velocity[row, b, 0] * scale - (cvel[i, b + 1, 3] + wy * rz - wz * ry),
                    ref_velocity[row, b, 1] * scale - (cvel[i, b + 1, 4] + wz * rx - wx * rz),
                    ref_velocity[row, b, 2] * scale - (cvel[i, b + 1, 5] + wx * ry - wy * rx),
                    out, at + 6,
                )  # fmt: skip
                _turn_back(
                    c, s, ref_angular_velocity[row, b, 0] - wx,
                    ref_angular_velocity[row, b, 1] - wy, ref_angular_velocity[row, b, 2] - wz,
                    out, at + 9,
                )  # fmt: skip
                at += 12


@_jit
def score(
    first, last, qpos, qvel, xpos, xquat, cvel, com, force, previous_force, frame, ratio,
    ref_qpos, ref_qvel, ref_position, ref_quat, ref_velocity,
    kernels, weights, terms, reward, error,
):  # fmt: skip
    """Fill ``terms`` ``(n, 6)``, ``reward`` ``(n,)`` and mean link ``error`` ``(n,)`` in metres.

    ``frame`` is the reference row of the new state; see ``observe`` for the rest.
    """
    links = ref_position.shape[1]
    dofs = qpos.shape[1] - 7
    for i in range(first, last):
        row, scale = frame[i], ratio[i]
        angles = 0.0
        velocities = 0.0
        for j in range(dofs):
            difference = qpos[i, 7 + j] - ref_qpos[row, 7 + j]
            angles += difference * difference
            difference = qvel[i, 6 + j] - ref_qvel[row, 6 + j]
            velocities += difference * difference
        squared = 0.0
        speed = 0.0
        distance = 0.0
        turn = 0.0
        for b in range(links):
            dot = 0.0
            for c in range(4):
                dot += xquat[i, b + 1, c] * ref_quat[row, b, c]
            angle = 2.0 * math.acos(min(abs(dot), 1.0))
            turn += angle * angle
            x, y, z = xpos[i, b + 1, 0], xpos[i, b + 1, 1], xpos[i, b + 1, 2]
            dx = x - ref_position[row, b, 0] * scale
            dy = y - ref_position[row, b, 1] * scale
            dz = z - ref_position[row, b, 2] * scale
            square = dx * dx + dy * dy + dz * dz
            squared += square
            distance += math.sqrt(square)
            wx, wy, wz = cvel[i, b + 1, 0], cvel[i, b + 1, 1], cvel[i, b + 1, 2]
            rx, ry, rz = x - com[i, 1, 0], y - com[i, 1, 1], z - com[i, 1, 2]
            dx = cvel[i, b + 1, 3] + wy * rz - wz * ry - ref_velocity[row, b, 0] * scale
            dy = cvel[i, b + 1, 4] + wz * rx - wx * rz - ref_velocity[row, b, 1] * scale
            dz = cvel[i, b + 1, 5] + wx * ry - wy * rx - ref_velocity[row, b, 2] * scale
            speed += dx * dx + dy * dy + dz * dz
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
        reward[i] = total
        error[i] = distance / links


def chunks(count: int, parts: int) -> list[tuple[int, int]]:
    """``parts`` near-equal ranges that cover ``range(count)``, without empty ones."""
    edges = np.linspace(0, count, min(parts, count) + 1).astype(int)
    return [(int(a), int(b)) for a, b in pairwise(edges) if b > a]
