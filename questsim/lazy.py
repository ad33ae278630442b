"""Imports at first use: of a package's public names, and of a command's function."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def imported_on_use(module: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """A module's ``__getattr__`` (PEP 562) that imports public names when they are first used.

    Args:
        module: ``__name__`` of the module.
        homes: the module that each name is imported from.
    """

    def get(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        return getattr(import_module(homes[name]), name)

    return get


def imported(path: str, say: bool = False) -> Any:
    """The object at ``"package.module:name"``.

    Args:
        path: where it is.
        say: print one line to a terminal before an import that takes seconds, such as PyTorch's.
    """
    module, _, name = path.partition(":")
    if say and module not in sys.modules and sys.stderr.isatty():
        print("loading ...", file=sys.stderr, flush=True)
    return getattr(import_module(module), name)
