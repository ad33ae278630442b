"""What compiled loops share: how they are compiled, and a vector seen from a heading.

Numba keeps compiled functions on disk by the file that they stand in. After a change of a function
here that others call from their files, remove ``__pycache__``.
"""

from __future__ import annotations

from typing import Any

import numba

jit: Any = numba.njit(cache=True, nogil=True, error_model="numpy")


@jit
def turn_back(cos, sin, x, y, z, out, at):
    """Write a vector, turned about z by minus the heading, to ``out[at:at + 3]``."""
    out[at] = cos * x + sin * y
    out[at + 1] = cos * y - sin * x
    out[at + 2] = z
