"""Environments: avatars in MuJoCo that are asked to follow a person.

Importing this package registers ``QuestSim-v0`` (headset and two controllers) and
``QuestSimHeadset-v0`` (headset alone) with gymnasium.
"""

from envs.config import EnvConfig
from envs.core import BatchSim
from envs.gym import QuestEnv, QuestVectorEnv, register
from envs.kinematic import KinematicVecEnv
from envs.sb3 import QuestVecEnv

__all__ = [
    "BatchSim",
    "EnvConfig",
    "KinematicVecEnv",
    "QuestEnv",
    "QuestVecEnv",
    "QuestVectorEnv",
]

register()
