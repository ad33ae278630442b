"""Load agents that map observations to torques, by name or folder."""

from __future__ import annotations

from pathlib import Path

from agents.agent import Agent, RandomAgent, ZeroAgent
from agents.policy.checkpoint import load_policy
from agents.resolve import PHYSICS, ZERO, Resolved, base_of, own_object, resolve
from questsim.errors import InputError


def load_agent(path_or_name: str | Path | Resolved) -> Agent:
    """An agent by name, checkpoint, stage or run folder, or ``package.module:Class``.

    Raises:
        InputError: there is no such agent; it is a kinematic system, which outputs poses; or its
            checkpoint has another format version, joint order, link order or observation layout.
    """
    found = resolve(path_or_name)
    if found.kind == "baseline":
        return ZeroAgent() if found.name == ZERO else RandomAgent()
    if found.kind == "own":
        return own_object(found.name)
    if not found.torques:
        base = base_of(found.name) or found.name
        fix = f"evaluate.py --agent and questsim demo take {base} and {base}{PHYSICS}"
        raise InputError("is a kinematic system, which gives no torques", found.name, fix)
    assert found.folder is not None
    return load_policy(found.folder)
