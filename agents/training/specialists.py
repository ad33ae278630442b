"""Teachers of single kinds of motion, asked instead of the general teacher for these kinds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from agents.policy.checkpoint import find_teacher, load_policy
from agents.policy.networks import TorquePolicy
from agents.policy.policy_agent import PolicyAgent
from agents.resolve import from_anywhere
from envs import QuestVecEnv
from questsim.errors import InputError

OPTION = "--specialists"


@dataclass(frozen=True)
class Specialist:
    """A teacher, and patterns of the kinds of motion for which it is asked."""

    where: Path
    kinds: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.where}:{'+'.join(self.kinds)}"


def read_specialist(text: str) -> Specialist:
    """Read ``FOLDER:KIND+KIND`` or ``NAME:KIND+KIND``; kinds may be patterns such as ``side-*``.

    Raises:
        InputError: it is not of this form.
    """
    where, colon, kinds = text.rpartition(":")
    patterns = tuple(kind.strip() for kind in kinds.split("+"))
    if not (colon and where and all(patterns)):
        raise InputError(f"is {text!r}", OPTION, "write FOLDER:KIND+KIND, e.g. runs/steps:side-*")
    return Specialist(from_anywhere(Path(where)) or Path(where), patterns)


def load_specialist(specialist: Specialist, general: PolicyAgent, env: QuestVecEnv) -> TorquePolicy:
    """The policy of a specialist, which observes what the general teacher does.

    Raises:
        InputError: there is no such teacher, it does not fit ``env``, or reads other observations.
    """
    agent = load_policy(find_teacher(specialist.where))
    if not agent.needs.privileged:
        raise InputError("does not observe the reference", specialist.where, f"see {OPTION}")
    agent.bind(env)
    if agent.policy.layout != general.policy.layout:
        raise InputError("observes other values than --teacher", specialist.where)
    return agent.policy


class Teachers:
    """Labels each avatar's state by the teacher of its clip's kind.

    Args:
        general: the teacher of all kinds without a specialist.
        specialists: policies with the patterns of their kinds; the first that fits a kind counts.
        env: the training environment; its clips may change.

    Raises:
        InputError: a pattern fits no kind of the clips.
    """

    def __init__(
        self,
        general: TorquePolicy,
        specialists: Sequence[tuple[TorquePolicy, tuple[str, ...]]],
        env: QuestVecEnv,
    ) -> None:
        self._policies = [general, *(policy for policy, _ in specialists)]
        self._kinds = [kinds for _, kinds in specialists]
        self._env = env
        self._reference = env.sim.reference
        self._teacher_of_clip = self._assign()
        known = sorted(set(self._reference.kinds))
        for pattern in (pattern for kinds in self._kinds for pattern in kinds):
            if not any(fnmatchcase(kind, pattern) for kind in known):
                names = ", ".join(kind for kind in known if kind) or "none"
                raise InputError(f"no clip is of a kind {pattern!r}", OPTION, f"there is {names}")

    def _assign(self) -> np.ndarray:
        of_kind = {"": 0}
        for kind in set(self._reference.kinds):
            fits = [any(fnmatchcase(kind, p) for p in kinds) for kinds in self._kinds]
            of_kind[kind] = fits.index(True) + 1 if True in fits else 0
        return np.array([of_kind[kind] for kind in self._reference.kinds])

    def action_mean(self, observations: Tensor) -> Tensor:
        """Actions ``(n, 33)`` of each avatar's teacher for its observation ``(n, D)``."""
        if self._env.sim.reference is not self._reference:
            self._reference = self._env.sim.reference
            self._teacher_of_clip = self._assign()
        chosen = torch.from_numpy(self._teacher_of_clip[self._env.sim.clip])
        labels = observations.new_empty(len(observations), self._policies[0].log_std.numel())
        for number, policy in enumerate(self._policies):
            rows = torch.nonzero(chosen == number)[:, 0]
            if len(rows):
                labels[rows] = policy.action_mean(observations[rows])
        return labels
