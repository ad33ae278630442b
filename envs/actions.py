"""Validation of actions before a step."""

from __future__ import annotations

from typing import Any

import numpy as np

from questsim.errors import InputError


def checked_actions(actions: Any, shape: tuple[int, ...], what: str = "action") -> np.ndarray:
    """Validate actions and return them as an array of finite numbers.

    Args:
        actions: the actions as passed by the caller.
        shape: shape of the action space.
        what: name of the argument in error messages.

    Raises:
        InputError: the shape differs (actions are not broadcast), a value is not a number, or a
            number is not finite.
    """
    try:
        array = np.asarray(actions)
    except ValueError:  # rows of different lengths
        array = np.empty(0, object)
    if array.dtype.kind not in "fiu":
        kind = type(actions).__name__ if array.dtype.kind == "O" else str(array.dtype)
        raise InputError(f"is {kind}, not an array of numbers {shape}", what)
    if array.shape != shape:
        raise InputError(f"has shape {array.shape}, not {shape}", what)
    if not np.isfinite(array).all():
        at = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        where = f"{what}[{', '.join(map(str, at))}]"
        raise InputError(f"is {array[at]}, not a finite number", where)
    return array
