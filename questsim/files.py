"""Atomic writing of files and folders, and reading of YAML and TOML."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from questsim.errors import InputError


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """A temporary file beside ``path``, with its ending; replaces ``path`` when the block ends.

    If the block raises, also by Ctrl-C, the temporary file is removed and ``path`` is unchanged.

    Raises:
        InputError: the folder is missing, cannot be written, or is full.
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
            # Temporary files are private; give this one the usual permissions.
            fresh.chmod(0o666 & ~_umask())
            fresh.replace(path)
        finally:
            fresh.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror or error})", path) from error


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """A temporary folder beside ``folder``; replaces it when the block ends.

    If the block raises, ``folder`` is unchanged and the temporary folder is removed. After a killed
    process ``recover_folder`` restores the folder.

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
    """Complete a ``whole_folder`` that was killed between its two renames.

    The old folder is moved away only when the new one is complete. So if both exist and ``folder``
    does not, the new one replaces it.
    """
    fresh, old = _beside(folder)
    if not folder.exists() and old.exists():
        (fresh if fresh.exists() else old).rename(folder)
        shutil.rmtree(old, ignore_errors=True)


def _beside(folder: Path) -> tuple[Path, Path]:
    """Paths of the new folder while it is made, and of the old one while it is replaced."""
    return folder.with_name(folder.name + ".new"), folder.with_name(folder.name + ".old")


def read_yaml(path: Path, what: str) -> dict[str, Any]:
    """Read a YAML file that contains a mapping.

    Args:
        path: the file.
        what: the expected content, for error messages.

    Raises:
        FileNotFoundError: the file does not exist.
        InputError: it cannot be read, is not YAML, or contains something else.
    """
    try:
        value = parse_yaml(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", path) from error
    except ValueError as error:
        raise InputError(f"is not a valid {what}", path) from error
    if not isinstance(value, dict):
        raise InputError(f"is not a valid {what}", path)
    return value


def parse_json(text: str) -> Any:
    """The value of a JSON text.

    Raises:
        ValueError: it is no JSON; also for numbers of thousands of digits and nesting that is too
            deep. The message is short.
    """
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"{error.msg}: line {error.lineno}") from None
    except RecursionError:
        raise ValueError("nested too deeply") from None
    except ValueError:
        raise ValueError("a number is too long") from None


def parse_yaml(text: str) -> Any:
    """Parse a YAML text.

    Raises:
        ValueError: it is not YAML, or has invalid dates, numbers with thousands of digits, or too
            deep nesting.
    """
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ValueError("no YAML") from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def read_toml(path: Path, what: str, fix: str | None = None) -> dict[str, Any]:
    """The table of a TOML file that a user writes.

    Args:
        path: the file.
        what: the kind of file, for the message, e.g. ``"mixture file"``.
        fix: what to do if it cannot be read.

    Raises:
        InputError: there is no such file, or it is not TOML.
    """
    try:
        # Editors on Windows begin files with a byte order mark.
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise InputError(f"no such {what}", path, fix) from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{what} cannot be read ({str(error)[:120]})", path, fix) from None
