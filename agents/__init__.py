"""Policies, their training and their evaluation.

``load_agent`` loads an agent by name or path; ``Tracker`` is the teacher as a full-body tracker.
Public names are imported on first use, so that importing a submodule loads nothing else.
"""

from typing import TYPE_CHECKING

from questsim.lazy import imported_on_use

if TYPE_CHECKING:
    from agents.agent import Agent
    from agents.loading import load_agent
    from agents.policy.policy_agent import PolicyAgent, Tracker

_HOMES = {
    "Agent": "agents.agent",
    "PolicyAgent": "agents.policy.policy_agent",
    "Tracker": "agents.policy.policy_agent",
    "load_agent": "agents.loading",
}
__all__ = ["Agent", "PolicyAgent", "Tracker", "load_agent"]

__getattr__ = imported_on_use(__name__, _HOMES)
