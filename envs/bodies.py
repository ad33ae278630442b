"""The bodies of a batch: stature and proportions of each simulation, and their models."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from envs.avatar import Avatar
from envs.config import EnvConfig
from envs.episode_random import within
from envs.randomisation import Randomisation, varied_models
from envs.world import build_own_world, build_world
from questsim.body import MAX_HEIGHT_M, MIN_HEIGHT_M, Body
from questsim.body_proportions import PARTS, Proportions, drawn_proportions
from questsim.errors import InputError
from questsim.motion.clip import Clip

MOST_DRAWN = 8
"""At most this many different proportions are drawn for a batch."""


def on_their_bodies(clips: Sequence[Clip], config: EnvConfig, count: int, seed: int) -> list[Clip]:
    """The clips on the bodies that play them: with ``config.proportions``, drawn ones in turn.

    Args:
        clips: the motions.
        config: options of the task.
        count: number of simulations.
        seed: of the drawing.

    Raises:
        InputError: proportions are drawn for clips that have their own.
    """
    if config.proportions == 0.0:
        return list(clips)
    from questsim.motion.reproportion import with_proportions  # late: few tasks draw proportions

    for clip in clips:
        if clip.proportions is not None:
            what = "the clip has its performer's proportions, so none can be drawn"
            raise InputError(what, clip.name, "leave out proportions")
    people = min(MOST_DRAWN, len(clips), len(clips) if config.fixed_start else count)
    drawn = drawn_proportions(config.proportions, people, seed)
    return [with_proportions(clip, drawn[i % people]) for i, clip in enumerate(clips)]


class Bodies:
    """Bodies of ``n`` simulations; each plays only the clips of its own proportions.

    Args:
        clips: on their bodies.
        config: options of the task.
        count: number of simulations.
        heights: ``(C,)`` stature of each clip's person.
        seed: of what is drawn.

    Attributes:
        of_clip, of_sim: ``(C,)``, ``(n,)`` which of the different proportions each has.
        proportions: of each simulation; None for the default body's.
        heights, user_heights: ``(n,)`` stature in metres of each avatar and of its user.

    Raises:
        InputError: there are more different proportions than simulations, or ``unscaled_m`` leads
            to statures that our body does not have.
    """

    def __init__(
        self, clips: Sequence[Clip], config: EnvConfig, count: int, heights: np.ndarray, seed: int
    ) -> None:
        kinds = list(dict.fromkeys(clip.proportions for clip in clips))
        number = {body: k for k, body in enumerate(kinds)}
        self._names = [clip.name for clip in clips]
        self.of_clip = np.array([number[clip.proportions] for clip in clips])
        if config.fixed_start:
            self.of_sim = self.of_clip[:count]
        elif len(kinds) > count:
            raise InputError(
                f"the clips are of {len(kinds)} bodies of different proportions, which {count} "
                "simulations cannot have",
                "motions",
                "use more simulations, or the clips of one person",
            )
        else:
            self.of_sim = np.arange(count) % len(kinds)
        self.proportions = tuple(kinds[k] for k in self.of_sim)
        if any(kinds) and (config.terrain is not None or config.body is not None):
            what = "clips of other proportions than the default body's stand on a plane"
            raise InputError(what, "EnvConfig", "leave out terrain and body")
        taller = config.unscaled_m + _drawn_differences(config.randomisation, count, seed)
        self.heights = self._spread(config, heights, taller)
        self.user_heights = self.heights - taller
        if taller.any():
            _check_heights("avatars", self.heights)
            _check_heights("users", self.user_heights)

    @property
    def differ(self) -> bool:
        """Whether simulations have bodies of different proportions."""
        return bool(self.of_clip.any())

    def _spread(self, config: EnvConfig, heights: np.ndarray, taller: np.ndarray) -> np.ndarray:
        count = len(self.of_sim)
        if config.heights is not None:
            if count == 1:
                return np.array([np.mean(config.heights)])
            return np.round(np.linspace(*config.heights, count), 2)
        # Spread evenly over the clips, so that a few environments still cover all statures.
        out = np.zeros(count)
        for kind in np.unique(self.of_sim):
            sims, clips = (np.flatnonzero(of == kind) for of in (self.of_sim, self.of_clip))
            out[sims] = heights[clips[np.arange(len(sims)) * len(clips) // len(sims)]]
        return out + taller

    def scale(self, config: EnvConfig) -> np.ndarray:
        """``o_scale`` of each simulation: the stature, and the parts if they are observed."""
        if not config.observe_proportions:
            return self.heights[:, None].copy()
        parts = [(body or Proportions()).parts() for body in self.proportions]
        return np.column_stack([self.heights, [[p[name] for name in PARTS] for p in parts]])

    def check_plays(self, ids: np.ndarray, clip: int) -> None:
        """Refuse a clip that is for another body than that of a simulation.

        Raises:
            InputError: names clip and simulation.
        """
        wrong = ids[self.of_sim[ids] != self.of_clip[clip]]
        if len(wrong):
            raise InputError(
                f"clip {self._names[clip]!r} is for other proportions than those of "
                f"simulation {wrong[0]}",
                "options['clip']",
                "let it be drawn, or use clips of one person",
            )


def _drawn_differences(randomisation: Randomisation | None, count: int, seed: int) -> np.ndarray:
    """``(n,)`` metres by which the avatars are taller than their users, in whole centimetres."""
    if randomisation is None or not any(randomisation.unscaled_m):
        return np.zeros(count)
    numbers = np.random.default_rng([seed, 14]).random(count)
    return np.round(within(numbers, randomisation.unscaled_m), 2)


def _check_heights(whose: str, heights: np.ndarray) -> None:
    """Refuse statures that our body does not have."""
    low, high = heights.min(), heights.max()
    if not MIN_HEIGHT_M <= low <= high <= MAX_HEIGHT_M:
        raise InputError(
            f"the {whose} would be {low:.2f} to {high:.2f} m tall, which is not within "
            f"{MIN_HEIGHT_M} to {MAX_HEIGHT_M} m",
            "unscaled_m",
            "give smaller differences, or other heights",
        )


def models_of(
    bodies: Bodies, config: EnvConfig, avatar: Avatar, seed: int
) -> tuple[Body, list[mujoco.MjModel]]:
    """The default body in the config's world, and the model of each simulation."""

    def build(height: float, proportions: Proportions | None) -> Body:
        if config.body is not None:
            return build_own_world(
                config.body, float(height), config.self_collision, config.terrain, config.objects
            )
        return build_world(
            float(height),
            config.body_preset,
            config.self_collision,
            config.terrain,
            config.objects,
            proportions,
        )

    pairs = zip(bodies.heights, bodies.proportions, strict=True)
    models = [build(height, proportions).model for height, proportions in pairs]
    if config.randomisation is not None and config.randomisation.of_bodies:
        models = varied_models(models, config.randomisation, seed, len(avatar.links))
    return build(avatar.base_m, None), models
