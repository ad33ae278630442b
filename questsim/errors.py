"""The exception for invalid input, with what is wrong, where, and how to fix it."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

BAD_INPUT, INTERRUPTED = 2, 130
"""Exit codes: invalid input; Ctrl-C, as in shells (128 + SIGINT)."""
LONGEST_QUOTE = 200
"""Greatest length of quoted input in a message."""
LONGEST = 600
"""Greatest length of each part of a message."""
LONGEST_VALUE = 80
"""Greatest length of a value in a message."""


MOST_SEED = 2**32 - 1
"""Greatest seed of a command."""


class InputError(ValueError):
    """Input that cannot be used: a file, an option, a checkpoint.

    Command lines print it as one line on stderr and exit with code 2.

    Args:
        what: what is wrong, e.g. ``"MOTION block ends after 12 of 273 frames"``.
        where: the file, line, field or option, e.g. ``"walk.bvh, line 180"``.
        fix: what the user can do about it, e.g. ``"download the file again"``. If it is ``"choose
            from A, B"`` and ``what`` quotes a word that is like one of these, it also asks whether
            that one was meant.
    """

    def __init__(self, what: str, where: str | Path | None = None, fix: str | None = None) -> None:
        fix = _with_near(what, fix)
        self.what, self.where, self.fix = what, where, fix
        message = f"{_short(where)}: {_short(what)}" if where is not None else _short(what)
        super().__init__(f"{message}; {_short(fix)}" if fix else message)


def _with_near(what: str, fix: str | None) -> str | None:
    listed = (fix or "").partition("choose from ")
    quoted = re.search(r"'([^']+)'", what)
    if fix is None or listed[0] or not listed[1] or quoted is None:
        return fix
    return did_you_mean(quoted[1], listed[2].split(", ")) + fix


def _short(text: str | Path) -> str:
    """The text, with its quotations and itself cut to a readable length."""
    cut = re.sub(rf"(['\"])([^'\"]{{{LONGEST_QUOTE}}})[^'\"]+\1", r"\1\2...\1", str(text))
    cut = re.sub(rf"(\S{{{LONGEST_QUOTE}}})\S{{8,}}", r"\1...", cut)
    return cut if len(cut) <= LONGEST else f"{cut[:LONGEST]}..."


def value_text(value: Any) -> str:
    """A short text of a value for an error message; only the type of arrays and other objects."""
    if value is None or isinstance(value, bool | int | float | str):
        text = repr(value)
        return text if len(text) <= LONGEST_VALUE else text[: LONGEST_VALUE - 3] + "..."
    if isinstance(value, tuple | list | dict | set) and len(repr(value)) <= LONGEST_VALUE:
        return repr(value)
    return f"of the type {type(value).__name__}"


def within(where: str, low: float, high: float, **values: float | None) -> None:
    """Reject settings outside a range or not a number.

    Args:
        where: what has the settings.
        low, high: smallest and largest allowed value.
        **values: settings by name; None is ignored.

    Raises:
        InputError: names the first invalid setting.
    """
    for name, value in values.items():
        if value is not None and not low <= value <= high:
            raise InputError(f"{name} is {value:g}, not {low:g} to {high:g}", where)


def at_least(least: float, **options: float | None) -> None:
    """Reject options of a command that are too small or not a finite number.

    Args:
        least: smallest allowed value.
        **options: values by name; None is ignored.

    Raises:
        InputError: with the name of the first such option.
    """
    for name, value in options.items():
        if value is None:
            continue
        finite(f"--{name.replace('_', '-')}", value)
        if value < least:
            raise InputError(f"is {value:g}, not at least {least:g}", f"--{name.replace('_', '-')}")


def usable_seed(seed: int) -> None:
    """Reject a ``--seed`` that not every generator of random numbers takes.

    Raises:
        InputError: it is negative or too large.
    """
    at_least(0, seed=seed)
    if seed > MOST_SEED:
        raise InputError(f"is {seed}, not at most {MOST_SEED}", "--seed")


def each_once(**options: Sequence[object]) -> None:
    """Reject options of a command that name something twice.

    Args:
        **options: values by name.

    Raises:
        InputError: with the name of the first such option.
    """
    for name, values in options.items():
        if len(set(values)) < len(values):
            raise InputError("has a value twice", f"--{name.replace('_', '-')}", "give each once")


def finite(where: str, value: float) -> None:
    """Reject infinity and values that are not a number.

    Raises:
        InputError: the value is one of these.
    """
    if not math.isfinite(value):
        raise InputError(f"is {value:g}, not a finite number", where)


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """``"did you mean walk? "`` if the name is like a known one, otherwise an empty string."""
    near = difflib.get_close_matches(str(name), list(known), 1)
    return f"did you mean {near[0]}? " if near else ""


def one_of_these(name: object, known: Iterable[str]) -> str:
    """How to correct an unknown name: the one that it is like, and all known ones."""
    names = list(known)
    return f"{did_you_mean(name, names)}use one of {', '.join(names)}"
