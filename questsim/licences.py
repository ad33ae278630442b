"""SPDX expressions for material under several licences."""

from __future__ import annotations

from collections.abc import Iterable

OURS = "MIT"
"""Licence of the code and of embedded motions."""


def combined(licences: Iterable[str]) -> str:
    """The expression that joins licences, each once; ``MIT`` is left out beside others.

    Args:
        licences: identifiers or expressions joined by ``AND``, such as this returns.
    """
    parts = {part for licence in licences for part in licence.split(" AND ")}
    return " AND ".join(sorted(parts - {OURS})) or OURS


def of_parts(licences: Iterable[str]) -> str:
    """The licence of a motion made of several; empty if that of any is not stated."""
    found = list(licences)
    return combined(found) if found and all(found) else ""
