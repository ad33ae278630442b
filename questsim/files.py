"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

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


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """A folder beside ``folder`` that takes its place when the block is done, and not before.

    If the block raises, what was at ``folder`` stays and nothing else is left. A process that is
    killed in between leaves what ``recover_folder`` puts right.

    Raises:
        InputError: it cannot be written, or there is no space left.
    """
    recover_folder(folder)
    fresh, old = _beside(folder)
    shutil.rmtree(fresh, ignore_errors=True)
    try:
        fresh.mkdir(parents=True)
        yield fresh
        shutil.rmtree(old, ignore_errors=True)
        if folder.exists():
            folder.rename(old)
        fresh.rename(folder)
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror or error})", folder) from error
    finally:
        if folder.exists():
            shutil.rmtree(fresh, ignore_errors=True)
            shutil.rmtree(old, ignore_errors=True)
        elif not old.exists():
            shutil.rmtree(fresh, ignore_errors=True)


def recover_folder(folder: Path) -> None:
    """Finish what ``whole_folder`` was killed in, between its two renames.

    The old folder is moved away only when the new one is whole. So where both are there and the
    folder is not, the new one takes its place.
    """
    fresh, old = _beside(folder)
    if not folder.exists() and old.exists():
        (fresh if fresh.exists() else old).rename(folder)
        shutil.rmtree(old, ignore_errors=True)


def _beside(folder: Path) -> tuple[Path, Path]:
    """Where the new folder is made, and where the old one waits for it."""
    return folder.with_name(folder.name + ".new"), folder.with_name(folder.name + ".old")


def read_yaml(path: Path, what: str) -> dict[str, Any]:
    """A YAML file that holds a mapping.

    Args:
        path: the file.
        what: it should be, for the message.

    Raises:
        FileNotFoundError: there is no file.
        InputError: it cannot be read, is no YAML, or holds something else.
    """
    try:
        value = parse_yaml(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", path) from error
    except ValueError as error:
        raise InputError(f"is no {what}", path) from error
    if not isinstance(value, dict):
        raise InputError(f"is no {what}", path)
    return value


def parse_yaml(text: str) -> Any:
    """The value of a YAML text.

    Raises:
        ValueError: it is no YAML; also for dates that do not exist, numbers of thousands of
            digits, and nesting that is too deep.
    """
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ValueError("no YAML") from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
