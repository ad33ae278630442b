"""Inverse dynamics of a body's clips: the torques that its teachers observe."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import mujoco
import numpy as np
import scipy  # it imports its parts on first use

from questsim.bodies.body_map import BodyMap, OwnBody, map_of
from questsim.motion.clip import FPS, Clip
from questsim.motion.inverse_dynamics import (
    CONTACT_HEIGHT_M,
    EDGES,
    ROOT_WEIGHTS,
    SPREAD,
    cached_torques,
)

_NEAR = 12
"""At most this many lowest points of the feet carry load: a mesh or a box has many corners."""


def own_torques(body: OwnBody, clips: Sequence[Clip]) -> np.ndarray:
    """``(F, D)`` float32 torques of clips of the body, as shares of each joint's limit.

    The method of ``questsim.motion.inverse_dynamics``, with the body's own support; each clip's
    torques are kept in the cache folder as well.
    """
    own = map_of(body)
    model = copy.copy(own.body.model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    data = mujoco.MjData(model)

    def shares(clip: Clip) -> np.ndarray:
        acceleration = np.gradient(clip.qvel, 1.0 / FPS, axis=0)
        bottoms = own.support.bottoms(clip.link_position, clip.link_quat)
        torques = []
        for frame in range(len(clip)):
            data.qpos[:], data.qvel[:] = clip.qpos[frame], clip.qvel[frame]
            data.qacc[:] = acceleration[frame]
            mujoco.mj_inverse(model, data)
            force = np.array(data.qfrc_inverse)
            torques.append(force[6:] - _from_floor(own, model, data, bottoms[frame], force)[6:])
        return np.clip(np.array(torques) / own.body.torque_limits, -1.0, 1.0)

    key = body.digest.encode()
    return np.concatenate([cached_torques(clip, key, shares, len(own.dofs)) for clip in clips])


def _from_floor(
    body: BodyMap,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    bottoms: np.ndarray,
    force: np.ndarray,
) -> np.ndarray:
    """Generalised forces ``(6 + D,)`` of the floor that best supply the force on the root."""
    near = np.flatnonzero(bottoms[:, 2] < CONTACT_HEIGHT_M)
    near = near[np.argsort(bottoms[near, 2], kind="stable")][:_NEAR]
    if not len(near):
        return np.zeros(model.nv)
    edges = np.empty((len(near), len(EDGES), model.nv))
    jacobian = np.zeros((3, model.nv))
    for row, point in enumerate(near):
        link = int(body.support.link[point]) + 1
        mujoco.mj_jac(model, data, jacobian, None, bottoms[point], link)
        edges[row] = EDGES @ jacobian
    flat = edges.reshape(-1, model.nv)
    root = flat[:, :6].T * ROOT_WEIGHTS[:, None]
    wanted = np.concatenate([force[:6] * ROOT_WEIGHTS, np.zeros(len(flat))])
    factors, _ = scipy.optimize.nnls(np.vstack([root, SPREAD * np.eye(len(flat))]), wanted)
    return flat.T @ factors
