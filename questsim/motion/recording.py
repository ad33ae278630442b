"""A motion as stored in its file, and reading of the file's bytes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from questsim.errors import InputError

AGAIN = "download or export the file again"
MAX_FILE_BYTES = 512 << 20
"""Larger files are rejected. 512 MiB holds over half an hour of 75 joints at 120 Hz."""
NOT_THE_FILE = {
    b"version https://git-lfs": ("is a Git LFS pointer, not the file", "run 'git lfs pull'"),
    b"<!doctype html": ("is a web page, not the file", AGAIN),
    b"<html": ("is a web page, not the file", AGAIN),
}
"""What a download may bring instead of a motion file: its beginning, what it is, what to do."""
MIN_FPS, MAX_FPS = 10.0, 1000.0
"""Frame rates outside this range are file errors, e.g. a rate in place of the frame time."""
MAX_LENGTH = 1e6
"""Positions and bones longer than a million units are file errors."""


@dataclass(frozen=True)
class Recording:
    """A motion as stored in its file, with the file's joints, units and axes.

    Attributes:
        path: the file.
        names: the ``J`` joint names, parents before children.
        parents: ``(J,)`` index of each parent; the root's is -1.
        positions: ``(T, J, 3)`` of each joint in its parent's frame, in the file's units.
        rotations: ``(T, J, 4)`` local rotations, unit quaternions wxyz.
        fps: frames a second.
        sha256: hexadecimal SHA-256 of the file.
        tips: joint index to ``(3,)`` end of the bone of a leaf joint, in that joint's frame;
            joints without an end in the file are absent.
        notes: what the reader changed or assumed, for the report.
        orders: of the rotation channels, by joint, e.g. ``"ZXY"``; empty in files without.
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
    orders: Mapping[str, str] = field(default_factory=dict)


def read_bytes(path: Path) -> bytes:
    """The file's content; InputError if it is missing, unreadable, empty or too large."""
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            size = path.stat().st_size / 2**20
            raise InputError(f"is {size:.0f} MiB large, more than 512", path, "cut it in parts")
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file", path) from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", path) from None
    begin = data[:1024].lstrip().lower()
    if not begin and not data.strip():
        raise InputError("is empty", path, AGAIN)
    for beginning, (what, fix) in NOT_THE_FILE.items():
        if begin.startswith(beginning):
            raise InputError(what, path, fix)
    return data


def decode(data: bytes, path: Path) -> str:
    """The text of a file in UTF-8 or, failing that, in Shift-JIS or Latin-1.

    Keywords and numbers are ASCII in all three encodings; joint names may not be.

    Raises:
        InputError: the file is binary.
    """
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encodings = ["utf-16"]
    elif b"\0" in data:
        raise InputError("is not a text file", path, "give a motion file")
    else:
        # Japanese letters form runs of high bytes; accented letters stand alone among ASCII.
        begin = data[:100_000]
        high = [] if begin.isascii() else re.findall(rb"[\x80-\xff]+", begin)
        rows = sum(len(run) > 1 for run in high) > len(high) / 2
        encodings = ["utf-8-sig", *(["shift_jis"] if rows else []), "latin-1"]
    for encoding in encodings:
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            continue
    raise InputError("is not a text file", path, "give a motion file")


def check_rate(fps: float, what: str, where: str | Path) -> float:
    """Returns ``fps`` if it is a plausible recording rate.

    Raises:
        InputError: it is outside ``MIN_FPS`` to ``MAX_FPS``; ``what`` names its origin.
    """
    if not MIN_FPS <= fps <= MAX_FPS:
        raise InputError(
            f"{what} means {fps:.3g} frames a second, not {MIN_FPS:g}-{MAX_FPS:g}",
            where,
            "declare the true rate with --fps",
        )
    return fps
