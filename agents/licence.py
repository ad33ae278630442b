"""The licence of weights follows from those of the motions that they were trained on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

UNKNOWN = "not stated"
NON_COMMERCIAL = "CC-BY-NC-4.0"
OURS = "MIT"
"""Of the code, and of weights that no other licence binds."""


def strictest(licences: Iterable[str]) -> str:
    """One licence, an SPDX identifier or expression, for weights made from all of these.

    A motion whose licence nobody stated leaves that of the weights open.
    """
    found = set(licences)
    if not found or UNKNOWN in found:
        return UNKNOWN
    return " AND ".join(sorted(found - {OURS})) or OURS


def licence_of(training: Mapping[str, Any]) -> str:
    """The licence of a policy, by the ``training`` part of its ``policy.yaml``.

    ``licence``, as shipping writes it, counts before the licences of the policy's own clips:
    it also knows those of the teacher's.
    """
    if "licence" in training:
        return str(training["licence"])
    return strictest(training.get("licences", {}))
