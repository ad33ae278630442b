"""Systems that estimate a user's full-body pose from devices, without physics; docs/agents.md."""

from agents.kinematic.interface import KinematicSystem, Poses, UserBody
from agents.kinematic.store import load_system

Body = UserBody
"""A shorter name of the same class."""

__all__ = ["Body", "KinematicSystem", "Poses", "UserBody", "load_system"]
