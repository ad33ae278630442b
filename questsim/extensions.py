"""Modules of other packages that add reward terms, terrains, data sets, skeletons or systems.

Such a module calls a registration function when it is imported: ``questsim.reward.register_term``,
``envs.terrain.register_terrain``, ``questsim.motion.datasets.register_dataset``,
``questsim.motion.families.register_family``, ``agents.kinematic.registry.register_system``. The
command line imports it first if an installed package declares it as an entry point of the group
``questsim.extensions``, or if the variable ``QUESTSIM_EXTENSIONS`` names it.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any

from questsim.errors import InputError

GROUP = "questsim.extensions"
VARIABLE = "QUESTSIM_EXTENSIONS"
"""Variable with module names, separated by commas; the current folder is searched too."""


def same_source(old: Callable[..., Any], new: Callable[..., Any]) -> bool:
    """Whether a function is a redefinition of an earlier one, as in notebooks."""
    return old.__qualname__ == new.__qualname__ and (
        old.__module__ == new.__module__ or old.__code__.co_filename == new.__code__.co_filename
    )


def load_extensions() -> tuple[str, ...]:
    """Import every extension; returns the names of their modules.

    Raises:
        InputError: a module cannot be imported, or its registration is rejected.
    """
    found = [(point.value, f"entry point {point.name!r}") for point in entry_points(group=GROUP)]
    named = [name.strip() for name in os.environ.get(VARIABLE, "").split(",") if name.strip()]
    if named and not {"", os.getcwd()} & set(sys.path):
        sys.path.append(os.getcwd())
    found += [(name, VARIABLE) for name in named]
    for name, where in found:
        try:
            importlib.import_module(name)
        except ImportError as error:
            raise InputError(f"cannot import {name!r} ({error})", where) from error
    return tuple(dict.fromkeys(name for name, _ in found))
