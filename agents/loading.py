"""Agents by name or folder."""

from __future__ import annotations

from pathlib import Path

from agents.agent import Agent, RandomAgent, ZeroAgent
from agents.policy.checkpoint import find_policy, load_policy


def load_agent(path_or_name: str | Path) -> Agent:
    """An agent by name (``zero``, ``random`` or a shipped policy), policy folder or run folder.

    Raises:
        InputError: if there is no such agent, or its checkpoint is of another format version,
            joint order, link order or observation layout.
    """
    if path_or_name == "zero":
        return ZeroAgent()
    if path_or_name == "random":
        return RandomAgent()
    return load_policy(find_policy(path_or_name))
