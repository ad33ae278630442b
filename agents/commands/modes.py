"""The jobs of ``train.py`` and ``evaluate.py`` by their options.

This module loads neither PyTorch nor the compiled loops, so that ``--help`` and errors of the
command line come at once; each job names its function, which is imported when it runs.
"""

from __future__ import annotations

from collections.abc import Sequence

from agents.commands.help import EVALUATE_HELP, TRAIN_HELP
from agents.comparison.options import CompareArgs
from agents.evaluation.options import ByGroupArgs, EvaluateArgs, ScorecardArgs, WorldsArgs
from agents.kinematic.options import TrainSystemArgs
from agents.shipping.catalogue import kept_families
from agents.training.options import TrainArgs
from questsim.errors import InputError, one_of_these
from questsim.modes import Mode, Modes

POLICY = "policy"
"""Value of ``--agent`` for a torque policy, the default."""

_POLICY = Mode(f"--agent {POLICY}", TrainArgs, "agents.training.train_policy:train", TRAIN_HELP)
_SYSTEM = Mode("--agent SYSTEM", TrainSystemArgs, "agents.kinematic.training:train_system")


def _trained(words: Sequence[str]) -> tuple[Mode, list[str]]:
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
    if agent not in {entry["agent"] for entry in kept_families() if entry["parameters"]}:
        # Perhaps an extension's. Imported here: this loads PyTorch and all families.
        from agents.kinematic.registry import AGENTS

        if agent not in AGENTS:
            fix = one_of_these(agent, (POLICY, *AGENTS))
            raise InputError(f"there is no {agent!r} to train", "--agent", fix)
    return _SYSTEM, ["--agent", agent, *rest]


TRAIN = Modes((_POLICY, _SYSTEM), _trained)
"""The jobs of ``train.py`` and ``questsim train``."""

_EVALUATE = "agents.commands.evaluate"
_BY_FLAG = {
    "--worlds": Mode("--worlds", WorldsArgs, f"{_EVALUATE}:evaluate_worlds"),
    "--scorecard": Mode("--scorecard", ScorecardArgs, f"{_EVALUATE}:evaluate_scorecard"),
    "--by-group": Mode("--by-group", ByGroupArgs, f"{_EVALUATE}:evaluate_by_group"),
    "--compare": Mode("--compare", CompareArgs, f"{_EVALUATE}:evaluate_comparison"),
}
_ONE_AGENT = Mode("--agent NAME", EvaluateArgs, f"{_EVALUATE}:evaluate", EVALUATE_HELP)


def _evaluated(words: Sequence[str]) -> tuple[Mode, list[str]]:
    """The job whose flag is given; without a flag, the evaluation of one agent."""
    flags = list(dict.fromkeys(word for word in words if word in _BY_FLAG))
    if len(flags) > 1:
        raise InputError(f"does not go with {flags[1]}", flags[0], "give one of them")
    mode = _BY_FLAG[flags[0]] if flags else _ONE_AGENT
    return mode, [word for word in words if word not in _BY_FLAG]


EVALUATE = Modes((_ONE_AGENT, *_BY_FLAG.values()), _evaluated)
"""The jobs of ``evaluate.py`` and ``questsim evaluate``."""
