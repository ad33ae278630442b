"""Strict reader of BVH files: any deviation from the format is an error that names the line.

Source: Meredith and Maddock, "Motion Capture File Formats Explained", University of Sheffield
2001. Joints may have any of the six channels, in any order. Position channels of a joint replace
its offset; if they stay near zero, they are added to it, as some exporters intend.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from questsim.errors import InputError
from questsim.motion.bvh_hierarchy import CHANNELS, Header, finite_numbers, read_hierarchy
from questsim.motion.recording import (
    AGAIN,
    MAX_LENGTH,
    Recording,
    check_rate,
    decode,
    read_bytes,
)
from questsim.rotations import as_quat

MIN_TRAVEL = 0.1
"""Of the length of all bones together, 5 to 8 m: farther than someone sways."""
CHUNK = 1000
DISPLACEMENT = 0.1
"""Position channels whose median is shorter than this share of the offset are added to it."""


def read_bvh(path: str | Path, fps: float | None = None) -> Recording:
    """Reads one BVH file.

    Args:
        path: the file.
        fps: the true frame rate; it overrides the file's frame time.

    Raises:
        InputError: the file is missing, empty, truncated or not valid BVH; the message names the
            line.
    """
    path = Path(path)
    data = read_bytes(path)
    lines = decode(data, path).splitlines()
    header, first = read_hierarchy(lines, path)
    rate, values = _read_motion(lines, first, header.num_channels, path, fps)
    if not any(c.endswith("position") for channels in header.channels for c in channels):
        raise InputError(
            f"the root {header.names[0][:40]!r} has no position channels: the motion does not say "
            "where the performer goes",
            path,
            "export with the root's position",
        )
    _check_degrees(header, values, path)
    positions, rotations = _pose(header, values)
    return Recording(
        path=path,
        names=tuple(header.names),
        parents=np.array(header.parents),
        positions=positions,
        rotations=rotations,
        fps=rate,
        sha256=hashlib.sha256(data).hexdigest(),
        tips=header.tips,
        orders=header.orders,
    )


def _check_degrees(header: Header, values: np.ndarray, path: Path) -> None:
    """Rejects rotations in radians.

    Raises:
        InputError: no rotation is above one turn in radians, but the performer travels: with angles
            of so few degrees no leg moves.
    """
    channels = [channel for joint in header.channels for channel in joint]
    turns = values[:, [channel.endswith("rotation") for channel in channels]]
    largest = abs(turns).max(initial=0.0)
    if not 0.0 < largest <= 2.0 * np.pi:
        return
    moves = values[:, [channel.endswith("position") for channel in channels]]
    size = np.linalg.norm(np.array(header.offsets[1:]), axis=-1).sum() if header.offsets[1:] else 0
    if np.ptp(moves, axis=0).max(initial=0.0) > MIN_TRAVEL * size:
        raise InputError(
            f"no rotation is above {largest:.1f}, but the performer travels: these are radians",
            path,
            "export degrees",
        )


def _nominal_fps(fps: float) -> float:
    """``fps``, rounded to a whole number if within 0.05 % of it (a rounded frame time)."""
    nearest = round(fps)
    return float(nearest) if nearest and abs(fps - nearest) < 5e-4 * nearest else fps


def _pose(header: Header, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions ``(T, J, 3)`` and rotations ``(T, J, 4)`` of the frames ``(T, C)``."""
    count = len(header.names)
    positions = np.tile(np.array(header.offsets), (len(values), 1, 1))
    rotations = np.tile([1.0, 0.0, 0.0, 0.0], (len(values), count, 1))
    turned: dict[str, list[tuple[int, list[int]]]] = {}
    column = 0
    for joint, channels in enumerate(header.channels):
        at = {channel: column + i for i, channel in enumerate(channels)}
        column += len(channels)
        moved = [channel for channel in at if channel.endswith("position")]
        if moved:
            columns = {CHANNELS.index(c): at[c] for c in moved}
            _move(positions[:, joint], values, columns)
        order = [channel for channel in channels if channel.endswith("rotation")]
        if order:
            letters = "".join(channel[0] for channel in order)
            turned.setdefault(letters, []).append((joint, [at[channel] for channel in order]))
    for letters, joints in turned.items():
        angles = values[:, [columns for _, columns in joints]]
        turns = Rotation.from_euler(letters, angles.reshape(-1, len(letters)), degrees=True)
        rotations[:, [joint for joint, _ in joints]] = as_quat(turns, angles.shape[:2])
    return positions, rotations


