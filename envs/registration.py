"""The environments' ids, and their registration with gymnasium."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gymnasium.envs.registration import register as _register
from gymnasium.envs.registration import registry

ENVIRONMENTS: dict[str, dict[str, Any]] = {
    "QuestSim-v0": {},
    "QuestSimHeadset-v0": {"sensors": "H"},
    "QuestSimRough-v0": {"terrain": "rough"},
    "QuestSimWaves-v0": {"terrain": "waves"},
    "QuestSimSlope-v0": {"terrain": "slope"},
    "QuestSimStairs-v0": {"terrain": "stairs"},
    "QuestSimSteps-v0": {"terrain": "steps"},
    "QuestSimGaps-v0": {"terrain": "gaps"},
    "QuestSimCourse-v0": {"terrain": "course"},
    "QuestSimMixed-v0": {"terrain": "mixed"},
}
"""Ids, each with the options that differ from the defaults of ``EnvConfig``."""


def register() -> None:
    """Register the ids that are not registered yet.

    ``import envs`` calls this function; programs that load the entry points of the group
    ``gymnasium.envs`` also do. gymnasium itself loads no entry points since version 1.0. Without
    an import of ``envs``, use ``gym.make("envs:QuestSim-v0")``.
    """
    for name, options in ENVIRONMENTS.items():
        register_id(name, options)


def register_id(name: str, options: Mapping[str, Any]) -> None:
    """Register one id, unless it is registered already.

    Args:
        name: the id.
        options: of ``EnvConfig``.
    """
    if name not in registry:
        _register(
            name,
            entry_point="envs.gym:QuestEnv",
            vector_entry_point="envs.vector:QuestVectorEnv",
            kwargs=dict(options),
        )


def terrain_id(kind: str) -> str:
    """The id of a terrain: ``QuestSimHighRidges-v0`` for ``high_ridges``."""
    return f"QuestSim{''.join(part.capitalize() for part in kind.split('_'))}-v0"
