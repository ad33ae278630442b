"""Systems that estimate a user's full-body pose from devices, without physics; docs/agents.md.

Public names are imported on first use, so that importing a submodule loads nothing else.
"""

from typing import TYPE_CHECKING

from questsim.lazy import imported_on_use

if TYPE_CHECKING:
    from agents.kinematic.interface import KinematicSystem, Poses, UserBody
    from agents.kinematic.store import load_system

_HOMES = {
    "KinematicSystem": "agents.kinematic.interface",
    "Poses": "agents.kinematic.interface",
    "UserBody": "agents.kinematic.interface",
    "load_system": "agents.kinematic.store",
}
__all__ = ["KinematicSystem", "Poses", "UserBody", "load_system"]

__getattr__ = imported_on_use(__name__, _HOMES)
