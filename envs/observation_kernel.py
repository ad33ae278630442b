"""The observation of every simulation, compiled: the blocks of ``envs.layout``, one after another.

Plain loops over simulations and links, compiled by Numba. Each simulation is independent of the
others, so results do not depend on how the batch is split among threads. The functions that write
one block are inlined (``forceinline``): passing records of arrays to a call takes as long as a
third of the work.
"""

from __future__ import annotations

import math

import numpy as np

from envs.kernel_arguments import (
    Devices,
    Episodes,
    Ground,
    Privileged,
    ReferenceRows,
    State,
    Target,
)
from envs.lookups import ground_at, heading, height_at, placed, product, turned, unplaced
from questsim.compiled import jit, turn_back

# Constants of SplitMix64, see ``envs.episode_random``.
_STEP = np.uint64(0x9E3779B97F4A7C15)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_LANE = np.uint64(0xFFFF)


@jit
def _columns(c, s, w, x, y, z, out, at):
    """Write the first two columns of the quaternion's matrix in S to out[at:at + 6]."""
    turn_back(c, s, 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y), out, at)
    turn_back(c, s, 2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x), out, at + 3)


@jit
def _turn_between(c, s, p, q, out, at):
    """Write the rotation from p to q, 2 sin(angle / 2) times its axis in S, to out[at:]."""
    w = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    two = 2.0 if w >= 0.0 else -2.0
    turn_back(
        c, s,
        two * (p[0] * q[1] - p[1] * q[0] - p[3] * q[2] + p[2] * q[3]),
        two * (p[0] * q[2] - p[2] * q[0] - p[1] * q[3] + p[3] * q[1]),
        two * (p[0] * q[3] - p[3] * q[0] - p[2] * q[1] + p[1] * q[2]),
        out, at,
    )  # fmt: skip


@jit
def _noise(key, number):
    """A number of mean 0 and variance 1 that depends on key and number only.

    The sum of four uniform numbers, which is nearly normal, from one SplitMix64 output.
    """
    bits = key + np.uint64(number + 1) * _STEP
    bits = (bits ^ (bits >> np.uint64(30))) * _FIRST
    bits = (bits ^ (bits >> np.uint64(27))) * _SECOND
    bits ^= bits >> np.uint64(31)
    total = np.uint64(0)
    for _ in range(4):
        total += bits & _LANE
        bits >>= np.uint64(16)
    return (float(total) - 131070.0) * (math.sqrt(3.0) / 65536.0)


@jit
def _exact_device(position, quat, scale, place, view, out, at):
    """Write a device's pose without errors to out[at:at + 9]."""
    c, s, clip_c, clip_s, root_x, root_y = view
    x, y = placed(place, position[0] * scale, position[1] * scale)
    # Device heights are above the user's own floor.
    turn_back(c, s, x - root_x, y - root_y, position[2] * scale, out, at)
    _columns(clip_c, clip_s, quat[0], quat[1], quat[2], quat[3], out, at + 3)


@jit
def _faulty_device(devices, i, d, row, frame, scale, place, view, out, at):
    """Write the pose of device ``d`` of a row, with noise and mounting errors, to out[at:at + 9].

    A pose has the same noise whenever it is shown: it depends on the episode's key, on ``frame``,
    the row counted from the clip's first, and on the device.
    """
    c, s, clip_c, clip_s, root_x, root_y = view
    faults = devices.faults
    number = 6 * (frame * devices.quat.shape[1] + d)
    key, std_m, std_rad = faults.key[i], faults.std[i, 0], faults.std[i, 1]
    own = devices.quat[row, d]
    quat = (float(own[0]), float(own[1]), float(own[2]), float(own[3]))
    offset, mount = faults.mount_offset[i, d], faults.mount_quat[i, d]
    arm = product(
        product(quat, (0.0, offset[0], offset[1], offset[2])),
        (quat[0], -quat[1], -quat[2], -quat[3]),
    )
    x = devices.position[row, d, 0] * scale + arm[1] + std_m * _noise(key, number)
    y = devices.position[row, d, 1] * scale + arm[2] + std_m * _noise(key, number + 1)
    z = devices.position[row, d, 2] * scale + arm[3] + std_m * _noise(key, number + 2)
    half_x = 0.5 * std_rad * _noise(key, number + 3)
    half_y = 0.5 * std_rad * _noise(key, number + 4)
    half_z = 0.5 * std_rad * _noise(key, number + 5)
    length = math.sqrt(1.0 + half_x * half_x + half_y * half_y + half_z * half_z)
    noise = (1.0 / length, half_x / length, half_y / length, half_z / length)
    turned_quat = product(noise, product(quat, (mount[0], mount[1], mount[2], mount[3])))
    x, y = placed(place, x, y)
    turn_back(c, s, x - root_x, y - root_y, z, out, at)
    _columns(
        clip_c, clip_s, turned_quat[0], turned_quat[1], turned_quat[2], turned_quat[3], out,
        at + 3,
    )  # fmt: skip


