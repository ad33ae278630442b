"""Averages the weights of policies that one training passed through.

The weights of a policy still move in a training's last part, more or less around one place. Their
mean often does better than any of them (Izmailov et al., "Averaging Weights Leads to Wider Optima
and Better Generalization", UAI 2018).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from agents.policy.checkpoint import CARD_FILE, find_policy, load_policy, save_policy
from agents.policy.options import AverageArgs
from agents.policy.policy_agent import PolicyAgent
from questsim.errors import InputError

KEPT = "kept"
"""Folder of a stage with the policies that ``keep_checkpoints`` keeps."""
AVERAGED = "average_of_steps"
"""Key of the training record: the steps after which the averaged policies were saved."""
_OF_EACH = ("steps", "minutes", "evaluation")
"""Keys of the training record in which policies of one training differ."""


def average_policies(args: AverageArgs) -> int:
    """Average policies of one training; the exit code.

    Raises:
        InputError: see ``average``.
    """
    steps = average(_folders(args.policies), args.out)
    print(f"written to {args.out}: the mean of the policies after {listed(steps)} steps")
    return 0


def listed(steps: list[int]) -> str:
    """Numbers of steps in words, e.g. ``0.80 M, 1.60 M and 2.18 M``."""
    words = [f"{number / 1e6:.2f} M" for number in steps]
    return " and ".join([", ".join(words[:-1]), words[-1]])


def _folders(policies: tuple[Path, ...]) -> list[Path]:
    if len(policies) == 1 and (policies[0] / KEPT).is_dir():
        return sorted((policies[0] / KEPT).iterdir())[1:]
    return [find_policy(folder) for folder in policies]


def average(folders: list[Path], out: Path) -> list[int]:
    """Write the policy whose weights are the mean of those of several policies of one training.

    Args:
        folders: of two policies or more.
        out: its folder; best inside the run, so that ``questsim ship`` finds the run's record.

    Returns:
        The steps after which they were saved.

    Raises:
        InputError: there are fewer than two, they are of different trainings or do not state
            theirs, one is named twice, or ``out`` exists.
    """
    if len(folders) < 2:
        found = "there is 1 policy" if folders else "there is no policy"
        fix = "name two checkpoints or more, or a stage folder that kept some"
        raise InputError(f"{found} to average", "questsim average", fix)
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise InputError("names a policy twice", "questsim average", "name each once")
    if out.exists():
        raise InputError("exists already", out, "give another --out")
    policies = [(folder, load_policy(folder)) for folder in folders]
    policies.sort(key=lambda policy: _steps_of(*policy))
    first, agents = policies[0][0], [agent for _, agent in policies]
    for folder, agent in policies:
        if _of_training(agent.card) != _of_training(agents[0].card):
            fix = "average policies of one stage of one training"
            raise InputError(f"is of another training than {first}", folder, fix)
    steps, last = [agent.card["training"]["steps"] for agent in agents], agents[-1]
    if len(set(steps)) < len(steps):
        what = "has two policies of the same number of steps, which are one"
        raise InputError(what, "questsim average", "name each once")
    weights = [agent.policy.state_dict() for agent in agents]
    last.policy.load_state_dict(
        {name: _mean([part[name] for part in weights]) for name in weights[0]}
    )
    training = {k: v for k, v in last.card["training"].items() if k != "evaluation"}
    save_policy(out, last.policy, last.needs, training | {AVERAGED: steps})
    return steps


def _steps_of(folder: Path, agent: PolicyAgent) -> int:
    training = agent.card.get("training")
    steps = training.get("steps") if isinstance(training, dict) else None
    if not isinstance(steps, int):
        raise InputError("does not state the steps of its training", folder / CARD_FILE)
    return steps


def _mean(tensors: list[torch.Tensor]) -> torch.Tensor:
    """Mean in double precision; counts, which are whole numbers, are those of the last."""
    if not tensors[0].is_floating_point():
        return tensors[-1]
    return torch.stack([t.double() for t in tensors]).mean(0).to(tensors[0].dtype)


def _of_training(card: dict[str, Any]) -> dict[str, Any]:
    """What policies of one training have in common."""
    training = {k: v for k, v in card["training"].items() if k not in _OF_EACH}
    return {**card, "training": training}
