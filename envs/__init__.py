"""Environments: MuJoCo avatars that follow a user.

Importing this package registers ``QuestSim-v0`` (headset and two controllers),
``QuestSimHeadset-v0`` (headset alone) and one id for each terrain (``QuestSimRough-v0``, ...) with
gymnasium; ``envs.registration.ENVIRONMENTS`` lists them. The names below are imported lazily, on
first use, so registration loads neither MuJoCo nor PyTorch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from envs.registration import register
from questsim.lazy import imported_on_use

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
    "BatchSim": "envs.core",
    "EnvConfig": "envs.config",
    "KinematicVecEnv": "envs.kinematic",
    "Pushes": "envs.pushes",
    "QuestEnv": "envs.gym",
    "QuestVecEnv": "envs.sb3",
    "QuestVectorEnv": "envs.vector",
    "Randomisation": "envs.randomisation",
    "Terrain": "envs.terrain",
    "WorldObject": "envs.objects",
    "terrain_named": "envs.terrain",
}


__getattr__ = imported_on_use(__name__, _MODULES)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


register()