@jit(forceinline=True)
def _own_state(i, state, reference, view, below, out):
    """Write ``o_sim`` of simulation ``i`` to ``out``; returns the column after it.

    Args:
        i, state, reference, out: as of ``observe``, ``out`` a row of its ``obs``.
        view: cosine and sine of the heading; the same in the clip's coordinates; the root's x and
            y.
        below: height of the floor below the root, metres.
    """
    qpos, qvel, xpos, xquat = state.qpos, state.qvel, state.xpos, state.xquat
    cvel, com, force = state.cvel, state.com, state.foot_force
    links, dofs = reference.velocity.shape[1], reference.qvel.shape[1] - 6
    c, s, _, _, root_x, root_y = view
    for j in range(dofs):
        out[j] = qpos[i, 7 + j]
        out[dofs + j] = qvel[i, 6 + j]
    at = 2 * dofs
    com_x, com_y, com_z = com[i, 1, 0], com[i, 1, 1], com[i, 1, 2]
    for b in range(links):
        x, y, z = xpos[i, b + 1, 0], xpos[i, b + 1, 1], xpos[i, b + 1, 2]
        turn_back(c, s, x - root_x, y - root_y, z - below, out, at + 3 * b)
        _columns(
            c, s, xquat[i, b + 1, 0], xquat[i, b + 1, 1], xquat[i, b + 1, 2],
            xquat[i, b + 1, 3], out, at + 3 * links + 6 * b,
        )  # fmt: skip
        wx, wy, wz = cvel[i, b + 1, 0], cvel[i, b + 1, 1], cvel[i, b + 1, 2]
        rx, ry, rz = x - com_x, y - com_y, z - com_z
        turn_back(
            c, s, cvel[i, b + 1, 3] + wy * rz - wz * ry, cvel[i, b + 1, 4] + wz * rx - wx * rz,
            cvel[i, b + 1, 5] + wx * ry - wy * rx, out, at + 9 * links + 3 * b,
        )  # fmt: skip
        turn_back(c, s, wx, wy, wz, out, at + 12 * links + 3 * b)
    at += 15 * links
    for foot in range(2):
        turn_back(c, s, force[i, foot, 0], force[i, foot, 1], force[i, foot, 2], out, at)
        at += 3
    return at


@jit(forceinline=True)
def _seen_devices(i, episodes, devices, view, out, at):
    """Write ``o_user`` of simulation ``i`` to ``out[at:]``; returns the column after it."""
    frame, begin, end, place = episodes.frame, episodes.begin, episodes.end, episodes.place
    scale = episodes.ratio[i]
    faulty = devices.faults.key.shape[0] > 0
    for k in range(devices.offsets.shape[0]):
        shown = max(min(frame[i] + devices.offsets[k] - devices.late[i], end[i] - 1), begin[i])
        for d in range(devices.position.shape[1]):
            # With latency, a dropout at the start would end before the clip's first row.
            row = max(min(shown, devices.newest[i, d]), begin[i])
            if faulty:
                _faulty_device(
                    devices, i, d, row, row - begin[i], scale, place[i], view, out, at
                )  # fmt: skip
                at += 9
                continue
            _exact_device(
                devices.position[row, d], devices.quat[row, d], scale, place[i], view, out, at
            )  # fmt: skip
            at += 9
    return at


