"""Drivers of the live simulation by an agent's name."""

from __future__ import annotations

from collections.abc import Callable

from agents.live.drivers import Driver, TorqueDriver
from agents.loading import load_agent
from agents.resolve import ESTIMATE_TRACKER, resolve
from questsim.motion.motion import Motion


def load_driver(name: str, recording: Callable[[str], Motion]) -> Driver:
    """What an agent's name, checkpoint folder or run folder means.

    Args:
        any that ``agents.resolve`` knows.
        recording: by a clip's name, its user's motion; asked for by kinematic systems alone.

    Raises:
        InputError: there is no such agent, or it cannot be used.
    """
    found = resolve(name)
    if found.torques:
        return TorqueDriver(load_agent(name))
    # Not at the top: all systems are imported with these, and the page is not to wait for them.
    from agents.kinematic.store import load_system
    from agents.live.physics import PhysicsDriver
    from agents.live.poses import PoseDriver

    system = load_system(found.base)
    if found.kind == "system":
        return PoseDriver(system, recording)
    return PhysicsDriver(system, load_agent(ESTIMATE_TRACKER), recording)
