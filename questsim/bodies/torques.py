"""Inverse dynamics of a body's clips: the torques that its teachers observe."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import mujoco
import numpy as np
import scipy  # it imports its parts on first use

from questsim import rotations as rot
from questsim.bodies.body_map import BodyMap, OwnBody, map_of
from questsim.body import DEFAULT_HEIGHT_M
from questsim.motion.clip import FPS, Clip
from questsim.motion.inverse_dynamics import (
    CONTACT_HEIGHT_M,
    EDGES,
    ROOT_WEIGHTS,
    SEAT_POINTS,
    SPREAD,
    THIGH_M,
    THIGHS,
    cached_torques,
)
from questsim.motion.synthesis.wish import SEATED
from questsim.skeleton import LINKS

_NEAR = 12
"""At most this many lowest points of the feet carry load: a mesh or a box has many corners."""

_VERSION = b"2"
"""Part of the cache key: change it with the method."""


def own_torques(body: OwnBody, clips: Sequence[Clip]) -> np.ndarray:
    """``(F, D)`` float32 torques of clips of the body, as shares of each joint's limit.

    The method of ``questsim.motion.inverse_dynamics``, with the body's own support and thighs; each
    clip's torques are kept in the cache folder as well. The chair of a seated clip is as high as
    the clip's lowest pelvis.
    """
    own = map_of(body)
    model = copy.copy(own.body.model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    data = mujoco.MjData(model)

    def shares(clip: Clip) -> np.ndarray:
        acceleration = np.gradient(clip.qvel, 1.0 / FPS, axis=0)
        bottoms = own.support.bottoms(clip.link_position, clip.link_quat)
        seats = _seats(own, clip)
        torques = []
        for frame in range(len(clip)):
            data.qpos[:], data.qvel[:] = clip.qpos[frame], clip.qvel[frame]
            data.qacc[:] = acceleration[frame]
            mujoco.mj_inverse(model, data)
            force = np.array(data.qfrc_inverse)
            near = _near_floor(own, bottoms[frame])
            near += [(link, points[frame]) for link, points, there in seats if there[frame]]
            torques.append(force[6:] - _carried(model, data, near, force)[6:])
        return np.clip(np.array(torques) / own.body.torque_limits, -1.0, 1.0)

    key = _VERSION + body.digest.encode()
    return np.concatenate([cached_torques(clip, key, shares, len(own.dofs)) for clip in clips])


def _near_floor(body: BodyMap, bottoms: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Link and place of the lowest points of the feet, where they touch the floor."""
    near = np.flatnonzero(bottoms[:, 2] < CONTACT_HEIGHT_M)
    near = near[np.argsort(bottoms[near, 2], kind="stable")][:_NEAR]
    return [(int(body.support.link[point]), bottoms[point]) for point in near]


def _seats(body: BodyMap, clip: Clip) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Points that a chair carries: link, places ``(F, 3)``, ``(F,)`` whether the clip sits."""
    if clip.kind not in SEATED:
        return []
    position, quat = body.roles(clip.link_position, clip.link_quat)
    height = position[:, LINKS.index("pelvis"), 2]
    sits = height < height.min() + CONTACT_HEIGHT_M
    scale = body.body.height_m / DEFAULT_HEIGHT_M
    below = np.array([0.0, 0.0, THIGH_M * scale])
    return [
        (
            int(body.role_link[thigh]),
            position[:, thigh] + rot.quat_rotate(quat[:, thigh], point * scale) - below,
            sits,
        )
        for thigh in THIGHS
        for point in SEAT_POINTS
    ]


def _carried(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    points: Sequence[tuple[int, np.ndarray]],
    force: np.ndarray,
) -> np.ndarray:
    """Generalised forces ``(6 + D,)`` at points of links that best supply the root's force."""
    if not points:
        return np.zeros(model.nv)
    edges = np.empty((len(points), len(EDGES), model.nv))
    jacobian = np.zeros((3, model.nv))
    for row, (link, place) in enumerate(points):
        mujoco.mj_jac(model, data, jacobian, None, place, link + 1)
        edges[row] = EDGES @ jacobian
    flat = edges.reshape(-1, model.nv)
    root = flat[:, :6].T * ROOT_WEIGHTS[:, None]
    wanted = np.concatenate([force[:6] * ROOT_WEIGHTS, np.zeros(len(flat))])
    factors, _ = scipy.optimize.nnls(np.vstack([root, SPREAD * np.eye(len(flat))]), wanted)
    return flat.T @ factors