@jit(forceinline=True)
def _future_poses(i, state, episodes, reference, target, privileged, view, out, at):
    """Write the reference's poses ahead to ``out[at:]``; returns the column after them."""
    c, s, clip_c, clip_s, _, _ = view
    xpos, frame, end = state.xpos, episodes.frame, episodes.end
    links, dofs = reference.velocity.shape[1], reference.qvel.shape[1] - 6
    for k in range(privileged.offsets.shape[0]):
        row, slot = min(frame[i] + privileged.offsets[k], end[i] - 1), privileged.slots[k]
        for j in range(dofs):
            out[at + j] = target.angles[i, slot, j]
            out[at + dofs + j] = reference.qvel[row, 6 + j]
        at += 2 * dofs
        for b in range(links):
            wanted, quat = target.position[i, slot, b], target.quat[i, slot, b]
            turn_back(
                c, s, wanted[0] - xpos[i, b + 1, 0], wanted[1] - xpos[i, b + 1, 1],
                wanted[2] - xpos[i, b + 1, 2], out, at + 3 * b,
            )  # fmt: skip
            _columns(
                clip_c, clip_s, quat[0], quat[1], quat[2], quat[3],
                out, at + 3 * links + 6 * b,
            )  # fmt: skip
        at += 9 * links
    return at


@jit(forceinline=True)
def _present_errors(i, state, episodes, reference, target, view, out, at):
    """Write midway angles, reference torques and tracking errors to ``out[at:]``."""
    xpos, xquat, cvel, com = state.xpos, state.xquat, state.cvel, state.com
    velocity, angular_velocity = reference.velocity, reference.angular_velocity
    place, scale = episodes.place, episodes.ratio[i]
    links, dofs = reference.velocity.shape[1], reference.qvel.shape[1] - 6
    c, s, clip_c, clip_s, _, _ = view
    row = episodes.frame[i]
    after = min(row + 1, episodes.end[i] - 1)
    com_x, com_y, com_z = com[i, 1, 0], com[i, 1, 1], com[i, 1, 2]
    for j in range(dofs):
        out[at + j] = 0.5 * (target.angles[i, 0, j] + target.angles[i, 1, j])
        # Torque limits scale with s^3, gravity torques with s^4.
        torque = 0.5 * (reference.torque[row, j] + reference.torque[after, j])
        out[at + dofs + j] = scale * torque
    at += 2 * dofs
    for b in range(links):
        x, y, z = xpos[i, b + 1, 0], xpos[i, b + 1, 1], xpos[i, b + 1, 2]
        wanted = target.position[i, 0, b]
        turn_back(c, s, wanted[0] - x, wanted[1] - y, wanted[2] - z, out, at)
        _turn_between(
            clip_c, clip_s, unplaced(place[i], xquat[i, b + 1]), target.quat[i, 0, b],
            out, at + 3,
        )  # fmt: skip
        wx, wy, wz = cvel[i, b + 1, 0], cvel[i, b + 1, 1], cvel[i, b + 1, 2]
        rx, ry, rz = x - com_x, y - com_y, z - com_z
        ref_x, ref_y = turned(
            place[i],
            velocity[row, b, 0] * scale,
            velocity[row, b, 1] * scale,
        )
        turn_back(
            c, s,
            ref_x - (cvel[i, b + 1, 3] + wy * rz - wz * ry),
            ref_y - (cvel[i, b + 1, 4] + wz * rx - wx * rz),
            velocity[row, b, 2] * scale + target.rise[i, 0, b]
            - (cvel[i, b + 1, 5] + wx * ry - wy * rx),
            out, at + 6,
        )  # fmt: skip
        ref_x, ref_y = turned(
            place[i],
            angular_velocity[row, b, 0],
            angular_velocity[row, b, 1],
        )
        turn_back(
            c, s, ref_x - wx, ref_y - wy, angular_velocity[row, b, 2] - wz,
            out, at + 9,
        )  # fmt: skip
        at += 12


