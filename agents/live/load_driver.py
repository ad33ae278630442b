"""Drivers of the live simulation by an agent's name."""

from __future__ import annotations

from collections.abc import Callable

from agents.live.drivers import BASELINES, Driver, TorqueDriver
from agents.loading import load_agent
from agents.names import shipped_policies
from questsim.motion.motion import Motion


def load_driver(name: str, recording: Callable[[str], Motion]) -> Driver:
    """What an agent's name, checkpoint folder or run folder means.

    Args:
        name: of a policy, a baseline or a kinematic system, perhaps with physics behind it.
        recording: by a clip's name, its user's motion; asked for by kinematic systems alone.

    Raises:
        InputError: there is no such agent, or it cannot be used.
    """
    if name in BASELINES or name in shipped_policies():
        return TorqueDriver(load_agent(name))
    # Not at the top: all systems are imported with these, and the page is not to wait for them.
    from agents.kinematic.physics_behind import TRACKER, base_of
    from agents.kinematic.store import UNTRAINED, find_system, load_system
    from agents.live.physics import PhysicsDriver
    from agents.live.poses import PoseDriver

    base = base_of(name)
    if base is not None:
        return PhysicsDriver(load_system(base), load_agent(TRACKER), recording)
    if name in UNTRAINED or find_system(name) is not None:
        return PoseDriver(load_system(name), recording)
    return TorqueDriver(load_agent(name))
