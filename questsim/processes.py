"""How many processes the caller allows for long work, such as reading thousands of files."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar

_allowed: ContextVar[int] = ContextVar("allowed", default=1)


@contextlib.contextmanager
def processes(count: int) -> Iterator[None]:
    """Allow so many processes inside the block; outside, everything runs in the caller's own.

    A new process begins by importing the main module again: a script that asks for them needs the
    guard ``if __name__ == "__main__"``. The command lines have it, and ask for two.
    """
    token = _allowed.set(count)
    try:
        yield
    finally:
        _allowed.reset(token)


def allowed() -> int:
    """The number of processes allowed here: 1 unless the caller asked for more."""
    return _allowed.get()
