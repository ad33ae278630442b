"""The same task for systems whose action is a pose instead of torques."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from envs.actions import checked_actions
from envs.config import EnvConfig
from envs.options import Motions
from envs.pictures import POSE_SIZE
from envs.sb3 import QuestVecEnv
from questsim.errors import InputError
from questsim.motion.clip import Clip


class KinematicVecEnv(QuestVecEnv):
    """Avatars set to given poses, without physics; scored like simulated avatars.

    Actions are poses ``(n, 40)`` of the next frame: MuJoCo's ``qpos`` of the avatar. Contact
    forces are zero; velocities are finite differences of poses.

    Args:
        motions, config, num_envs, seed, num_threads, shown, render_mode, **options: as of
            ``QuestVecEnv``.
    """

    def __init__(
        self,
        motions: Motions = "synthetic",
        config: EnvConfig | None = None,
        num_envs: int | None = None,
        seed: int | None = None,
        num_threads: int = 1,
        shown: Sequence[Clip] | None = None,
        render_mode: str | None = None,
        begin_at: Mapping[str, Clip] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(
            motions, config, num_envs, seed, num_threads, shown, render_mode, begin_at, **options
        )
        self.action_space = gym.spaces.Box(-np.inf, np.inf, (POSE_SIZE,), np.float32)
        self._pose = np.zeros((self.num_envs, POSE_SIZE))

    def step_async(self, actions: np.ndarray) -> None:
        """Set the poses ``(n, 40)`` of the next frame.

        Raises:
            InputError: a pose is not finite, or a quaternion is zero.
        """
        poses = checked_actions(actions, self._pose.shape, "poses").astype(float)
        norm = np.linalg.norm(poses[:, 3:7], axis=-1, keepdims=True)
        if (norm < 1e-6).any():
            raise InputError("a root quaternion is zero", "poses")
        self._pose[:] = poses
        self._pose[:, 3:7] /= norm

    def _advance(self) -> None:
        self.sim.show(self._pose)
