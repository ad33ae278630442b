"""Load drivers of the live simulation by an agent's name."""

from __future__ import annotations

from collections.abc import Callable

from agents.live.drivers import Driver, TorqueDriver
from agents.loading import load_agent
from agents.resolve import ESTIMATE_TRACKER, resolve
from questsim.motion.motion import Motion


def load_driver(name: str, recording: Callable[[str], Motion]) -> Driver:
    """The driver of an agent given by name, checkpoint folder or run folder.

    Args:
        any that ``agents.resolve`` knows.
        recording: returns the user's motion of a clip by name; only kinematic systems use it.

    Raises:
        InputError: there is no such agent, or it cannot be used.
    """
    found = resolve(name)
    if found.torques:
        return TorqueDriver(load_agent(name))
    # Imported here: this loads all systems, and the page should not wait for them.
    from agents.kinematic.store import load_system
    from agents.live.physics import PhysicsDriver
    from agents.live.poses import PoseDriver

    system = load_system(found.base)
    if found.kind == "system":
        return PoseDriver(system, recording)
    return PhysicsDriver(system, load_agent(ESTIMATE_TRACKER), recording)
