"""One line on a terminal for work that takes longer than a moment and shows no progress."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

AFTER_S = 1.0
"""Work that takes less is done in silence."""


@contextmanager
def said_if_slow(text: str, after_s: float = AFTER_S) -> Iterator[None]:
    """Print a line to stderr if the block takes long and stderr is a terminal.

    Args:
        text: what takes so long, e.g. ``"making the embedded motions ..."``.
        after_s: time in seconds before the line is printed.
    """
    if not sys.stderr.isatty():
        yield
        return
    timer = threading.Timer(after_s, lambda: print(text, file=sys.stderr, flush=True))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
