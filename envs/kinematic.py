"""The same task for systems that answer with a pose instead of torques."""

from __future__ import annotations

import gymnasium as gym
import numpy as np

from envs.config import EnvConfig
from envs.gym import POSE_SIZE, Motions, load_clips
from envs.sb3 import QuestVecEnv
from questsim.errors import InputError


class KinematicVecEnv(QuestVecEnv):
    """Avatars that take the pose they are given, without physics, scored as the others are.

    Actions are poses ``(n, 40)`` of the next frame: MuJoCo's ``qpos`` of the avatar. Contact
    forces are zero, velocities the differences of poses.

    Args:
        motions: a motion argument or clips.
        config, num_envs, seed, num_threads: as of ``QuestVecEnv``.
    """

    def __init__(
        self,
        motions: Motions,
        config: EnvConfig | None = None,
        num_envs: int | None = None,
        seed: int = 0,
        num_threads: int = 1,
    ) -> None:
        super().__init__(load_clips(motions), config, num_envs, seed, num_threads)
        self.action_space = gym.spaces.Box(-np.inf, np.inf, (POSE_SIZE,), np.float32)
        self._pose = np.zeros((self.num_envs, POSE_SIZE))

    def step_async(self, actions: np.ndarray) -> None:
        """Take the poses ``(n, 40)`` of the next frame.

        Raises:
            InputError: a pose is not finite, or a quaternion is zero.
        """
        poses = np.asarray(actions, float)
        if poses.shape != self._pose.shape or not np.isfinite(poses).all():
            raise InputError(f"poses {poses.shape} are not finite {self._pose.shape}", "action")
        norm = np.linalg.norm(poses[:, 3:7], axis=-1, keepdims=True)
        if (norm < 1e-6).any():
            raise InputError("a root quaternion is zero", "action")
        self._pose[:] = poses
        self._pose[:, 3:7] /= norm

    def _advance(self) -> None:
        self.sim.show(self._pose)
