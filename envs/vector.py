"""The gymnasium vector environment of many avatars, without a Python loop over them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.utils import EzPickle
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from envs.actions import checked_actions
from envs.checks import check_count
from envs.config import EnvConfig
from envs.core import BatchSim
from envs.gym import spaces_of
from envs.info import info_arrays, masked
from envs.options import Motions, clips_of, config_of
from envs.pictures import Pictures, check_render_mode
from envs.starts_asked import (
    asked_start,
    check_begun,
    entropy,
    reset_mask,
    seeds_of,
    split_options,
)
from questsim.errors import InputError
from questsim.motion.clip import FPS, Clip


class QuestVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray], EzPickle):
    """Many avatars as a gymnasium vector environment.

    ``infos`` hold the keys of ``QuestEnv`` as arrays ``(n, ...)``, each with a mask under its name
    with a leading underscore. ``autoreset_mode`` decides when an ended episode is replaced:

    - ``NEXT_STEP``, gymnasium's default: the next step begins a new episode; it ignores the action
      of that environment and returns reward 0.
    - ``SAME_STEP``: the same step begins a new episode; ``final_obs`` and ``final_info`` belong to
      the old one.
    - ``DISABLED``: call ``reset(options={"reset_mask": ended})`` before the next step.

    Args:
        num_envs: simulations.
        motions, config, shown, begin_at, **options: as of ``QuestEnv``.
        seed: random seed; with None each environment draws different episodes until a reset gives
            a seed.
        num_threads: of physics; results do not depend on it.
        render_mode: ``"rgb_array"`` or None.
        autoreset_mode: one of gymnasium's ``AutoresetMode``, or its name.

    Raises:
        InputError: an argument that cannot be used, in one line.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 -- gymnasium's type
        "render_modes": ["rgb_array"],
        "render_fps": int(FPS),
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        motions: Motions = "synthetic",
        config: EnvConfig | None = None,
        seed: int | None = None,
        num_threads: int = 1,
        render_mode: str | None = None,
        shown: Sequence[Any] | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        begin_at: Mapping[str, Clip] | None = None,
        **options: Any,
    ) -> None:
        EzPickle.__init__(
            self, num_envs, motions, config, seed, num_threads, render_mode, shown,
            autoreset_mode, begin_at, **options,
        )  # fmt: skip
        check_render_mode(render_mode, self.metadata["render_modes"])
        self.autoreset_mode = _autoreset(autoreset_mode)
        given = seeds_of(seed, 1)[0]
        clips, task = clips_of(motions), config_of(config, options)
        check_count("num_envs", num_envs)
        self.sim = BatchSim(clips, task, num_envs, given or 0, num_threads, shown, begin_at)
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = spaces_of(self.sim)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.render_mode = render_mode
        self.metadata = self.metadata | {"autoreset_mode": self.autoreset_mode}
        self._unseeded = given is None and not task.fixed_start
        self._pictures = Pictures(self.sim)
        self._begun, self._over = np.zeros(num_envs, bool), np.zeros(num_envs, bool)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin episodes; observations ``(n, size)`` and infos.

        Args:
            seed: environment ``i`` gets ``seed + i``, or the i-th of a sequence.
            options: ``clip`` and ``frame`` for all, or sequences with one for each; ``reset_mask``
                ``(n,)`` bool selects the simulations to reset.

        Raises:
            InputError: seeds or options that cannot be used; all episodes then continue.
        """
        n = self.num_envs
        seeds, mask = seeds_of(seed, n), reset_mask(options, n)
        starts = [
            asked_start(self.sim.reference, each) if mask[i] else None
            for i, each in enumerate(split_options(options, n))
        ]
        seeds = [each if begins else None for each, begins in zip(seeds, mask, strict=True)]
        if self._unseeded and any(each is None for each in seeds):
            self.sim.seed(entropy())
        self._unseeded = False
        if any(each is not None for each in seeds):
            super().reset(seed=next(each for each in seeds if each is not None))
            self.sim.seed(seeds)
        self._begin(mask, starts)
        self._begun[mask], self._over[mask] = True, False
        infos = masked(info_arrays(self.sim, mask), mask)
        return self.sim.observation.copy(), infos

    def _begin(self, mask: np.ndarray, starts: Sequence[tuple[int, int] | None]) -> None:
        drawn = np.array([begins and s is None for begins, s in zip(mask, starts, strict=True)])
        if drawn.any():
            self.sim.reset(np.flatnonzero(drawn))
        for i, start in enumerate(starts):
            if start is not None:
                self.sim.reset(np.array([i]), *start)

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Apply torques ``(n, 33)`` for 1/36 s.

        Raises:
            InputError: no episode has begun, actions of another shape, or not finite, or an ended
                episode that ``DISABLED`` leaves to ``reset``; nothing has moved then.
        """
        check_begun(bool(self._begun.all()))
        sim, before = self.sim, self._over
        if self.autoreset_mode == AutoresetMode.DISABLED and before.any():
            raise InputError(
                f"the episode of environment {int(before.argmax())} is over",
                "step",
                "reset it with options={'reset_mask': terminated | truncated}",
            )
        actions = checked_actions(actions, self.action_space.shape, "actions")  # type: ignore[arg-type]
        sim.step(actions)
        if before.any():  # NEXT_STEP: their episodes were over, and this step begins new ones
            sim.reset(np.flatnonzero(before))
        fell, ended = sim.fell & ~before, sim.ended & ~before
        reward = np.where(before, 0.0, sim.reward)
        over = fell | ended
        infos = info_arrays(sim, before)
        if over.any():
            sim.record_ended(np.flatnonzero(over))
            if self.autoreset_mode == AutoresetMode.SAME_STEP:
                infos = self._begin_again(infos, over)
        if self.autoreset_mode != AutoresetMode.SAME_STEP:
            self._over = over
            infos = masked(infos, np.ones(self.num_envs, bool))
        elif "final_obs" not in infos:
            infos = masked(infos, np.ones(self.num_envs, bool))
        return sim.observation.copy(), reward, fell, ended, infos

    def _begin_again(self, infos: dict[str, Any], over: np.ndarray) -> dict[str, Any]:
        final = np.full(self.num_envs, None, dtype=object)
        for i in np.flatnonzero(over):
            final[i] = self.sim.observation[i].copy()
        self.sim.reset(np.flatnonzero(over))
        last = masked({"final_obs": final, "final_info": masked(infos, over)}, over)
        return masked(info_arrays(self.sim, over), np.ones(self.num_envs, bool)) | last

    def render(self) -> tuple[np.ndarray, ...] | None:
        """An image ``(480, 640, 3)`` uint8 of each avatar, or None without a render mode."""
        if self.render_mode is None:
            return None
        return tuple(self._pictures.of(i) for i in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Release the renderers and the simulation's threads."""
        self._pictures.close()
        self.sim.close()


def _autoreset(mode: Any) -> AutoresetMode:
    for known in AutoresetMode:
        if mode is known or (isinstance(mode, str) and mode in (known.name, known.value)):
            return known
    names = ", ".join(known.name for known in AutoresetMode)
    what = f"{str(mode)[:80]!r} is not an autoreset mode"
    raise InputError(what, "autoreset_mode", f"use {names}")
