"""Evaluations repeated with several seeds, where something is random."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from agents.agent import Agent, RandomAgent
from envs.config import EnvConfig
from questsim.errors import InputError
from questsim.metrics import Rollout, summarise

_RANDOM = ("noise", "randomisation", "terrain", "objects", "pushes")
_SHOWN = ("success", "mpjpe_cm", "root_cm", "jitter_km_s3", "foot_skate_cm_s")


def check_random(agent: Agent, config: EnvConfig, seeds: int) -> None:
    """Refuse several seeds for an evaluation in which they would change nothing.

    Raises:
        InputError: neither the agent nor the environment is random.
    """
    random = isinstance(agent, RandomAgent) or any(getattr(config, name) for name in _RANDOM)
    if seeds > 1 and not random:
        fix = "add --noise, --terrain or --objects, or leave it out"
        raise InputError("nothing in this evaluation is random", "--seeds", fix)


def seeded(agent: Agent, seed: int) -> Agent:
    """The agent with its random numbers begun from a seed."""
    return RandomAgent(seed) if isinstance(agent, RandomAgent) else agent


def spread(runs: Sequence[Sequence[Rollout]]) -> dict[str, dict[str, Any]]:
    """Mean and standard deviation (of a sample) over seeds of every figure, and the figures."""
    figures = [summarise(rollouts) for rollouts in runs]
    found: dict[str, dict[str, Any]] = {}
    for name in figures[0]:
        values = [figure[name] for figure in figures]
        known = [float(value) for value in values if value is not None]
        if name not in ("clips", "real_time_factor") and len(known) == len(values):
            deviation = float(np.std(known, ddof=1))
            found[name] = {"mean": float(np.mean(known)), "std": deviation, "values": known}
    return found


def format_spread(found: dict[str, dict[str, Any]], seeds: int) -> str:
    """Lines of the main figures: mean and standard deviation over the seeds."""
    lines = [f"over {seeds} seeds, mean and standard deviation:"]
    for name in _SHOWN:
        if name in found:
            lines.append(f"  {name:18} {found[name]['mean']:8.3f} ± {found[name]['std']:.3f}")
    return "\n".join(lines)
