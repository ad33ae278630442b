"""The kinds of actions by name, and which of them are held out from training."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from questsim.motion.synthesis import actions, steps_and_jumps
from questsim.motion.synthesis.footwork import Action

ACTIONS: dict[str, Callable[[np.ndarray, float, np.random.Generator], Action]] = {
    "bow": actions.bow,
    "pick-up": actions.pick_up,
    "guide": actions.guide,
    "duck": actions.duck,
    "punch": actions.punches,
    "swing": actions.swing,
    "throw": actions.throw,
    "lunge": steps_and_jumps.lunge,
    "shuffle": steps_and_jumps.shuffle,
    "cross-step": steps_and_jumps.cross_step,
    "step-back": steps_and_jumps.step_back,
    "step-touch": steps_and_jumps.step_touch,
    "kick": steps_and_jumps.kick,
    "jump": steps_and_jumps.jump,
    "crouch-walk": steps_and_jumps.crouch_walk,
}
"""Kinds with random parameters; they are not in the library of ``synthetic_clips``."""
LEAST_ACTION_S = 4.0
"""Minimum duration in seconds of an action at 1.75 m."""

HELD_OUT: tuple[str, ...] = ("guide", "lunge", "step-touch", "throw")
"""Kinds held out from training, so that validation uses unseen motion.

``synthetic:random`` contains none of them, ``synthetic:held-out`` only these.
"""
