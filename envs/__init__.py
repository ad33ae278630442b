"""Environments: avatars in MuJoCo that are asked to follow a person."""

from envs.config import EnvConfig
from envs.core import BatchSim
from envs.sb3 import QuestVecEnv

__all__ = ["BatchSim", "EnvConfig", "QuestVecEnv"]
