"""A motion as its file has it, and the file's bytes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from questsim.errors import InputError

AGAIN = "download or export the file again"
MAX_FILE_BYTES = 1 << 30
"""A motion file larger than 1 GiB is refused: an hour at 120 Hz is less than half of it."""


@dataclass(frozen=True)
class Recording:
    """A motion as its file has it: its own joints, units and axes.

    Attributes:
        path: the file.
        names: the ``J`` joint names, parents before children.
        parents: ``(J,)`` index of each parent; the root's is -1.
        positions: ``(T, J, 3)`` of each joint in its parent's frame, in the file's units.
        rotations: ``(T, J, 4)`` local rotations, unit quaternions wxyz.
        fps: frames a second.
        sha256: hexadecimal SHA-256 of the file.
        tips: ``(3,)`` where the bone of a last joint ends, in that joint's frame, by joint
            index; joints whose file does not say it are missing.
        notes: what the reader changed or assumed, for the report.
    """

    path: Path
    names: tuple[str, ...]
    parents: np.ndarray
    positions: np.ndarray
    rotations: np.ndarray
    fps: float
    sha256: str
    tips: Mapping[int, np.ndarray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def read_bytes(path: Path) -> bytes:
    """The file's content; InputError where it is missing, unreadable, empty or too large."""
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            size = path.stat().st_size / 2**30
            raise InputError(f"is {size:.1f} GiB large, more than 1 GiB", path, "cut it in parts")
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file", path) from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", path) from None
    if not data.strip():
        raise InputError("is empty", path, AGAIN)
    return data


def decode(data: bytes, path: Path) -> str:
    """The text of a file in UTF-8 or, where it is not that, in an older encoding.

    The keywords and numbers of motion files are ASCII in all of them, joint names may be not:
    Shift-JIS is tried before Latin-1, which fits any bytes.

    Raises:
        InputError: the file is binary.
    """
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encodings = ["utf-16"]
    elif b"\0" in data:
        raise InputError("is not a text file", path, "give a motion file")
    else:
        encodings = ["utf-8-sig", "shift_jis", "latin-1"]
    for encoding in encodings:
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            continue
    raise InputError("is not a text file", path, "give a motion file")
