"""The kinds of actions by name; which of them no training sees."""

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
"""Kinds with random parameters, which the library of ``synthetic_clips`` is without."""
LEAST_ACTION_S = 4.0
"""An action at 1.75 m needs at least so long."""

HELD_OUT: tuple[str, ...] = ("guide", "lunge", "step-touch", "throw")
"""Kinds that no training uses, so that validation asks for something new.

``synthetic:random`` has none of them, ``synthetic:held-out`` these alone.
"""
