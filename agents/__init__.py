"""Policies, their training and their evaluation.

``load_agent`` gives an agent by name or path; ``Tracker`` is the teacher as a full-body tracker.
"""

from agents.agent import Agent, PolicyAgent, Tracker, load_agent

__all__ = ["Agent", "PolicyAgent", "Tracker", "load_agent"]
