"""Names of agents that are there, found without loading any of them."""

from __future__ import annotations

from agents.policy.checkpoint import CARD_FILE as POLICY_CARD
from agents.policy.checkpoint import shipped_with

SYSTEM_CARD = "system.yaml"
"""Says of a folder that it holds a kinematic system; ``agents/kinematic/store.py`` writes it."""
UNTRAINED = ("ik",)
"""Kinematic systems that are complete without weights."""
PHYSICS = "+physics"
"""After a system's name: that system with physics behind it."""


def shipped_policies() -> tuple[str, ...]:
    """Names of the shipped torque policies."""
    return shipped_with(POLICY_CARD)


def kinematic_systems() -> tuple[str, ...]:
    """Names of the kinematic systems that are shipped or need no weights."""
    return (*shipped_with(SYSTEM_CARD), *UNTRAINED)


def with_physics() -> tuple[str, ...]:
    """Names of these systems with physics behind them."""
    return tuple(f"{name}{PHYSICS}" for name in kinematic_systems())
