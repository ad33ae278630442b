"""Names of the export formats; this module does not import the writers."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Sequence
from pathlib import Path

from questsim.errors import InputError

FORMATS = ("bvh", "glb", "npz", "csv")
SKELETONS = ("joints", "avatar")


def check_format(name: str, where: str) -> str:
    """The format of a name such as ``bvh`` or ``.BVH``.

    Raises:
        InputError: it is none of ``FORMATS``.
    """
    plain = name.lower().removeprefix(".")
    if plain not in FORMATS:
        raise InputError(f"{name!r} is not one of {', '.join(FORMATS)}", where)
    return plain


def needs(package: str, where: str | Path) -> None:
    """Check that an optional package is installed.

    Raises:
        InputError: it is missing; names the package and the command that installs it.
    """
    if importlib.util.find_spec(package) is None:
        fix = "install it, as with pip install 'questsim[live]'"
        raise InputError(f"needs the Python package {package}", where, fix)


def safe_names(names: Sequence[str]) -> list[str]:
    """Make unique file names, without separators, from names of clips."""
    out: list[str] = []
    for name in names:
        plain = re.sub(r"[^\w.+-]+", "_", name).lstrip(".") or "motion"
        count, fresh = 1, plain
        while fresh in out:
            count += 1
            fresh = f"{plain}-{count}"
        out.append(fresh)
    return out
