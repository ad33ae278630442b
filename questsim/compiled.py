"""Compilation of loops, their cache on disk, and shared compiled helpers.

Numba caches a compiled function in ``__pycache__`` under the date of the file that defines it. A
compiled function also contains code of the functions that it calls, the field order of its
arguments' records, and values of constants. All of these may come from other modules. ``jit``
therefore adds the content of those modules to numba's cache stamp: after an edit, every loop that
contains the edited code is compiled again.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import caching
from numba.core.runtime.nrt import rtsys

CHECKED_NUMBA = "0.68."
"""Versions of numba whose stored loops are known to load without the compiler's registries."""


def jit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a loop when it is first called, and cache it until its code changes.

    Loops take arrays and numbers. Strings, sets and dictionaries would need more of numba than
    stored loops load (``_Cache.load_overload``).

    Args:
        function: the loop; None to decorate with options.
        **options: options of ``numba.njit``, added to the project's: no GIL, numpy's error model.
    """
    if function is None:
        return lambda decorated: jit(decorated, **options)
    compiled: Any = numba.njit(nogil=True, error_model="numpy", **options)(function)
    compiled._cache = _Cache(function)
    return compiled


def inlined_code(function: Callable[..., Any]) -> str:
    """SHA-256 of the code that other modules contribute to a compiled function.

    It covers the files of all modules, direct or indirect, from which the function's module imports
    compiled functions or NamedTuples, and the constants in them.

    Args:
        function: the function before compilation; its module's imports have run.
    """
    digest, todo, seen = hashlib.sha256(), [function.__module__], set()
    while todo:
        name = todo.pop(0)
        if name in seen:
            continue
        seen.add(name)
        own = function.__globals__ if name == function.__module__ else vars(sys.modules[name])
        if name != function.__module__:  # numba itself looks at the function's own file
            digest.update(Path(str(own["__file__"])).read_bytes())
        for key, value in sorted(own.items()):
            if _is_constant(key, value):
                digest.update(f"{key}={value!r}".encode())
            elif isinstance(value, np.ndarray):
                digest.update(key.encode() + value.tobytes())
            elif _is_compiled(value) or _is_record(value):
                todo.append(value.__module__)
    return digest.hexdigest()


def _is_constant(key: str, value: Any) -> bool:
    return isinstance(value, int | float | str | tuple) and not key.startswith("__")


def _is_compiled(value: Any) -> bool:
    return hasattr(value, "py_func")


def _is_record(value: Any) -> bool:
    return isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields")


class _Stamped:
    """A cache locator of numba with ``inlined_code`` in the source stamp."""

    _function: Any

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Any:
        place = super().from_function(py_func, py_file)  # type: ignore[misc]
        if place is not None:
            place._function = py_func
        return place

    def get_source_stamp(self) -> Any:
        return super().get_source_stamp(), inlined_code(self._function)  # type: ignore[misc]


class _Impl(caching.CompileResultCacheImpl):
    _locator_classes = [  # noqa: RUF012  the name and type are numba's
        type(place.__name__, (_Stamped, place), {}) for place in caching.CacheImpl._locator_classes
    ]


class _CacheFile(caching.IndexDataCacheFile):
    """Numba's, but files that cannot be read count as missing.

    Numba unpickles them before it compares stamps. That fails if a record that a loop takes was
    renamed since, and if a file is damaged.
    """

    def _load_index(self) -> dict[Any, str]:
        try:
            return super()._load_index()
        except PermissionError:
            raise
        except Exception:  # unpickling can raise anything
            return {}

    def load(self, key: Any) -> Any:
        try:
            return super().load(key)
        except Exception:
            return None  # the loop is compiled


class _Cache(caching.FunctionCache):
    _impl_class = _Impl

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        made: Any = self._cache_file
        self._cache_file = _CacheFile(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=made._source_stamp,
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Numba's, but without loading all that numba can compile, which takes 0.2 s of CPU.

        Stored machine code needs only numba's runtime. The compiler loads the rest itself as soon
        as it has something to compile. Checked with this version of numba; others load everything.
        """
        if not numba.__version__.startswith(CHECKED_NUMBA):
            return super().load_overload(sig, target_context)
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():  # type: ignore[attr-defined]
            return self._load_overload(sig, target_context)  # type: ignore[attr-defined]
        return None  # reading failed; the loop is compiled


@jit
def turn_back(cos, sin, x, y, z, out, at):
    """Write a vector, turned about z by minus the heading, to ``out[at:at + 3]``."""
    out[at] = cos * x + sin * y
    out[at + 1] = cos * y - sin * x
    out[at + 2] = z
