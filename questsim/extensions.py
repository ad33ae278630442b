"""Modules of other packages that add reward terms, terrains, data sets, skeletons or systems.

Such a module calls a registration function when it is imported: ``questsim.reward.register_term``,
``envs.terrain.register_terrain``, ``questsim.motion.datasets.register_dataset``,
``questsim.motion.families.register_family``, ``agents.kinematic.registry.register_system``. The
command line imports it first if an installed package declares it as an entry point of the group
``questsim.extensions``, or if the variable ``QUESTSIM_EXTENSIONS`` names it. In Python, an unknown
terrain, reward term, data set or family of a trained system imports them too, so that ``gym.make``
finds them without the command line, also in worker processes. The versions in the record of a run
list what was imported.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import sys
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from questsim.errors import InputError

GROUP = "questsim.extensions"
VARIABLE = "QUESTSIM_EXTENSIONS"
"""Variable with module names, separated by commas; the current folder is searched too."""
_imported: dict[str, str] = {}


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
    points = entry_points(group=GROUP)
    found = [(point.module, f"entry point {point.name!r}") for point in points]
    named = [name.strip() for name in os.environ.get(VARIABLE, "").split(",") if name.strip()]
    if named and not {"", os.getcwd()} & set(sys.path):
        sys.path.append(os.getcwd())
    found += [(name, VARIABLE) for name in named]
    for name, where in found:
        try:
            module = importlib.import_module(name)
        except ImportError as error:
            raise InputError(f"cannot import {name!r} ({error})", where) from error
        packages = [point.dist.version for point in points if point.module == name and point.dist]
        _imported[name] = packages[0] if packages else _content(module)
    return tuple(dict.fromkeys(name for name, _ in found))


def _content(module: ModuleType) -> str:
    """A hash of a module's file in place of a version."""
    file = Path(module.__file__ or "")
    return f"sha256 {hashlib.sha256(file.read_bytes()).hexdigest()}" if file.is_file() else ""


def extension_versions() -> dict[str, str]:
    """Modules imported by ``load_extensions``, with their packages' versions.

    A module that only ``QUESTSIM_EXTENSIONS`` names has the hash of its file instead.
    """
    return dict(_imported)
