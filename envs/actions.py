"""What a face of the environment is given to do, checked before any of it is done."""

from __future__ import annotations

from typing import Any

import numpy as np

from questsim.errors import InputError


def checked_actions(actions: Any, shape: tuple[int, ...], what: str = "action") -> np.ndarray:
    """Actions as an array of finite numbers of a shape.

    Args:
        actions: what was given.
        shape: that of the action space.
        what: it is called, for the error.

    Raises:
        InputError: another shape, which is not broadcast, other things than numbers, or a number
            that is not finite.
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
