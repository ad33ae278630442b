"""How much memory a training takes, against what the machine has."""

from __future__ import annotations

import os
from pathlib import Path

BYTES_PER_FRAME = 6500
"""Clips, their copy on the avatar and the reference, at the peak: measured with 1.1 million frames
and 128 simulations, less ``BASE_BYTES``."""
BASE_BYTES = 1_000_000_000
_LIMITS = (
    Path("/sys/fs/cgroup/memory.max"),  # control groups, version 2
    Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"),  # version 1
)


def memory_bytes() -> int | None:
    """Memory of the machine, or of its container if that has less; None if unknown."""
    try:
        found = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    except (AttributeError, OSError, ValueError):  # not on Windows
        return None
    for path in _LIMITS:
        try:
            found.append(int(path.read_text()))
        except (OSError, ValueError):  # no control group, or "max"
            continue
    return min(found)


def memory_warning(frames: int, share: float, processes: int, there: int | None) -> str | None:
    """A line for a training that may not fit into the memory; None for others.

    A system without memory left ends a process without a word.

    Args:
        frames: of all clips, at 36 Hz.
        share: of variations among the clips.
        processes: number of processes that hold the clips.
        there: bytes of the machine; None if unknown.
    """
    needed = processes * (BASE_BYTES + BYTES_PER_FRAME * frames / (1.0 - share))
    if there is None or needed < 0.9 * there:
        return None
    fixes = ["fewer --motions"]
    fixes += ["less --vary"] if share else []
    fixes += ["fewer --workers"] if processes > 1 else []
    return (
        f"warning: {frames / 36.0 / 3600.0:.1f} h of motion need about {needed / 1e9:.0f} GB of "
        f"memory, this machine has {there / 1e9:.0f}: give {' or '.join(fixes)}"
    )
