"""``train.py``: train torque policies and, with ``--agent``, kinematic systems."""

from __future__ import annotations

from collections.abc import Sequence

from agents.kinematic.options import TrainSystemArgs
from agents.training.options import TrainArgs
from agents.training.train_policy import train
from questsim.errors import InputError
from questsim.modes import Mode, Modes

POLICY = "policy"
"""Value of ``--agent`` for a torque policy, the default."""


def train_kinematic(args: TrainSystemArgs) -> int:
    """See ``agents.kinematic.training``; returns the exit code.

    Raises:
        InputError: options, motions or a run folder cannot be used.
    """
    # Imported here: this loads all systems, which the training of a policy does not need.
    from agents.kinematic.training import train_system

    return train_system(args)


_POLICY = Mode(f"--agent {POLICY}", TrainArgs, train)
_SYSTEM = Mode("--agent SYSTEM", TrainSystemArgs, train_kinematic)


def _choose(words: Sequence[str]) -> tuple[Mode, list[str]]:
    """Options for policies, or for kinematic systems if ``--agent`` names one."""
    rest, agent = [], POLICY
    waiting = iter(words)
    for word in waiting:
        option, equals, value = word.partition("=")
        if option != "--agent":
            rest.append(word)
            continue
        agent = value if equals else next(waiting, "")
    if agent == POLICY:
        return _POLICY, rest
    from agents.kinematic.registry import AGENTS  # not at the top, see below

    if agent not in AGENTS:
        known = ", ".join((POLICY, *AGENTS))
        raise InputError(f"there is no {agent!r} to train", "--agent", f"use one of {known}")
    return _SYSTEM, ["--agent", agent, *rest]


TRAIN = Modes((_POLICY, _SYSTEM), _choose)
"""The jobs of ``train.py`` and ``questsim train``."""
