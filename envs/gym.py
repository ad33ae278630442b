"""The gymnasium environment of one avatar; ``envs.vector`` has that of many."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.utils import EzPickle

from envs.actions import checked_actions
from envs.config import EnvConfig
from envs.core import BatchSim
from envs.info import info_of
from envs.layout import observation_size
from envs.options import Motions, clips_of, config_of
from envs.pictures import Pictures, Window, check_render_mode
from envs.starts_asked import asked_start, check_begun, entropy, seeds_of
from questsim.motion.clip import FPS, Clip


def spaces_of(sim: BatchSim) -> tuple[gym.spaces.Box, gym.spaces.Box]:
    """Observation and action space of one simulation."""
    size = observation_size(sim.layout)
    return (
        gym.spaces.Box(-np.inf, np.inf, (size,), np.float32),
        gym.spaces.Box(-1.0, 1.0, sim.ctrl.shape[1:], np.float32),
    )


class QuestEnv(gym.Env[np.ndarray, np.ndarray], EzPickle):
    """One avatar that follows clips: a batch of one, bit-identical to a row of a larger batch.

    ``info`` of each step and reset: the reward's terms by name, ``error_m``, ``fell``, ``clip`` (an
    index into ``sim.reference.names``, because libraries turn infos into tensors), ``frame``,
    ``floor_m`` (height of the ground under the avatar), ``push_n`` ``(3,)``, ``foot_force_n``
    ``(2, 3)`` of the ground, ``object_pose`` ``(objects, 7)`` and ``object_force_n``
    ``(objects, 3)`` of the avatar on each, all in the world.

    ``reset(options={"clip": name_or_index, "frame": 0})`` starts a given clip; otherwise clip and
    frame are drawn. Copies and pickles are rebuilt from the arguments and need a ``reset``.

    Args:
        motions: a motion argument or clips.
        config: options of the task; keyword options make one, e.g. ``sensors="H"``.
        render_mode: ``"rgb_array"``, ``"human"`` (a window, with pygame) or None.
        seed: random seed. With None each environment draws different episodes until a reset gives
            a seed; what is drawn once per simulation, such as a randomised body, then has seed 0.
        shown: clips that the agent observes, see ``BatchSim``.
        begin_at: estimates in which episodes may begin, see ``BatchSim``.
        **options: fields of ``EnvConfig``, also in the plain forms of ``envs.options``.

    Raises:
        InputError: an argument that cannot be used, in one line.
    """

    metadata: ClassVar[dict[str, Any]] = {  # pyright: ignore[reportIncompatibleVariableOverride]
        "render_modes": ["human", "rgb_array"],
        "render_fps": int(FPS),
    }

    def __init__(
        self,
        motions: Motions = "synthetic",
        config: EnvConfig | None = None,
        render_mode: str | None = None,
        seed: int | None = None,
        shown: Sequence[Any] | None = None,
        begin_at: Mapping[str, Clip] | None = None,
        **options: Any,
    ) -> None:
        EzPickle.__init__(self, motions, config, render_mode, seed, shown, begin_at, **options)
        check_render_mode(render_mode, self.metadata["render_modes"])
        (given,) = seeds_of(seed, 1)
        self.sim = BatchSim(
            clips_of(motions), config_of(config, options), 1, given or 0, 1, shown, begin_at
        )
        self.observation_space, self.action_space = spaces_of(self.sim)
        self.render_mode = render_mode
        # Evaluations (fixed_start) are the same every time.
        self._unseeded = given is None and not self.sim.config.fixed_start
        self._pictures, self._window = Pictures(self.sim), None
        self._begun = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; observation ``(size,)`` and info.

        Raises:
            InputError: a seed or options that cannot be used; the present episode then continues.
        """
        (given,) = seeds_of(seed, 1)
        start = asked_start(self.sim.reference, options)
        super().reset(seed=given)
        if given is None and self._unseeded:
            given = entropy()
        if given is not None:
            self._unseeded = False
            self.sim.seed([given])
        clip, frame = (None, 0) if start is None else start
        self.sim.reset(clip=clip, frame=frame)
        self._begun = True
        self._show()
        return self.sim.observation[0].copy(), info_of(self.sim, fresh=True)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Apply torques ``(33,)`` in [-1, 1] of the joints' limits for 1/36 s.

        Raises:
            InputError: no episode has begun, or an action of another shape, or not finite; nothing
                has moved then.
        """
        check_begun(self._begun)
        sim = self.sim
        sim.step(checked_actions(action, sim.ctrl.shape[1:])[None])
        if sim.fell[0] or sim.ended[0]:
            sim.record_ended(np.zeros(1, np.int64))
        self._show()
        return (
            sim.observation[0].copy(),
            float(sim.reward[0]),
            bool(sim.fell[0]),
            bool(sim.ended[0]),
            info_of(sim, fresh=False),
        )

    def _show(self) -> None:
        if self.render_mode == "human":
            if self._window is None:
                self._window = Window(self.metadata["render_fps"])
            self._window.show(self._pictures.of(0))

    def render(self) -> Any:
        """The avatar as an image ``(480, 640, 3)`` uint8; None without a mode or with a window."""
        return self._pictures.of(0) if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Release the renderer, the window and the threads."""
        self._pictures.close()
        if self._window is not None:
            self._window.close()
        self.sim.close()