def _move(
    place: np.ndarray,
    values: np.ndarray,
    columns: dict[int, int],
) -> None:
    """Puts the position channels, axis to column, into a joint's ``(T, 3)``.

    Args:
        place: ``(T, 3)``, filled with the joint's offset.
        values: ``(T, C)`` all channels.
        columns: axis to column of the position channels.
    """
    axes, given = list(columns), values[:, list(columns.values())]
    offset = place[0, axes].copy()
    usual = np.median(given, axis=0)
    if np.linalg.norm(usual) < DISPLACEMENT * np.linalg.norm(offset):
        given = given + offset
    place[:, axes] = given


def _read_motion(
    lines: list[str], first: int, num_channels: int, path: Path, fps: float | None
) -> tuple[float, np.ndarray]:
    """The frame rate and the frames ``(T, C)`` of the MOTION block from line index ``first``."""
    declared, at = _value_of(lines, first, "Frames", path)
    frame_time, at = _value_of(lines, at, "Frame Time", path)
    if not np.isfinite(declared) or declared != int(declared) or declared < 1:
        raise InputError(f"Frames is {declared:g}, not a whole number above zero", path, AGAIN)
    if fps is None:
        where = f"{path}, line {at}"
        if not (np.isfinite(frame_time) and frame_time > 0):
            raise InputError(f"Frame Time is {frame_time:g}, not above zero", where, AGAIN)
        # The smallest numbers have no finite inverse.
        rate = 1.0 / max(frame_time, 1e-300)
        fps = _nominal_fps(check_rate(rate, f"Frame Time of {frame_time:g} s", where))
    rows = [(number, line) for number, line in enumerate(lines[at:], at) if line.strip()]
    if len(rows) < declared:
        raise InputError(
            f"MOTION block ends after {len(rows)} of {int(declared)} frames",
            f"{path}, line {len(lines)}",
            AGAIN,
        )
    if len(rows) > declared:
        raise InputError(
            f"{len(rows)} frames follow where Frames says {int(declared)}",
            f"{path}, line {rows[int(declared)][0] + 1}",
            AGAIN,
        )
    return fps, _read_values(rows, num_channels, path)


def _value_of(lines: list[str], at: int, name: str, path: Path) -> tuple[float, int]:
    """The number after ``name:`` in the next line that is not blank, and the index after it."""
    while at < len(lines) and not lines[at].strip():
        at += 1
    where = f"{path}, line {min(at, len(lines) - 1) + 1}"
    label, _, value = (lines[at] if at < len(lines) else "").partition(":")
    try:
        if label.lower().split() != name.lower().split():
            raise ValueError
        return float(value), at + 1
    except ValueError:
        raise InputError(f"'{name}: NUMBER' expected after MOTION", where, AGAIN) from None


def _read_values(rows: list[tuple[int, str]], num_channels: int, path: Path) -> np.ndarray:
    """The frames ``(T, C)``; every row must hold ``num_channels`` finite numbers."""
    values = np.empty((len(rows), num_channels))
    try:
        # Parsing in blocks is ten times faster than row by row; all rows at once need much memory.
        for begin in range(0, len(rows), CHUNK):
            chunk = [line for _, line in rows[begin : begin + CHUNK]]
            numbers = np.loadtxt(chunk, float, comments=None, ndmin=2)
            values[begin : begin + CHUNK] = numbers.reshape(len(chunk), num_channels)
        if np.isfinite(values).all() and abs(values).max(initial=0.0) <= MAX_LENGTH:
            return values
    except ValueError:
        pass
    # One by one, for the line of the fault; Python also reads numbers such as 1_000.
    for index, (number, line) in enumerate(rows):
        words = line.split()
        if len(words) != num_channels:
            raise InputError(
                f"frame has {len(words)} values, the channels ask for {num_channels}",
                f"{path}, line {number + 1}",
                AGAIN,
            )
        refuse = _refuse_row(path, number)
        values[index] = finite_numbers(words, num_channels, refuse)
        if abs(values[index]).max(initial=0.0) > MAX_LENGTH:
            raise refuse(f"larger than {MAX_LENGTH:g}")
    return values


def _refuse_row(path: Path, number: int) -> Callable[[str], InputError]:
    return lambda _: InputError(
        f"frame holds a value that is not a finite number up to {MAX_LENGTH:g}",
        f"{path}, line {number + 1}",
        AGAIN,
    )
