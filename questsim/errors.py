"""The one exception that means: the input is wrong, and here is what to do about it."""

from __future__ import annotations

import re
from pathlib import Path

BAD_INPUT, INTERRUPTED = 2, 130
"""Exit codes: input that cannot be used; Ctrl-C, as shells count it (128 + SIGINT)."""
LONGEST_QUOTE = 200
"""Characters of what was given that a message repeats."""
LONGEST = 600
"""Characters of each part of a message."""


class InputError(ValueError):
    """Input that cannot be used: a file, an option, a checkpoint.

    Command lines print it as one line on stderr and exit with code 2.

    Args:
        what: what is wrong, e.g. ``"MOTION block ends after 12 of 273 frames"``.
        where: the file, line, field or option, e.g. ``"walk.bvh, line 180"``.
        fix: what the user can do about it, e.g. ``"download the file again"``.
    """

    def __init__(self, what: str, where: str | Path | None = None, fix: str | None = None) -> None:
        self.what, self.where, self.fix = what, where, fix
        message = f"{_short(where)}: {_short(what)}" if where is not None else _short(what)
        super().__init__(f"{message}; {_short(fix)}" if fix else message)


def _short(text: str | Path) -> str:
    """The text with what it quotes, and itself, cut to a length that can be read."""
    cut = re.sub(rf"(['\"])([^'\"]{{{LONGEST_QUOTE}}})[^'\"]+\1", r"\1\2...\1", str(text))
    cut = re.sub(rf"(\S{{{LONGEST_QUOTE}}})\S{{8,}}", r"\1...", cut)
    return cut if len(cut) <= LONGEST else f"{cut[:LONGEST]}..."


def at_least(least: float, **options: float | None) -> None:
    """Refuse options of a command that are too small, or no number.

    Args:
        least: what is allowed.
        **options: values by name; None is not looked at.

    Raises:
        InputError: naming the first option that is smaller.
    """
    for name, value in options.items():
        if value is not None and not value >= least:  # NaN is not
            raise InputError(f"is {value:g}, not at least {least:g}", f"--{name.replace('_', '-')}")
