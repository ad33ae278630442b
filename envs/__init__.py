"""Environments: avatars in MuJoCo that are asked to follow a person.

Importing this package registers ``QuestSim-v0`` (headset and two controllers),
``QuestSimHeadset-v0`` (headset alone) and one id for each terrain (``QuestSimRough-v0``, ...) with
gymnasium; ``envs.gym.ENVIRONMENTS`` lists them.
"""

from envs.config import EnvConfig
from envs.core import BatchSim
from envs.gym import QuestEnv, QuestVectorEnv, register
from envs.kinematic import KinematicVecEnv
from envs.objects import WorldObject
from envs.pushes import Pushes
from envs.randomisation import Randomisation
from envs.sb3 import QuestVecEnv
from envs.terrain import Terrain, terrain_named

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

register()
