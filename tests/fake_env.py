"""A VecEnv with the interface of envs.QuestVecEnv and a trivial body: joints that coast."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from envs.avatar import avatar_of
from questsim.reward import TERMS
from questsim.skeleton import NUM_DOFS

BLOCKS = {
    "joint_angles": (0, 33),
    "joint_velocities": (33, 66),
    "o_sim": (0, 66),
    "o_user": (66, 99),
    "o_scale": (99, 100),
    "privileged": (100, 166),
    "reference_joint_angles": (100, 133),
    "midway_joint_angles": (100, 133),
    "reference_torques": (133, 166),
}


class FakeVecEnv(VecEnv):
    """Follow a sine by joint: q += 0.2 a + 0.5 qdot. o_user is the next reference, noiseless."""

    torque_limits = np.full(NUM_DOFS, 100.0)
    damping = np.full(NUM_DOFS, 1.0)
    episode_frames = 40
    unstable_count = 0
    avatar = avatar_of(None)

    def __init__(self, num_envs: int = 8, seed: int = 0) -> None:
        self.layout = {name: slice(*block) for name, block in BLOCKS.items()}
        super().__init__(
            num_envs,
            spaces.Box(-np.inf, np.inf, (166,), np.float32),
            spaces.Box(-1.0, 1.0, (NUM_DOFS,), np.float32),
        )
        self.rng = np.random.default_rng(seed)
        self.q = np.zeros((num_envs, NUM_DOFS))
        self.qdot = np.zeros_like(self.q)
        self.frame = np.zeros(num_envs, dtype=int)
        self.phase = np.zeros((num_envs, 1))
        self.episode_return = np.zeros(num_envs)
        self.reward_names = tuple(TERMS)
        self.reward_terms = np.zeros((num_envs, len(TERMS)))
        self.actions = np.zeros((num_envs, NUM_DOFS))

    def reference(self, ahead: int) -> np.ndarray:
        joints = np.arange(NUM_DOFS)
        return 0.5 * np.sin(self.phase + 0.2 * (self.frame[:, None] + ahead) + joints)

    def observe(self) -> np.ndarray:
        future = self.reference(1)
        scale = np.full((self.num_envs, 1), 1.75)
        torques = np.zeros_like(self.q)
        obs = np.concatenate([self.q, self.qdot, future, scale, future, torques], axis=1)
        return obs.astype(np.float32)

    def _restart(self, which: np.ndarray) -> None:
        self.phase[which] = self.rng.uniform(0, 6, (int(which.sum()), 1))
        self.frame[which] = 0
        self.episode_return[which] = 0
        self.q[which] = self.reference(0)[which]
        self.qdot[which] = 0

    def reset(self) -> np.ndarray:
        self._restart(np.ones(self.num_envs, dtype=bool))
        return self.observe()

    def step_async(self, actions: np.ndarray) -> None:
        assert np.abs(actions).max() <= 1.0
        self.actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        self.qdot = 0.2 * self.actions + 0.5 * self.qdot
        self.q = self.q + self.qdot
        self.frame += 1
        error = np.square(self.q - self.reference(0)).mean(1)
        rewards = np.exp(-40 * error).astype(np.float32)
        self.reward_terms[:] = rewards[:, None]
        self.episode_return += rewards
        fell = error > 0.25
        dones = fell | (self.frame >= self.episode_frames)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if dones.any():
            last = self.observe()
            for i in np.flatnonzero(dones):
                infos[i] = {
                    "terminal_observation": last[i],
                    "TimeLimit.truncated": not fell[i],
                    "episode": {"r": float(self.episode_return[i]), "l": int(self.frame[i])},
                    "clip": "sine",
                    "kind": "wave",
                    "fell": bool(fell[i]),
                }
            self._restart(dones)
        return self.observe(), rewards, dones, infos

    def get_state(self) -> dict[str, Any]:
        return {"random": self.rng.bit_generator.state, "failures": np.arange(3.0)}

    def set_state(self, state: dict[str, Any]) -> None:
        self.rng.bit_generator.state = state["random"]

    def close(self) -> None: ...

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kw: Any) -> list[Any]:
        return [getattr(self, method_name)(*args, **kw)]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> Sequence[bool]:  # type: ignore
        return [False] * self.num_envs
