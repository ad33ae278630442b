"""Every kinematic system that is trained: the entries of its families, and of other packages."""

from __future__ import annotations

from agents.kinematic.dragposer.entry import DRAGPOSER
from agents.kinematic.entry import Entry
from agents.kinematic.recurrent.entry import HMDPOSER, LGSIK
from agents.kinematic.sparseposer.entry import SPARSEPOSER
from questsim.errors import InputError

AGENTS: dict[str, Entry] = {
    "hmdposer": HMDPOSER,
    "lgsik": LGSIK,
    "sparseposer": SPARSEPOSER,
    "dragposer": DRAGPOSER,
}
"""By the name that command lines and checkpoints use, in the order of tables."""
_OWN = tuple(AGENTS)


def register_system(name: str, entry: Entry) -> None:
    """Add a family, e.g. from a module that ``QUESTSIM_EXTENSIONS`` names.

    Args:
        name: for command lines and checkpoints.
        entry: what it is; see ``agents.kinematic.entry``.

    Raises:
        InputError: the name is taken.
    """
    if name in _OWN or (name in AGENTS and AGENTS[name].title != entry.title):
        raise InputError(f"there is a system {name!r} already", "register_system", "rename it")
    AGENTS[name] = entry
