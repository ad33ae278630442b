"""Pushes: forces on a link for a short time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from envs.avatar import Avatar
from envs.checks import check_range, is_whole
from envs.episode_random import EpisodeRandom, Seeds, within
from questsim.errors import InputError, value_text
from questsim.motion.clip import FPS
from questsim.skeleton import LINKS

MAX_FORCE_N, MAX_SECONDS = 2000.0, 60.0


@dataclass(frozen=True)
class Pushes:
    """Horizontal pushes in random directions; every push draws new values from the ranges.

    Attributes:
        force_n: least and greatest force in newtons.
        duration_s: least and greatest duration.
        pause_s: time from the episode's start to the first push, and from one push to the next.
        body: the link that is pushed, at its centre of mass.
        count: pushes in an episode; None for no limit.

    Raises:
        InputError: an invalid range, an unknown link, or a count below 1.
    """

    force_n: tuple[float, float] = (50.0, 100.0)
    duration_s: tuple[float, float] = (0.2, 0.2)
    pause_s: tuple[float, float] = (1.0, 3.0)
    body: str = "chest"
    count: int | None = None

    def __post_init__(self) -> None:
        for name, most in (
            ("force_n", MAX_FORCE_N),
            ("duration_s", MAX_SECONDS),
            ("pause_s", MAX_SECONDS),
        ):
            check_range(name, getattr(self, name), 0.0, most, "pushes")
        if self.body not in LINKS:
            what = f"there is no link {self.body!r}"
            raise InputError(what, "pushes", f"choose from {', '.join(LINKS)}")
        if self.count is not None and not (is_whole(self.count) and self.count >= 1):
            what = f"count is {value_text(self.count)}, not a whole number from 1 on"
            raise InputError(what, "pushes", "leave them out")


class Pusher:
    """The pushes of a batch: random ones of the options, and those by hand.

    Args:
        pushes: options, None for none.
        random: numbers to draw from.
        wrench: the batch's bound ``xfrc_applied`` ``(n, bodies, 6)``.
        avatar: the body that is pushed.

    Attributes:
        force: ``(n, 3)`` N, world: force of the present step.
    """

    def __init__(
        self,
        pushes: Pushes | None,
        random: EpisodeRandom,
        wrench: np.ndarray,
        avatar: Avatar,
    ) -> None:
        n, self._avatar = len(wrench), avatar
        self._pushes, self._random, self._wrench = pushes, random, wrench
        self.force = np.zeros((n, 3))
        self._wish = np.zeros((n, 3))
        self._left_s = np.zeros(n)
        self._pause_s = np.full(n, np.inf)
        self._planned_force, self._planned_s = np.zeros((n, 3)), np.zeros(n)
        self._done, self._clip = np.zeros(n, np.int64), np.zeros(n, np.int64)
        self._body = np.full(n, 1 + avatar.link(pushes.body if pushes else "chest"))

    def begin(self, ids: np.ndarray, clips: np.ndarray) -> None:
        """Begin episodes ``ids`` with clips ``clips``."""
        self._left_s[ids], self._done[ids], self._clip[ids] = 0.0, 0, clips
        self.force[ids], self._wrench[ids] = 0.0, 0.0
        self._plan(ids)

    def push(self, i: int, force: np.ndarray, seconds: float = 0.2, body: str = "chest") -> None:
        """Push simulation ``i`` with ``force`` ``(3,)`` N from the next step on.

        Raises:
            InputError: a force or a time that is not finite or too large, or an unknown link.
        """
        force = np.asarray(force, float)
        if force.shape != (3,) or not np.linalg.norm(force) <= MAX_FORCE_N:
            raise InputError(f"force {force} is not three numbers up to {MAX_FORCE_N:g} N", "push")
        if not 0.0 <= seconds <= MAX_SECONDS:
            raise InputError(f"{seconds:g} s is not within 0 and {MAX_SECONDS:g} s", "push")
        if body not in LINKS:
            raise InputError(f"there is no link {body!r}", "push", f"use {', '.join(LINKS)}")
        self._wrench[i] = 0.0
        self._wish[i], self._left_s[i], self._body[i] = force, seconds, 1 + self._avatar.link(body)

    def _plan(self, ids: np.ndarray) -> None:
        """Draw the time until the next push, where one is left."""
        pushes = self._pushes
        if pushes is None or len(ids) == 0:
            return
        numbers = self._random.draw(ids, self._clip[ids], 4, self._done[ids])
        self._pause_s[ids] = within(numbers[:, 0], pushes.pause_s)
        if pushes.count is not None:
            self._pause_s[ids[self._done[ids] >= pushes.count]] = np.inf
        turn = 2.0 * np.pi * numbers[:, 1]
        force = within(numbers[:, 2], pushes.force_n)
        self._planned_force[ids] = np.stack(
            [force * np.cos(turn), force * np.sin(turn), np.zeros(len(ids))], axis=-1
        )
        self._planned_s[ids] = within(numbers[:, 3], pushes.duration_s)

    def apply(self) -> None:
        """Set the forces of the coming step; call once before each."""
        if self._pushes is None and not self._left_s.any() and not self.force.any():
            return
        if self._pushes is not None:
            begins = np.flatnonzero((self._pause_s <= 1e-9) & (self._left_s <= 0.0))
            if len(begins):
                self._wish[begins] = self._planned_force[begins]
                self._left_s[begins] = self._planned_s[begins]
                self._body[begins] = 1 + self._avatar.link(self._pushes.body)
                self._done[begins] += 1
                self._pause_s[begins] = np.inf
                self._plan(begins)
            self._pause_s[self._left_s <= 0.0] -= 1.0 / FPS
        # A push that ends within the step is scaled down, so that the impulse is exact.
        share = np.clip(self._left_s * FPS, 0.0, 1.0)
        self.force[:] = share[:, None] * self._wish
        self._wrench[np.arange(len(share)), self._body, :3] = self.force
        self._left_s[:] = np.maximum(self._left_s - 1.0 / FPS, 0.0)

    def force_on(self, body: int) -> np.ndarray:
        """Forces ``(n, 3)`` N of the present step on one body of the physics."""
        return np.where((self._body == body)[:, None], self.force, 0.0)

    def seed(self, seeds: Seeds) -> None:
        """Seed the random streams of pushes."""
        self._random.seed(seeds)

    def get_state(self) -> dict[str, Any]:
        """State that determines later pushes."""
        state = {k: v.copy() for k, v in vars(self).items() if isinstance(v, np.ndarray)}
        del state["_wrench"]
        return state | {"chance": self._random.get_state()}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore the result of ``get_state``."""
        self._random.set_state(state["chance"])
        for name, value in state.items():
            if name != "chance":
                setattr(self, name, value.copy())
