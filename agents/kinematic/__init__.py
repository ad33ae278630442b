"""Systems that estimate a user's whole pose from devices, without physics; docs/agents.md."""

from agents.kinematic.interface import KinematicSystem, Poses, UserBody
from agents.kinematic.store import load_system

Body = UserBody
"""The same class by its shorter name."""

__all__ = ["Body", "KinematicSystem", "Poses", "UserBody", "load_system"]
