"""Environments: MuJoCo avatars that follow a user.

Importing this package registers ``QuestSim-v0`` (headset and two controllers),
``QuestSimHeadset-v0`` (headset alone) and one id for each terrain (``QuestSimRough-v0``, ...) with
gymnasium; ``envs.registration.ENVIRONMENTS`` lists them. The names below are imported lazily, on
first use, so registration loads neither MuJoCo nor PyTorch.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from envs.registration import register

if TYPE_CHECKING:
    from envs.config import EnvConfig
    from envs.core import BatchSim
    from envs.gym import QuestEnv
    from envs.kinematic import KinematicVecEnv
    from envs.objects import WorldObject
    from envs.pushes import Pushes
    from envs.randomisation import Randomisation
    from envs.sb3 import QuestVecEnv
    from envs.terrain import Terrain, terrain_named
    from envs.vector import QuestVectorEnv

__all__ = [
    "BatchSim",
    "EnvConfig",
    "KinematicVecEnv",
    "Pushes",
    "QuestEnv",
    "QuestVecEnv",
    "QuestVectorEnv",
    "Randomisation",
    "Terrain",
    "WorldObject",
    "terrain_named",
]

_MODULES = {
    "BatchSim": "core",
    "EnvConfig": "config",
    "KinematicVecEnv": "kinematic",
    "Pushes": "pushes",
    "QuestEnv": "gym",
    "QuestVecEnv": "sb3",
    "QuestVectorEnv": "vector",
    "Randomisation": "randomisation",
    "Terrain": "terrain",
    "WorldObject": "objects",
    "terrain_named": "terrain",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'envs' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"envs.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


register()
