"""Systems that estimate a user's whole pose from devices, without physics; docs/agents.md."""

from agents.kinematic.interface import Body, KinematicSystem, Poses
from agents.kinematic.store import load_system

__all__ = ["Body", "KinematicSystem", "Poses", "load_system"]
