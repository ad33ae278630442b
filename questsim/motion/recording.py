"""A motion as its file has it, and the file's bytes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from questsim.errors import InputError

AGAIN = "download or export the file again"
MAX_FILE_BYTES = 512 << 20
"""A motion file larger than 512 MiB is refused: half an hour at 120 Hz of 75 joints is less."""
MIN_FPS, MAX_FPS = 10.0, 1000.0
"""Frame rates beyond these are errors of the file, such as a rate where the time should be."""
MAX_LENGTH = 1e6
"""Positions and bones beyond a million units are errors of the file."""


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
            size = path.stat().st_size / 2**20
            raise InputError(f"is {size:.0f} MiB large, more than 512", path, "cut it in parts")
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file", path) from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", path) from None
    if not data.strip():
        raise InputError("is empty", path, AGAIN)
    return data


def decode(data: bytes, path: Path) -> str:
    """The text of a file in UTF-8 or, where it is not that, in Shift-JIS or Latin-1.

    The keywords and numbers of motion files are ASCII in all of them, joint names may be not.

    Raises:
        InputError: the file is binary.
    """
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encodings = ["utf-16"]
    elif b"\0" in data:
        raise InputError("is not a text file", path, "give a motion file")
    else:
        # Japanese letters come in rows of high bytes, accented ones alone among ASCII.
        high = re.findall(rb"[\x80-\xff]+", data[:100_000])
        rows = sum(len(run) > 1 for run in high) > len(high) / 2
        encodings = ["utf-8-sig", *(["shift_jis"] if rows else []), "latin-1"]
    for encoding in encodings:
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            continue
    raise InputError("is not a text file", path, "give a motion file")


def check_rate(fps: float, what: str, where: str | Path) -> float:
    """``fps``, if a motion can have been recorded at it.

    Raises:
        InputError: it is not within ``MIN_FPS`` to ``MAX_FPS``; ``what`` says what gave it.
    """
    if not MIN_FPS <= fps <= MAX_FPS:
        raise InputError(
            f"{what} means {fps:.3g} frames a second, not {MIN_FPS:g}-{MAX_FPS:g}",
            where,
            "declare the true rate with --fps",
        )
    return fps
