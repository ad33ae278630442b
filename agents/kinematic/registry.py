"""Registry of the trained kinematic systems: entries of the built-in and external families."""

from __future__ import annotations

from agents.kinematic.avatarposer.entry import AVATARPOSER
from agents.kinematic.dragposer.entry import DRAGPOSER
from agents.kinematic.entry import Entry
from agents.kinematic.recurrent.entry import HMDPOSER, LGSIK
from agents.kinematic.sparseposer.entry import SPARSEPOSER
from questsim.errors import InputError

AGENTS: dict[str, Entry] = {
    "avatarposer": AVATARPOSER,
    "hmdposer": HMDPOSER,
    "lgsik": LGSIK,
    "sparseposer": SPARSEPOSER,
    "dragposer": DRAGPOSER,
}
"""Entries by the name used in command lines and checkpoints, in the order of tables."""
_OWN = tuple(AGENTS)


def register_system(name: str, entry: Entry) -> None:
    """Register a family, e.g. from a module named in ``QUESTSIM_EXTENSIONS``.

    Args:
        name: name in command lines and checkpoints.
        entry: see ``agents.kinematic.entry``.

    Raises:
        InputError: the name is taken.
    """
    if name in _OWN or (name in AGENTS and AGENTS[name].title != entry.title):
        raise InputError(f"there is a system {name!r} already", "register_system", "rename it")
    AGENTS[name] = entry
