"""Random variations of the training motions, redrawn at intervals (``--vary``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from agents.evaluation.mapping import Mapper
from agents.policy.checkpoint import CARD_FILE, load_resume
from agents.training.learner import Learner
from questsim.errors import InputError
from questsim.motion.clip import Clip
from questsim.motion.variation import long_enough, variations

MOST = 0.95
"""Largest share of variations."""
REDRAW_STEPS = 5_000_000
"""Default number of environment steps between draws of variations."""
PART = 8
"""Variations that a worker makes at a time."""
DRAW = "draw"
"""Key in a stage's saved state: number of the draw in use."""


@dataclass(frozen=True)
class FreshMotions:
    """The training clips of a stage over time: the motions and variations of them.

    Attributes:
        clips: the motions.
        share: share of variations among all clips, 0 to ``MOST``.
        every: environment steps between draws of variations.
        seed: the same seed gives the same variations.
    """

    clips: Sequence[Clip]
    share: float
    every: int
    seed: int

    def number(self, steps: int) -> int:
        """Number of the draw in use after ``steps`` environment steps."""
        return steps // self.every if self.share else 0

    def at(self, number: int, mapper: Mapper = map) -> list[Clip]:
        """The motions and the variations of one draw.

        Args:
            number: of the draw.
            mapper: makes the variations, ``PART`` at a time; they do not depend on it.
        """
        if not self.share:
            return list(self.clips)
        count = max(round(len(self.clips) * self.share / (1.0 - self.share)), 1)
        numbers, draw = range(count), partial(_varied, self.clips, 1000 * self.seed + number)
        size = count if mapper is map else PART
        parts = [numbers[i : i + size] for i in range(0, count, size)]
        return [*self.clips, *(clip for part in mapper(draw, parts) for clip in part)]

    def last(self, folder: Path) -> int:
        """Number of the draw in use at a stage's last checkpoint in ``folder``."""
        if not self.share or not (folder / CARD_FILE).exists():
            return 0
        return int(load_resume(folder).get(DRAW, 0))


def _varied(clips: Sequence[Clip], seed: int, numbers: range) -> list[Clip]:
    return list(variations(clips, numbers, seed))


def check_share(share: float, redraw: int | None, clips: Sequence[Clip]) -> None:
    """Check the options of variations before anything is written.

    Raises:
        InputError: naming the option.
    """
    if not 0.0 <= share <= MOST:
        raise InputError(f"is {share:g}, not 0 to {MOST:g}", "--vary", "give a share of the clips")
    if redraw is not None and not share:
        raise InputError("does nothing without --vary", "--redraw", "add --vary 0.5")
    if share:
        long_enough(clips)


class WithClips(Protocol):
    """A batch of avatars, or workers that share one."""

    def change_clips(self, clips: Sequence[Clip], seed: int) -> None:
        """Replace the clips; the next rollout begins new episodes."""
        ...


def redrawing(
    fresh: FreshMotions,
    env: WithClips,
    learner: Learner,
    number: int,
    state: dict[str, Any],
    mapper: Mapper = map,
) -> Callable[[int], None]:
    """A function to call with the steps before each iteration; replaces variations when due.

    Args:
        fresh: the motions and their variations.
        env: the training environment.
        learner: restarts its episodes after a replacement.
        number: number of the draw that ``env`` has now.
        state: gets the number of the draw, to be saved with the stage.
        mapper: see ``FreshMotions.at``.
    """
    state[DRAW] = number

    def change(steps: int) -> None:
        wanted = fresh.number(steps)
        if wanted != state[DRAW]:
            env.change_clips(fresh.at(wanted, mapper), fresh.seed + wanted)
            learner.begin_anew()
            state[DRAW] = wanted

    return change