@jit
def observe(
    first: int,
    last: int,
    ids: np.ndarray,
    state: State,
    episodes: Episodes,
    reference: ReferenceRows,
    target: Target,
    devices: Devices,
    privileged: Privileged,
    ground: Ground,
    floor: np.ndarray,
    obs: np.ndarray,
) -> None:
    """Fill ``obs[ids[first:last]]``.

    Args:
        first, last: the part of ``ids`` this call works on.
        ids: simulations ``(m,)``.
        state, episodes, reference, devices, privileged, ground: see ``kernel_arguments``.
        target: target poses of this frame, the next, and those of ``privileged``.
        floor: ``(n,)`` output: height of the floor below the root, metres.
        obs: ``(n, size)`` float32.
    """
    qpos, place = state.qpos, episodes.place
    for index in range(first, last):
        i = ids[index]
        root_x, root_y = qpos[i, 0], qpos[i, 1]
        floor[i] = ground_at(ground.height, ground.grid, root_x, root_y)
        c, s = heading(qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6])
        # The heading in the clip's coordinates, before the turn to its place.
        clip_c = c * place[i, 2] + s * place[i, 3]
        clip_s = s * place[i, 2] - c * place[i, 3]
        view = (c, s, clip_c, clip_s, root_x, root_y)
        at = _own_state(i, state, reference, view, floor[i], obs[i])
        at = _seen_devices(i, episodes, devices, view, obs[i], at)
        for k in range(episodes.scale.shape[1]):
            obs[i, at] = episodes.scale[i, k]
            at += 1
        if privileged.offsets.shape[0] > 0:
            at = _future_poses(i, state, episodes, reference, target, privileged, view, obs[i], at)
            _present_errors(i, state, episodes, reference, target, view, obs[i], at)


@jit
def observe_exactly(
    first: int,
    last: int,
    ids: np.ndarray,
    state: State,
    episodes: Episodes,
    position: np.ndarray,
    quat: np.ndarray,
    offsets: np.ndarray,
    at: int,
    obs: np.ndarray,
) -> None:
    """Write devices without errors and latency to ``obs[ids[first:last], at:]``.

    Args:
        first, last, ids, state, episodes, obs: as of ``observe``.
        position, quat: ``(F, D, 3)``, ``(F, D, 4)`` of the devices in each reference row.
        offsets: ``(k,)`` frames ahead.
        at: first column.
    """
    frame, end, place = episodes.frame, episodes.end, episodes.place
    for index in range(first, last):
        i = ids[index]
        qpos = state.qpos[i]
        c, s = heading(qpos[3], qpos[4], qpos[5], qpos[6])
        clip_c = c * place[i, 2] + s * place[i, 3]
        clip_s = s * place[i, 2] - c * place[i, 3]
        column = at
        for k in range(offsets.shape[0]):
            row = min(frame[i] + offsets[k], end[i] - 1)
            for d in range(position.shape[1]):
                _exact_device(
                    position[row, d], quat[row, d], episodes.ratio[i], place[i],
                    (c, s, clip_c, clip_s, qpos[0], qpos[1]), obs[i], column,
                )  # fmt: skip
                column += 9


@jit
def scan(
    first: int,
    last: int,
    ids: np.ndarray,
    state: State,
    points: np.ndarray,
    ground: Ground,
    floor: np.ndarray,
    column: int,
    obs: np.ndarray,
) -> None:
    """Fill ``obs[ids[first:last], column:]`` with the surface around the avatar.

    Args:
        first, last, ids, state, ground, floor, obs: as of ``observe``, which fills ``floor``.
        points: ``(k, 2)`` places in S, metres.
        column: of the first of ``k`` heights above the floor below the root, metres.
    """
    qpos = state.qpos
    for index in range(first, last):
        i = ids[index]
        c, s = heading(qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6])
        for k in range(points.shape[0]):
            x = qpos[i, 0] + c * points[k, 0] - s * points[k, 1]
            y = qpos[i, 1] + s * points[k, 0] + c * points[k, 1]
            obs[i, column + k] = height_at(ground.surface, ground.grid, x, y) - floor[i]
