"""How many processes the caller allows for long work, such as reading thousands of files."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from contextvars import ContextVar

_allowed: ContextVar[int] = ContextVar("allowed", default=1)


@contextlib.contextmanager
def processes(count: int) -> Iterator[None]:
    """Allow so many processes inside the block; outside, everything runs in the caller's own.

    A new process begins by importing the main module again: a script that asks for them needs the
    guard ``if __name__ == "__main__"``. The command lines have it, and ask for ``own_cores``.
    """
    token = _allowed.set(count)
    try:
        yield
    finally:
        _allowed.reset(token)


def own_cores() -> int:
    """The number of cores that this process may use, at least 2."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS and Windows
        return max(len(os.sched_getaffinity(0)), 2)
    return max(os.cpu_count() or 1, 2)


def allowed() -> int:
    """The number of processes allowed here: 1 unless the caller asked for more."""
    return _allowed.get()
