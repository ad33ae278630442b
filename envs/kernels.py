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

from questsim.motion.clip import FPS

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
def _heading(w, x, y, z):
    """Cosine and sine of the heading of a quaternion."""
    forward_x = 1 - 2 * (y * y + z * z)
    forward_y = 2 * (w * z + x * y)
    length = math.sqrt(forward_x * forward_x + forward_y * forward_y)
    if length < 1e-9:
        return 1.0, 0.0
    return forward_x / length, forward_y / length


@_jit
def _cell(values, grid, x, y):
    """Row, column and the place within the cell of a point on a grid; beyond the edge, its edge."""
    rows, columns = values.shape
    across = min(max((x - grid[0]) / grid[2], 0.0), columns - 1.0)
    along = min(max((y - grid[1]) / grid[2], 0.0), rows - 1.0)
    column, row = min(int(across), columns - 2), min(int(along), rows - 2)
    return row, column, across - column, along - row


@_jit
def _ground_at(ground, grid, x, y):
    """``HeightField.ground_at`` of one point; a field of one number is a plane at zero."""
    if ground.size == 1:
        return 0.0
    row, column, u, v = _cell(ground, grid, x, y)
    near = ground[row, column] * (1.0 - u) + ground[row, column + 1] * u
    far = ground[row + 1, column] * (1.0 - u) + ground[row + 1, column + 1] * u
    return near * (1.0 - v) + far * v


@_jit
def _height_at(height, grid, x, y):
    """``HeightField.height_at`` of one point; a field of one number is a plane at zero."""
    if height.size == 1:
        return 0.0
    row, column, u, v = _cell(height, grid, x, y)
    low, right = height[row, column], height[row, column + 1]
    up, far = height[row + 1, column], height[row + 1, column + 1]
    if u >= v:
        return low + u * (right - low) + v * (far - right)
    return low + v * (up - low) + u * (far - up)


@_jit
def _lift(place, ground, grid, root_x, root_y):
    """Height of the ground under a root of a clip that is played at ``place``."""
    x, y = _placed(place, root_x, root_y)
    return _ground_at(ground, grid, x, y)


@_jit
def _placed(place, x, y):
    """Where a point of a clip lies in the world."""
    return (
        place[0] + (place[2] * x - place[3] * y),
        place[1] + (place[3] * x + place[2] * y),
    )


