"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from questsim.errors import InputError


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """A file beside ``path``, with its ending, that takes its place when the block is done.

    If the block raises, Ctrl-C included, it is removed, and what was at ``path`` stays.

    Raises:
        InputError: the folder is not there or cannot be written, or is full.
    """
    path = Path(path)
    try:
        handle, name = tempfile.mkstemp(
            prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent
        )
        os.close(handle)
        fresh = Path(name)
        try:
            yield fresh
            # Temporary files are private; this one is for those who may read its folder.
            fresh.chmod(0o666 & ~_umask())
            fresh.replace(path)
        finally:
            fresh.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror or error})", path) from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
