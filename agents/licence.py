"""The licence of weights, derived from the licences of the training motions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from questsim.licences import combined

UNKNOWN = "not stated"
NON_COMMERCIAL = "CC-BY-NC-4.0"


def strictest(licences: Iterable[str]) -> str:
    """One SPDX identifier or expression for weights trained on motions with these licences.

    A motion made of several has an expression, too. If the licence of a motion is unknown, so is
    the licence of the weights.
    """
    found = list(licences)
    unknown = not found or any(UNKNOWN in licence for licence in found)
    return UNKNOWN if unknown else combined(found)


def licence_of(training: Mapping[str, Any]) -> str:
    """The licence of a policy, from the ``training`` part of its ``policy.yaml``.

    The ``licence`` field written by shipping takes precedence over the licences of the policy's
    own clips, since it also includes the teacher's clips.
    """
    if "licence" in training:
        return str(training["licence"])
    return strictest(training.get("licences", {}))
