"""The stable-baselines3 VecEnv of the batch, without a Python loop over environments."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import EzPickle
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from envs.actions import checked_actions
from envs.config import EnvConfig
from envs.core import BatchSim
from envs.gym import spaces_of
from envs.options import Motions, clips_of, config_of
from envs.pictures import Pictures, check_render_mode
from envs.starts_asked import asked_start, check_begun, entropy, seeds_of
from questsim.errors import InputError
from questsim.motion.clip import Clip


class QuestVecEnv(VecEnv, EzPickle):
    """The avatars of a ``BatchSim`` as a VecEnv; ended episodes are reset automatically.

    ``infos[i]`` is empty except at an episode's end. Then it holds ``terminal_observation``,
    ``TimeLimit.truncated``, ``episode`` (``r``, ``l``, ``t``), ``clip``, ``kind``, ``fell`` and
    the mean of each reward term by name. The terms of each step are in ``reward_terms``
    ``(n, terms)``, in the order of ``reward_names``.

    Copies and pickles are rebuilt from the arguments and need a ``reset``.

    Args:
        motions: a motion argument or clips.
        config: options of the task; keyword options make one, e.g. ``sensors="H"``.
        num_envs, num_threads, shown, begin_at: as of ``BatchSim``.
        seed: random seed; with None each VecEnv draws different episodes until ``seed`` is called.
        render_mode: ``"rgb_array"`` or None.
        **options: fields of ``EnvConfig``, also in the plain forms of ``envs.options``.

    Raises:
        InputError: an argument that cannot be used, in one line.
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
        EzPickle.__init__(
            self, motions, config, num_envs, seed, num_threads, shown, render_mode, begin_at,
            **options,
        )  # fmt: skip
        check_render_mode(render_mode, ["rgb_array"])
        self.render_mode, given = render_mode, seeds_of(seed, 1)[0]
        clips, task = clips_of(motions), config_of(config, options)
        self.sim = BatchSim(clips, task, num_envs, given or 0, num_threads, shown, begin_at)
        self.clips = list(clips)
        self._begin_at = begin_at
        self._num_threads = num_threads
        self._unseeded = given is None and not task.fixed_start
        self._pictures = Pictures(self.sim)
        VecEnv.__init__(self, self.sim.num_envs, *spaces_of(self.sim))
        self._action = np.zeros(self.sim.ctrl.shape)
        self._return = np.zeros(self.sim.num_envs)
        self._length = np.zeros(self.sim.num_envs, np.int64)
        self._terms = np.zeros_like(self.sim.reward_terms)
        self._began = time.perf_counter()
        self._begun, self._restored = False, False

    def __getattr__(self, name: str) -> Any:
        """Forward other attributes to the simulation: layout, link_positions, reward_terms, ..."""
        if name == "sim" or name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.sim, name)

    @property
    def torque_limits(self) -> np.ndarray:
        """``(33,)`` N m of the 1.75 m body."""
        return self.sim.body.torque_limits

    @property
    def damping(self) -> np.ndarray:
        """``(33,)`` N m s/rad of the 1.75 m body."""
        return self.sim.body.damping

    def change_clips(self, clips: Sequence[Clip], seed: int) -> None:
        """Replace the clips; ``reset`` then begins episodes of the new ones.

        Args:
            clips: the new clips.
            seed: random seed from now on.

        Raises:
            InputError: the clips cannot be played.
        """
        sim = BatchSim(
            clips, self.sim.config, self.num_envs, seed, self._num_threads, begin_at=self._begin_at
        )
        self.sim.close()
        self.clips, self.sim, self._pictures = list(clips), sim, Pictures(sim)
        self._begun, self._restored = False, False

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seeds of the next ``reset``: environment ``i`` gets ``seed + i``.

        Raises:
            InputError: the seed is no whole number from 0 on.
        """
        seeds_of(seed, 1)
        return super().seed(seed)

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Set the options of the next ``reset``: for all, or a list with one for each environment.

        Raises:
            InputError: neither a dict nor a list with one for each environment.
        """
        if options is not None and not isinstance(options, dict):
            if not isinstance(options, list):
                what = (
                    f"is of the type {type(options).__name__}, neither a dict nor a list of dicts"
                )
                raise InputError(what, "options")
            if len(options) != self.num_envs:
                what = f"has {len(options)} entries for {self.num_envs} simulations"
                raise InputError(what, "options")
        super().set_options(options)

    def reset(self) -> np.ndarray:
        """Begin an episode in every environment; observations ``(n, size)``.

        The first reset after ``set_state`` begins no episode: the restored episodes continue.
        """
        if self._restored:
            self._restored = False
            return self.sim.observation.copy()
        starts = [
            asked_start(self.sim.reference, each or None, f"options[{i}]")
            for i, each in enumerate(self._options)
        ]
        seeds = seeds_of(self._seeds, self.num_envs)
        if self._unseeded and None in seeds:
            self.sim.seed(entropy())
        self._unseeded = False
        if any(seed is not None for seed in seeds):
            self.sim.seed(seeds)
        self._reset_seeds()
        self._reset_options()
        self.sim.reset()
        for i, start in enumerate(starts):
            if start is not None:
                self.sim.reset(np.array([i]), *start)
        self._return[:], self._length[:], self._terms[:] = 0.0, 0, 0.0
        self._begun = True
        return self.sim.observation.copy()

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Step all environments: observations, rewards, dones and infos."""
        self.step_async(actions)
        return self.step_wait()

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions ``(n, 33)`` of the next step.

        Raises:
            InputError: actions of another shape, or not finite.
        """
        self._action[:] = checked_actions(actions, self._action.shape)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Step; see the class for what infos hold."""
        check_begun(self._begun)
        sim = self.sim
        self._advance()
        self._return += sim.reward
        self._length += 1
        self._terms += sim.reward_terms
        done = sim.fell | sim.ended
        reward = sim.reward.astype(np.float32)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ids = np.flatnonzero(done)
        if len(ids):
            self._end_episodes(ids, infos)
        return sim.observation.copy(), reward, done, infos

    def _advance(self) -> None:
        self.sim.step(self._action)

    def _end_episodes(self, ids: np.ndarray, infos: list[dict[str, Any]]) -> None:
        sim = self.sim
        elapsed = round(time.perf_counter() - self._began, 6)
        for i in ids:
            clip = sim.clip[i]
            terms = (self._terms[i] / self._length[i]).tolist()
            infos[i] = {
                "terminal_observation": sim.observation[i].copy(),
                "TimeLimit.truncated": bool(sim.ended[i]),
                "episode": {
                    "r": float(self._return[i]),
                    "l": int(self._length[i]),
                    "t": elapsed,
                },
                "clip": sim.reference.names[clip],
                "kind": sim.reference.kinds[clip],
                "fell": bool(sim.fell[i]),
                **dict(zip(sim.reward_names, terms, strict=True)),
            }
        sim.record_ended(ids)
        sim.reset(ids)
        self._return[ids], self._length[ids], self._terms[ids] = 0.0, 0, 0.0

    def get_state(self) -> dict[str, Any]:
        """State that determines all later steps, to resume a training."""
        sums = {"returns": self._return, "lengths": self._length, "terms": self._terms}
        return self.sim.get_state() | {name: value.copy() for name, value in sums.items()}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore the result of ``get_state``. ``reset`` then returns the observation.

        Raises:
            InputError: the state has a different number of environments.
        """
        self.sim.set_state(state)
        self._unseeded = False
        # A pending seed would overwrite the restored random numbers at the next reset.
        self._reset_seeds()
        self._return[:], self._length[:] = state["returns"], state["lengths"]
        self._terms[:] = state["terms"]
        self._begun, self._restored = True, True

    def get_images(self) -> Sequence[np.ndarray | None]:
        """An image ``(480, 640, 3)`` uint8 of each avatar; None without a render mode."""
        if self.render_mode is None:
            return [None] * self.num_envs
        return [self._pictures.of(i) for i in range(self.num_envs)]

    def close(self) -> None:
        """Release the renderers and the simulation's threads."""
        self._pictures.close()
        self.sim.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute of the whole batch, repeated for each requested environment."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the whole batch."""
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Call a method of the whole batch once; repeat its result for each environment."""
        result = getattr(self, method_name)(*args, **kwargs)
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Nothing wraps an environment inside the batch; VecMonitor is not needed."""
        return [False for _ in self._get_indices(indices)]
