"""gymnasium's faces of the batch: one avatar, or many as a vector environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from envs.config import EnvConfig, config_from
from envs.core import BatchSim
from envs.layout import observation_size
from questsim.errors import InputError
from questsim.motion.clip import Clip
from questsim.skeleton import NUM_DOFS

POSE_SIZE = 7 + NUM_DOFS
"""Root position (m), root quaternion wxyz, 33 joint angles (rad), in the world."""

Motions = str | Sequence[Clip]
"""What to follow: clips, or a motion argument such as ``"bandai-namco-2:train"``."""


def load_clips(motions: Motions) -> Sequence[Clip]:
    """Clips as they are, or those that a motion argument names."""
    if isinstance(motions, str):
        from questsim.motion.spec import load_motions

        return load_motions(motions)
    return motions


def _spaces(sim: BatchSim) -> tuple[gym.spaces.Box, gym.spaces.Box]:
    size = observation_size(sim.layout)
    return (
        gym.spaces.Box(-np.inf, np.inf, (size,), np.float32),
        gym.spaces.Box(-1.0, 1.0, (NUM_DOFS,), np.float32),
    )


class QuestEnv(gym.Env[np.ndarray, np.ndarray]):
    """One avatar that follows clips: a batch of one, bit-identical to a row of a larger batch.

    ``info`` of each step: the reward's terms by name, ``error_m``, ``clip``, ``frame``, ``fell``,
    ``floor_m`` (height of the ground under the avatar), ``push_n`` ``(3,)``, ``foot_force_n``
    ``(2, 3)`` of the ground, ``object_pose`` ``(objects, 7)`` and ``object_force_n``
    ``(objects, 3)`` of the avatar on each, all in the world.
    ``reset(options={"clip": name_or_index, "frame": 0})`` starts a given clip.

    Args:
        motions: a motion argument or clips.
        config: options of the task; keyword options make one, e.g. ``sensors="H"``.
        render_mode: ``"rgb_array"`` or None.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 36}

    def __init__(
        self,
        motions: Motions = "synthetic",
        config: EnvConfig | None = None,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(f"unknown render mode {render_mode!r}", fix="use 'rgb_array'")
        self.sim = BatchSim(load_clips(motions), config or config_from(options), num_envs=1)
        self.observation_space, self.action_space = _spaces(self.sim)
        self.render_mode = render_mode
        self._renderer: Any = None
        self._azimuth = 0.0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; observation ``(size,)`` and info."""
        super().reset(seed=seed)
        if seed is not None:
            self.sim.seed(seed)
        options = options or {}
        clip = options.get("clip")
        self.sim.reset(
            clip=None if clip is None else self._clip_index(clip),
            frame=int(options.get("frame", 0)),
        )
        return self.sim.observation[0].copy(), self._info()

    def _clip_index(self, clip: str | int) -> int:
        names = self.sim.reference.names
        if isinstance(clip, str):
            if clip not in names:
                raise InputError(f"no clip is named {clip!r}", "reset options")
            return names.index(clip)
        if not 0 <= clip < len(names):
            raise InputError(f"clip {clip} is not one of {len(names)}", "reset options")
        return int(clip)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Apply torques ``(33,)`` in [-1, 1] of the joints' limits for 1/36 s."""
        sim = self.sim
        sim.step(np.asarray(action, float)[None])
        if sim.fell[0] or sim.ended[0]:
            sim.record_ended(np.zeros(1, np.int64))
        return (
            sim.observation[0].copy(),
            float(sim.reward[0]),
            bool(sim.fell[0]),
            bool(sim.ended[0]),
            self._info(),
        )

    def _info(self) -> dict[str, Any]:
        sim = self.sim
        clip = int(sim.clip[0])
        return {
            **{term: float(sim.reward_terms[0, i]) for i, term in enumerate(sim.reward_names)},
            "error_m": float(sim.error[0]),
            "clip": sim.reference.names[clip],
            "frame": int(sim.frame[0] - sim.reference.start[clip]),
            "fell": bool(sim.fell[0]),
            "floor_m": float(sim.floor[0]),
            "push_n": sim.pusher.force[0].copy(),
            "foot_force_n": sim.contact_force[0].copy(),
            "object_pose": sim.objects.pose[0].copy(),
            "object_force_n": sim.objects.force[0].copy(),
        }

    def render(self) -> Any:
        """The avatar as an image ``(480, 640, 3)`` uint8, or None without a render mode."""
        if self.render_mode is None:
            return None
        from questsim.viewing.camera import Camera, three_quarter_azimuth
        from questsim.viewing.render import Figure, SceneRenderer

        pose, height = self.sim.qpos[0, :POSE_SIZE], float(self.sim.heights[0])
        if self._renderer is None:
            field = self.sim.placement.field
            self._renderer = SceneRenderer([Figure(height)], ground=field)
            self._azimuth = three_quarter_azimuth(pose[None, 3:7])
        lookat = np.array([pose[0], pose[1], self.sim.floor[0] + height / 2.0])
        return self._renderer.render([pose], Camera(lookat, 2.0 * height, self._azimuth))

    def close(self) -> None:
        """Release the renderer and the threads."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        self.sim.close()


class QuestVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Many avatars as a gymnasium vector environment, without a loop over them.

    An ended episode begins anew in the same step; ``infos["final_obs"]`` then holds the last
    observation of the old one (``AutoresetMode.SAME_STEP``).

    Args:
        num_envs: simulations.
        motions: a motion argument or clips.
        config: options of the task; keyword options make one, e.g. ``sensors="H"``.
        seed, num_threads: as of ``BatchSim``.
    """

    metadata: ClassVar[dict[str, Any]] = {"autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(
        self,
        num_envs: int = 1,
        motions: Motions = "synthetic",
        config: EnvConfig | None = None,
        seed: int = 0,
        num_threads: int = 1,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        if render_mode is not None:
            raise InputError("vector environments do not render", "render_mode", "render one")
        clips = load_clips(motions)
        self.sim = BatchSim(clips, config or config_from(options), num_envs, seed, num_threads)
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = _spaces(self.sim)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.render_mode = None

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode everywhere; observations ``(n, size)``."""
        first = seed[0] if isinstance(seed, list) else seed
        super().reset(seed=first)
        if first is not None:
            self.sim.seed(first)
        self.sim.reset()
        return self.sim.observation.copy(), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Apply torques ``(n, 33)``; infos hold what ``QuestEnv``'s do, as arrays."""
        sim = self.sim
        sim.step(np.asarray(actions, float))
        fell, ended, reward = sim.fell.copy(), sim.ended.copy(), sim.reward.copy()
        infos: dict[str, Any] = {
            term: sim.reward_terms[:, i].copy() for i, term in enumerate(sim.reward_names)
        }
        infos |= {
            "error_m": sim.error.copy(),
            "fell": fell,
            "floor_m": sim.floor.copy(),
            "push_n": sim.pusher.force.copy(),
            "foot_force_n": sim.contact_force.copy(),
            "object_pose": sim.objects.pose.copy(),
            "object_force_n": sim.objects.force.copy(),
        }
        ids = np.flatnonzero(fell | ended)
        if len(ids):
            final = np.full(self.num_envs, None, dtype=object)
            for i in ids:
                final[i] = sim.observation[i].copy()
            infos |= {"final_obs": final, "_final_obs": fell | ended}
            sim.record_ended(ids)
            sim.reset(ids)
        return sim.observation.copy(), reward, fell, ended, infos

    def close_extras(self, **kwargs: Any) -> None:
        """Stop the simulation's threads."""
        self.sim.close()