@_jit
def observe(
    first, last, ids, qpos, qvel, xpos, xquat, cvel, com, force, frame, begin, end, ratio, height,
    ref_qpos, ref_qvel, ref_position, ref_quat, dev_position, dev_quat, late, newest,
    offsets, privileged, place, ground, grid, floor, obs,
):  # fmt: skip
    """Fill ``obs[ids[first:last]]``.

    Args:
        first, last: the part of ``ids`` this call works on.
        ids: simulations ``(m,)``.
        qpos ... com: bound fields of the batch, ``(n, ...)``; ``com`` is ``subtree_com``.
        force: ``(n, 2, 3)`` force of the floor on each foot, world, N.
        frame, begin, end: ``(n,)`` reference row now, the clip's first, one past its last.
        ratio: ``(n,)`` body height over 1.75 m; reference lengths are of the 1.75 m body.
        height: ``(n,)`` metres.
        ref_*, dev_*: reference rows of all clips, one after the other.
        late: ``(n,)`` frames by which the devices are late.
        newest: ``(n, devices)`` the last row that each device can show.
        offsets: ``(k,)`` frames ahead of each block of o_user.
        privileged: ``(p,)`` frames ahead of each privileged block.
        place: ``(n, 4)`` where each clip is played: x, y, cosine and sine of its turn.
        ground: ``(rows, columns)`` height of the floor on a grid, or one number for a plane.
        grid: x and y of the grid's first point, and its distance of points.
        floor: ``(n,)`` takes the height of the floor below the root, metres.
        obs: ``(n, size)`` float32.
    """
    links = ref_position.shape[1]
    dofs = ref_qpos.shape[1] - 7
    devices = dev_position.shape[1]
    for index in range(first, last):
        i = ids[index]
        out = obs[i]
        root_x, root_y = qpos[i, 0], qpos[i, 1]
        below = _ground_at(ground, grid, root_x, root_y)
        floor[i] = below
        c, s = _heading(qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6])
        # The heading as the clip sees it, before it was turned to its place.
        clip_c = c * place[i, 2] + s * place[i, 3]
        clip_s = s * place[i, 2] - c * place[i, 3]
        at = 0
        for j in range(dofs):
            out[at] = qpos[i, 7 + j]
            out[at + dofs] = qvel[i, 6 + j]
            at += 1
        at += dofs
        com_x, com_y, com_z = com[i, 1, 0], com[i, 1, 1], com[i, 1, 2]
        for b in range(links):
            x, y, z = xpos[i, b + 1, 0], xpos[i, b + 1, 1], xpos[i, b + 1, 2]
            _turn_back(c, s, x - root_x, y - root_y, z - below, out, at + 3 * b)
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
            shown = max(min(frame[i] + offsets[k] - late[i], end[i] - 1), begin[i])
            for d in range(devices):
                row = min(shown, newest[i, d])
                x, y = _placed(
                    place[i], dev_position[row, d, 0] * scale, dev_position[row, d, 1] * scale
                )
                # Devices keep their height above the user's own floor.
                z = dev_position[row, d, 2] * scale
                _turn_back(c, s, x - root_x, y - root_y, z, out, at)
                _columns(
                    clip_c, clip_s, dev_quat[row, d, 0], dev_quat[row, d, 1],
                    dev_quat[row, d, 2], dev_quat[row, d, 3], out, at + 3,
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
            lift = _lift(place[i], ground, grid, ref_qpos[row, 0] * scale, ref_qpos[row, 1] * scale)
            for b in range(links):
                x, y = _placed(
                    place[i], ref_position[row, b, 0] * scale, ref_position[row, b, 1] * scale
                )
                z = ref_position[row, b, 2] * scale + lift
                _turn_back(
                    c, s, x - xpos[i, b + 1, 0], y - xpos[i, b + 1, 1], z - xpos[i, b + 1, 2],
                    out, at + 3 * b,
                )  # fmt: skip
                _columns(
                    clip_c, clip_s, ref_quat[row, b, 0], ref_quat[row, b, 1],
                    ref_quat[row, b, 2], ref_quat[row, b, 3], out, at + 3 * links + 6 * b,
                )  # fmt: skip
            at += 9 * links


@_jit
def score(
    first, last, qpos, qvel, xpos, cvel, com, force, previous_force, frame, ratio,
    ref_qpos, ref_qvel, ref_position, ref_velocity, place, ground, grid, kernels, weights, terms,
    reward, error,
):  # fmt: skip
    """Fill ``terms`` ``(n, 5)``, ``reward`` ``(n,)`` and mean link ``error`` ``(n,)`` in metres.

    ``frame`` is the reference row of the new state, which is not a clip's first; see ``observe``
    for the rest. The reference is lifted by the ground under its root.
    """
    links = ref_position.shape[1]
    dofs = ref_qpos.shape[1] - 7
    for i in range(first, last):
        row, scale = frame[i], ratio[i]
        turn_c, turn_s = place[i, 2], place[i, 3]
        lift = _lift(place[i], ground, grid, ref_qpos[row, 0] * scale, ref_qpos[row, 1] * scale)
        before = max(row - 1, 0)
        rise = FPS * (
            lift
            - _lift(
                place[i], ground, grid, ref_qpos[before, 0] * scale, ref_qpos[before, 1] * scale
            )
        )
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
        for b in range(links):
            x, y, z = xpos[i, b + 1, 0], xpos[i, b + 1, 1], xpos[i, b + 1, 2]
            ref_x, ref_y = _placed(
                place[i], ref_position[row, b, 0] * scale, ref_position[row, b, 1] * scale
            )
            dx, dy = x - ref_x, y - ref_y
            dz = z - (ref_position[row, b, 2] * scale + lift)
            square = dx * dx + dy * dy + dz * dz
            squared += square
            distance += math.sqrt(square)
            wx, wy, wz = cvel[i, b + 1, 0], cvel[i, b + 1, 1], cvel[i, b + 1, 2]
            rx, ry, rz = x - com[i, 1, 0], y - com[i, 1, 1], z - com[i, 1, 2]
            ref_x, ref_y = ref_velocity[row, b, 0] * scale, ref_velocity[row, b, 1] * scale
            dx = cvel[i, b + 1, 3] + wy * rz - wz * ry - (turn_c * ref_x - turn_s * ref_y)
            dy = cvel[i, b + 1, 4] + wz * rx - wx * rz - (turn_s * ref_x + turn_c * ref_y)
            dz = cvel[i, b + 1, 5] + wx * ry - wy * rx - (ref_velocity[row, b, 2] * scale + rise)
            speed += dx * dx + dy * dy + dz * dz
        drop = 0.0
        for foot in range(2):
            drop += max(0.0, previous_force[i, foot] - force[i, foot, 2])
        terms[i, 0] = math.exp(-kernels[0] * angles / dofs)
        terms[i, 1] = math.exp(-kernels[1] * velocities / dofs)
        terms[i, 2] = math.exp(-kernels[2] * squared / links)
        terms[i, 3] = math.exp(-kernels[3] * speed / links)
        terms[i, 4] = math.exp(-kernels[4] * drop)
        total = 0.0
        for t in range(5):
            total += weights[t] * terms[i, t]
        reward[i] = total
        error[i] = distance / links


@_jit
def scan(first, last, ids, qpos, points, height, grid, floor, column, obs):
    """Fill ``obs[ids[first:last], column:]`` with the surface around the avatar.

    Args:
        first, last, ids, qpos, grid, floor, obs: as of ``observe``, which fills ``floor``.
        points: ``(k, 2)`` places in S, metres.
        height: ``(rows, columns)`` of the surface on a grid, or one number for a plane.
        column: of the first of ``k`` heights above the floor below the root, metres.
    """
    for index in range(first, last):
        i = ids[index]
        c, s = _heading(qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6])
        for k in range(points.shape[0]):
            x = qpos[i, 0] + c * points[k, 0] - s * points[k, 1]
            y = qpos[i, 1] + s * points[k, 0] + c * points[k, 1]
            obs[i, column + k] = _height_at(height, grid, x, y) - floor[i]


def chunks(count: int, parts: int) -> list[tuple[int, int]]:
    """``parts`` near-equal ranges that cover ``range(count)``, without empty ones."""
    edges = np.linspace(0, count, min(parts, count) + 1).astype(int)
    return [(int(a), int(b)) for a, b in pairwise(edges) if b > a]
