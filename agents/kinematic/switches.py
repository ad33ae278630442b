"""Fields of a spec that switch off a part of a system, for ablations."""

from __future__ import annotations

from dataclasses import fields

SWITCH = {"switch": True}
"""Metadata of such a field. Checkpoints from before the field have its default."""


def switches(spec: type) -> set[str]:
    """Names of the fields of a spec's dataclass that have the metadata ``SWITCH``."""
    return {field.name for field in fields(spec) if field.metadata.get("switch")}
