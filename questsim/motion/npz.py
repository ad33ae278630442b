"""Arrays of .npz files, checked before memory is allocated for them."""

from __future__ import annotations

import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np

from questsim.errors import InputError
from questsim.motion.recording import AGAIN

_KINDS = "biufUS"
BOMB_BYTES, BOMB_RATIO = 64 << 20, 50
"""Arrays above this size with a higher compression ratio are rejected: they hold no motion."""


class Archive:
    """The arrays of an open .npz, each read when it is asked for.

    Attributes:
        files: the arrays' names.
    """

    def __init__(self, file: zipfile.ZipFile, path: Path, limit: int) -> None:
        self._file, self._path, self._limit = file, path, limit
        self._entries = {
            entry.filename.removesuffix(".npy"): entry
            for entry in file.infolist()
            if entry.filename.endswith(".npy")
        }
        self.files = list(self._entries)

    def __getitem__(self, key: str) -> np.ndarray:
        """The array ``key``.

        Raises:
            KeyError: there is none.
            InputError: it holds objects, is larger than the limit or than what it says.
        """
        entry = self._entries[key]
        with self._file.open(entry) as stream:
            shape, dtype = self._header(stream, key)
            size = dtype.itemsize
            for length in shape:
                size *= length  # Python's integers do not overflow
            if dtype.kind not in _KINDS:
                raise InputError(f"{key} holds {dtype}, not numbers or text", self._path, AGAIN)
            if size > self._limit:
                raise InputError(
                    f"{key} takes {size / 2**20:.0f} MiB, more than {self._limit >> 20} MiB",
                    self._path,
                    "cut the motion in parts",
                )
            if size > BOMB_BYTES and size > BOMB_RATIO * entry.compress_size:
                raise InputError(
                    f"{key} unpacks {entry.compress_size / 2**20:.1f} MiB to {size >> 20} MiB",
                    self._path,
                    AGAIN,
                )
            if size > entry.file_size:
                raise InputError(f"{key} is shorter than its shape {shape}", self._path, AGAIN)
        with self._file.open(entry) as stream:
            return np.lib.format.read_array(stream, allow_pickle=False)

    def _header(self, stream: IO[bytes], key: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
        version = np.lib.format.read_magic(stream)
        read = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }.get(version)
        if read is None:
            raise InputError(f"{key} is of array format {version}", self._path, AGAIN)
        shape, _, dtype = read(stream)
        return shape, dtype


@contextmanager
def open_npz(path: Path, limit: int, what: str = ".npz") -> Iterator[Archive]:
    """The archive at ``path``; whatever is wrong with it, then or later, is an ``InputError``.

    Args:
        path: the file.
        limit: bytes that an array may take.
        what: what the file should be, for the message.
    """
    try:
        with zipfile.ZipFile(path) as file:
            yield Archive(file, path, limit)
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError("no such file", path) from None
    except KeyError as error:
        raise InputError(f"lacks {str(error.args[0])[:80]!r}", path, AGAIN) from None
    except (
        OSError, ValueError, EOFError, RuntimeError, SyntaxError, TypeError, MemoryError,
        OverflowError, IndexError, NotImplementedError, struct.error, tokenize.TokenError,
        zipfile.BadZipFile, zlib.error,
    ) as error:  # fmt: skip
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"cannot be read as {what} ({reason})", path, AGAIN) from None
