"""One avatar that follows a stream: device or full-body poses arrive frame by frame.

``BatchSim`` reads whole clips. Here the rows of its reference are a window that advances by one
frame before each step. Time per step and memory are constant, however long the stream is.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from envs.config import EnvConfig
from envs.core import BatchSim
from envs.object_places import CLEARANCE_M
from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M
from questsim.motion.clip import Clip
from questsim.motion.kinematics import standing_clip
from questsim.sensors import sensor_set
from questsim.skeleton import NUM_DOFS

NOW = 2
"""Row of the window that is the avatar's present."""
AHEAD = 6
"""Rows after the present: the longest look-ahead of any agent."""
_ROWS = NOW + AHEAD + 1
_POSITIONS, _VELOCITIES = 7 + NUM_DOFS, 6 + NUM_DOFS


class StreamSim(BatchSim):
    """One avatar, one user, and a window of the user's past and future frames.

    Coordinates are those of the world, but heights of devices and poses are above the user's own
    level floor: a terrain lifts only the avatar.

    Args:
        config: config of the agent; ``heights`` and ``fixed_start`` are overwritten.
        height_m: the avatar's stature.
    """

    def __init__(self, config: EnvConfig, height_m: float) -> None:
        options = replace(config, heights=(height_m, height_m), fixed_start=True)
        super().__init__([standing_clip(height_m, _ROWS)], options, 1)
        self.device_names = sensor_set(config.sensors)
        self._objects_anew = True
        self.newest_row = NOW + config.frame_offsets[-1]
        self.reset()

    @property
    def height_m(self) -> float:
        """The avatar's stature."""
        return float(self.heights[0])

    def put(self, qpos: np.ndarray, qvel: np.ndarray | None = None) -> None:
        """Set the avatar's pose, given above level ground; the terrain lifts it.

        Objects are placed before the first pose, and stay where they are in later ones.

        Args:
            qpos: ``(40,)``.
            qvel: ``(39,)``; at rest if None.
        """
        before = None if self._objects_anew else self.objects.pose.copy()
        self.reset()
        # The user's coordinates are the world's, so the clip is not moved to a place.
        self.placement.place[:] = 0.0, 0.0, 1.0, 0.0
        self.qpos[0, :_POSITIONS] = qpos
        self.qvel[0, :_VELOCITIES] = 0.0 if qvel is None else qvel
        self._put_objects(before)
        if self.placement.field is not None:
            self.batch.forward(stage=int(mujoco.mjtStage.mjSTAGE_POS.value))
            self.qpos[0, 2] += max(-float(self.foot_clearance.min()), 0.0)
        self.batch.forward(stage=int(mujoco.mjtStage.mjSTAGE_VEL.value))
        self.look()

    def _put_objects(self, before: np.ndarray | None) -> None:
        """Objects stay where they were, unless they are in the way of the avatar's new place."""
        if not self.config.objects:
            return
        self._objects_anew = False
        spot, yaw = self.qpos[0, :2], float(rot.heading(self.qpos[0, 3:7]))
        if before is not None:
            apart = np.linalg.norm(before[0, :, :2] - spot, axis=-1)
            if np.isfinite(before).all() and apart.min() > CLEARANCE_M:
                self.objects.pose[:] = before
                return
        ahead = np.array([np.cos(yaw), np.sin(yaw)])
        self.objects.place_before(spot, ahead, self.placement.field)

    def show_devices(self, position: np.ndarray, quat: np.ndarray, fill: bool = False) -> None:
        """Advance the window by one frame and write the newest poses of the devices.

        Args:
            position: ``(D, 3)`` metres, of ``device_names``.
            quat: ``(D, 4)``.
            fill: write them to the whole window, at the beginning of a stream.
        """
        reference = self.reference
        for rows, newest in (
            (reference.dev_position, position / (self.height_m / DEFAULT_HEIGHT_M)),
            (reference.dev_quat, quat),
        ):
            if fill:
                rows[:] = newest
            else:
                rows[:-1] = rows[1:].copy()
                rows[self.newest_row :] = newest

    def shown_devices(self, row: int = NOW) -> tuple[np.ndarray, np.ndarray]:
        """Device poses of a frame of the window: ``(D, 3)`` in the world, ``(D, 4)``.

        Args:
            row: of the window; the avatar's present before a step. After it, that is ``NOW + 1``.
        """
        position = self.reference.dev_position[row].astype(float) * (
            self.height_m / DEFAULT_HEIGHT_M
        )
        position[:, 2] += self.floor[0]
        return position, self.reference.dev_quat[row].astype(float)

    def show_pose(
        self, clip: Clip, row: int, torque: np.ndarray | None, fill: bool = False
    ) -> None:
        """Advance the window by one frame and write the newest full-body pose of the user.

        Args:
            clip: a clip of any stature, on level ground; only one row is read.
            row: the row to read.
            torque: ``(33,)`` torques of the frame before it, as shares of the joints' limits.
            fill: write it to the whole window, at rest, at the beginning of a stream.
        """
        ratio, reference = clip.height_m / DEFAULT_HEIGHT_M, self.reference
        scale_root = np.ones(_POSITIONS)
        scale_root[:3] = 1.0 / ratio
        fields = (
            (reference.qpos, clip.qpos[row] * scale_root),
            (reference.qvel, clip.qvel[row] * scale_root[:_VELOCITIES]),
            (reference.position, clip.link_position[row] / ratio),
            (reference.quat, clip.link_quat[row]),
            (reference.velocity, clip.link_velocity[row] / ratio),
            (reference.angular_velocity, clip.link_angular_velocity[row]),
        )
        at = NOW + AHEAD - 1
        for number, (rows, newest) in enumerate(fields):
            if fill:
                rows[:] = 0.0 if number in (1, 4, 5) else newest
            else:
                rows[:-1] = rows[1:].copy()
                rows[at:] = newest
        if len(reference.torque) and not fill:
            reference.torque[:-1] = reference.torque[1:].copy()
            reference.torque[at - 1 :] = 0.0 if torque is None else torque
        elif len(reference.torque):
            reference.torque[:] = 0.0

    def shown_pose(self, row: int = NOW + 1) -> tuple[np.ndarray, np.ndarray]:
        """``qpos`` ``(40,)`` and ``qvel`` ``(39,)`` of a row of the window, over a level floor.

        Args:
            row: of the window; as of ``shown_devices``, by default the present after a step.
        """
        ratio = self.height_m / DEFAULT_HEIGHT_M
        qpos = self.reference.qpos[row].astype(float)
        qvel = self.reference.qvel[row].astype(float)
        qpos[:3] *= ratio
        qvel[:3] *= ratio
        return qpos, qvel

    def look(self) -> np.ndarray:
        """Observe the present state and the window; ``observation``, ``(1, size)``."""
        self.frame[:] = NOW
        self._runner.fill_targets(self._all)
        self._runner.observe(self._all)
        return self.observation
