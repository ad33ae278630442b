"""``retarget`` for a stream: poses of a person on the avatar, each by itself.

Whole motions tell by themselves where their floor is and how high an ankle is above its sole. Here
a recording of the same person tells both beforehand, as a calibration would, and every pose keeps
its height over that floor: what floats or sinks is seen to.
"""

from __future__ import annotations

import mujoco
import numpy as np

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M, build_body
from questsim.motion.clip import FPS
from questsim.motion.kinematics import sole_points, sole_positions
from questsim.motion.limbs import (
    FLOOR_PERCENTILE,
    SIDES,
    ankle_rise,
    fill_arm,
    fill_leg,
    fill_trunk,
    leg_ratio,
    root_path,
)
from questsim.motion.motion import Motion
from questsim.skeleton import FOOT_LINKS, JOINTS, NUM_DOFS

_ANKLES = [JOINTS.index(f"{side}_ankle") for side in SIDES]
_UP = np.array([0.0, 0.0, 1.0])


class StreamRetargeter:
    """Puts one person's poses on the avatar of one height; nothing is kept between calls.

    Args:
        recording: of that person: two constants are taken from it, the heights of the floor and
            of an ankle above its sole.
        height_m: the avatar's stature.
    """

    def __init__(self, recording: Motion, height_m: float) -> None:
        self._height = height_m
        self._model = build_body(height_m).model
        self._data = mujoco.MjData(self._model)
        motion = recording.resampled(FPS)
        position, quat = motion.forward_kinematics()
        self._rise = ankle_rise(motion, position)
        self._floor = 0.0
        _, ankles = self._targets(motion, position, quat)
        lowest = self._lowest(ankles, quat[:, _ANKLES]).min(axis=-1)
        self._floor = float(np.percentile(lowest, FLOOR_PERCENTILE))

    def __call__(self, poses: Motion) -> np.ndarray:
        """The avatar's ``qpos`` ``(T, 40)`` of poses of that person ``(T)``, floor at z = 0."""
        position, quat = poses.forward_kinematics()
        angles = np.zeros((len(poses), NUM_DOFS))
        links = fill_trunk(quat, angles)
        for side in SIDES:
            fill_arm(side, poses, position, quat, links, self._height, angles)
        root, ankles = self._targets(poses, position, quat)
        # What the ankle's hinges lack may press a sole lower than it is to be, and into the floor.
        allowed = np.minimum(self._lowest(ankles, quat[:, _ANKLES]), 0.0)
        qpos = self._with_legs(root, quat, ankles, angles)
        lowest = self._lowest(*self._feet(qpos))
        if (lowest < allowed).any():
            ankles[..., 2] += np.maximum(allowed - lowest, 0.0)
            qpos = self._with_legs(root, quat, ankles, angles)
        return qpos

    def _targets(
        self, poses: Motion, position: np.ndarray, quat: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Paths of pelvis ``(T, 3)`` and ankles ``(T, 2, 3)``: as ``retarget`` has them."""
        ratio = leg_ratio(poses, self._height)
        avatar_rise = -sole_points()[..., 2].mean() * self._height / DEFAULT_HEIGHT_M
        root = root_path(poses, position, self._height)
        root[:, 2] += avatar_rise - ratio * self._rise - self._floor
        up = rot.quat_rotate(quat[:, _ANKLES], _UP)
        ankles = (position[:, _ANKLES] - self._rise * up) * ratio + avatar_rise * up
        ankles[..., 2] -= self._floor
        return root, ankles

    def _lowest(self, feet: np.ndarray, quat: np.ndarray) -> np.ndarray:
        """Height ``(T, 2)`` of each sole's lowest point."""
        return sole_positions(feet, quat, self._height)[..., 2].min(axis=-1)

    def _feet(self, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the avatar's feet are ``(T, 2, 3)``, and their orientations ``(T, 2, 4)``."""
        feet = [1 + link for link in FOOT_LINKS]
        position, quat = np.empty((len(qpos), 2, 3)), np.empty((len(qpos), 2, 4))
        for row, pose in enumerate(qpos):  # a single one, as a rule
            self._data.qpos[:] = pose
            mujoco.mj_kinematics(self._model, self._data)
            position[row], quat[row] = self._data.xpos[feet], self._data.xquat[feet]
        return position, quat

    def _with_legs(
        self, root: np.ndarray, quat: np.ndarray, ankles: np.ndarray, angles: np.ndarray
    ) -> np.ndarray:
        for index, side in enumerate(SIDES):
            foot = quat[:, _ANKLES[index]]
            fill_leg(side, root, quat, ankles[:, index], foot, self._height, angles)
        return np.concatenate([root, quat[:, 0], _within_limits(angles)], axis=-1)


def _within_limits(angles: np.ndarray) -> np.ndarray:
    """Angles ``(T, 33)`` by whole turns as near to their ranges as can be, and kept in them."""
    limits = build_body().model.jnt_range[1:]
    turns = np.round((angles - limits.mean(axis=1)) / (2 * np.pi))
    return np.clip(angles - 2 * np.pi * turns, limits[:, 0], limits[:, 1])
