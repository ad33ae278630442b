"""Checks of the values that users give for the options of an environment."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from numbers import Integral, Real
from typing import Any, NamedTuple

from questsim.errors import InputError, value_text


def is_whole(value: Any) -> bool:
    """Whether it is a whole number, of Python or NumPy."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def is_number(value: Any) -> bool:
    """Whether it is a real number, of Python or NumPy."""
    return isinstance(value, Real) and not isinstance(value, bool)


class Form(NamedTuple):
    """The accepted values of an option.

    Attributes:
        takes: the values in words, for messages.
        accepts: whether it takes a value.
        gym_takes: what ``gym.make`` takes instead, in words.
    """

    takes: str
    accepts: Callable[[Any], bool]
    gym_takes: str | None = None


def check_forms(config: Any, forms: Mapping[str, Form]) -> None:
    """Reject a field of the wrong type.

    Args:
        config: a dataclass of options.
        forms: the accepted values by field.

    Raises:
        InputError: with the field's name and what it takes.
    """
    for name, form in forms.items():
        value = getattr(config, name)
        if not form.accepts(value):
            what = f"{name} is {value_text(value)}; it takes {form.takes}"
            fix = form.gym_takes and f"gym.make also takes {form.gym_takes}"
            raise InputError(what, type(config).__name__, fix)


def check_count(name: str, value: Any) -> None:
    """Reject what is not a whole number from 1 on.

    Raises:
        InputError: with the name of the argument.
    """
    if not is_whole(value) or value < 1:
        raise InputError(f"is {value_text(value)}; it takes a whole number from 1 on", name)


def check_range(
    name: str,
    low_high: tuple[float, float],
    least: float,
    most: float,
    where: str,
    *,
    whole: bool = False,
) -> None:
    """Reject a range that is not ``least <= low <= high <= most``.

    Args:
        name, where: for the message.
        low_high: the range.
        least, most: its limits.
        whole: whether it must be of whole numbers.

    Raises:
        InputError: with the name of the field.
    """
    try:
        low, high = low_high
        good = least <= low <= high <= most and not (whole and (low % 1 or high % 1))
    except (TypeError, ValueError):
        good = False
    if not good:
        raise InputError(
            f"{name} is {value_text(low_high)}, not a range {'of whole numbers ' * whole}within "
            f"{least:g} to {most:g}",
            where,
            "give the least and the greatest value",
        )


def check_number(name: str, value: Any, least: float, most: float, where: str) -> None:
    """Reject what is not a number from ``least`` to ``most``.

    Raises:
        InputError: with the name of the field.
    """
    if not (is_number(value) and least <= value <= most):
        what = f"{name} is {value_text(value)}, not a number from {least:g} to {most:g}"
        raise InputError(what, where)
