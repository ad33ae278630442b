"""Streaming ``retarget``: transfers the poses of a person to the avatar as they arrive.

For a whole motion, the floor and the stance of the feet are estimated from the motion itself. Here
both come from an earlier recording of the same user, like a calibration. Every pose keeps its
height above that floor, so floating and sinking stay visible. If the feet of that recording need
planting, the feet of the poses are planted too, without look-ahead (``StancePlanter``).
"""

from __future__ import annotations

import mujoco
import numpy as np

from questsim.body import build_body
from questsim.motion.crouch import pelvis_turn, turned_back
from questsim.motion.footing import ANKLES, leg_targets, measure_footing
from questsim.motion.kinematics import sole_positions
from questsim.motion.limbs import fill_arms, fill_legs, fill_trunk, hips_of, leg_m
from questsim.motion.motion import Motion
from questsim.motion.stance import lowest_point
from questsim.motion.stance_stream import StancePlanter
from questsim.skeleton import FOOT_LINKS, NUM_DOFS


class StreamRetargeter:
    """Retargets one person's poses to the avatar of one height.

    The state between calls is the last pose's joint angles, so that no joint jumps by a turn, and
    the last stance of the feet, if feet are planted.

    Args:
        recording: of the same person; gives the height of the floor, the height of the ankle above
            the sole and the tilt of each foot.
        height_m: the avatar's stature.
    """

    def __init__(self, recording: Motion, height_m: float) -> None:
        self._height = height_m
        self._model = build_body(height_m).model
        self._data = mujoco.MjData(self._model)
        self._footing = measure_footing(recording, height_m)
        soles = self._footing.soles
        self._planter = StancePlanter(soles, height_m) if soles.flat else None
        self._angles: np.ndarray | None = None

    def reset(self) -> None:
        """The next pose is the first of a new stream."""
        self._angles = None
        if self._planter is not None:
            self._planter.reset()

    def __call__(self, poses: Motion) -> np.ndarray:
        """The avatar's ``qpos`` ``(T, 40)`` of the next poses ``(T)`` at 36 Hz, floor at z = 0."""
        position, quat = poses.forward_kinematics()
        root, ankles = leg_targets(poses, position, quat, self._height, self._footing.rise_m)
        floor = np.array([0.0, 0.0, self._footing.floor_m])
        return self._followed(poses, position, quat, root - floor, ankles - floor)

    def _followed(
        self,
        poses: Motion,
        position: np.ndarray,
        quat: np.ndarray,
        root: np.ndarray,
        ankles: np.ndarray,
    ) -> np.ndarray:
        """The avatar's ``qpos`` ``(T, 40)`` for the targets of root and ankles over the floor."""
        angles = np.zeros((len(poses), NUM_DOFS))
        links = fill_trunk(quat, angles)
        fill_arms(poses, position, quat, links, self._height, angles)
        feet, bears = quat[:, ANKLES], np.zeros(ankles.shape[:2])
        if self._planter is not None:
            hips = hips_of(root, quat, self._height)
            ankles, feet, rise, bears = self._planter(hips, ankles, feet, leg_m(self._height))
            root[:, 2] += rise
        # The ankle's missing degrees of freedom may push a sole below its target, into the floor,
        # or make a planted one skate. A pose without either keeps its first solution.
        allowed = np.minimum(lowest_point(ankles, feet, self._height), 0.0)
        qpos = self._with_legs(root, quat, ankles, feet, angles)
        wanted = sole_positions(ankles, feet, self._height).mean(axis=-2)
        soles = sole_positions(*self._feet(qpos), self._height)
        turn = pelvis_turn(angles, allowed - soles[..., 2].min(axis=-1))
        if turn.any():
            quat = turned_back(quat, turn)
            fill_trunk(quat, angles)
            qpos = self._with_legs(root, quat, ankles, feet, angles)
            soles = sole_positions(*self._feet(qpos), self._height)
        lowest = soles[..., 2].min(axis=-1)
        again = (lowest < allowed).any(axis=1) | bears.any(axis=1)
        if not again.any():
            self._angles = qpos[-1, 7:]
            return qpos
        ankles[..., 2] += np.maximum(allowed - lowest, 0.0)
        ankles[..., :2] += bears[..., None] * (wanted - soles.mean(axis=-2))[..., :2]
        second = self._with_legs(root, quat, ankles, feet, angles)
        qpos = np.where(again[:, None], second, qpos)
        self._angles = qpos[-1, 7:]
        return qpos

    def _feet(self, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions ``(T, 2, 3)`` and orientations ``(T, 2, 4)`` of the avatar's feet."""
        feet = [1 + link for link in FOOT_LINKS]
        position, quat = np.empty((len(qpos), 2, 3)), np.empty((len(qpos), 2, 4))
        for row, pose in enumerate(qpos):  # usually a single one
            self._data.qpos[:] = pose
            mujoco.mj_kinematics(self._model, self._data)
            position[row], quat[row] = self._data.xpos[feet], self._data.xquat[feet]
        return position, quat

    def _with_legs(
        self,
        root: np.ndarray,
        quat: np.ndarray,
        ankles: np.ndarray,
        feet: np.ndarray,
        angles: np.ndarray,
    ) -> np.ndarray:
        fill_legs(root, quat, ankles, feet, self._height, angles)
        hinges = _within_limits(angles, self._angles)
        return np.concatenate([root, quat[:, 0], hinges], axis=-1)


def _within_limits(angles: np.ndarray, before: np.ndarray | None) -> np.ndarray:
    """Adds full turns to angles ``(T, 33)``, then clips them to their ranges.

    Each pose is brought as near as possible to the one before, the first one to the middle of the
    ranges. Otherwise a joint that leaves its range at one end would come back at the other.

    Args:
        angles: of poses that follow each other.
        before: ``(33,)`` result of the pose before them; None for the first pose of a stream.
    """
    limits = build_body().model.jnt_range[1:]
    last = limits.mean(axis=1) if before is None else before
    found = np.empty_like(angles)
    for row, pose in enumerate(angles):
        near = pose - 2 * np.pi * np.round((pose - last) / (2 * np.pi))
        found[row] = last = np.clip(near, limits[:, 0], limits[:, 1])
    return found
