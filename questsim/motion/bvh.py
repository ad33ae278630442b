"""BVH files: a strict check of the text, then upc-pymotion reads it.

pymotion is lenient (a truncated file becomes zeros, a mis-ordered channel a ``KeyError``), so
every file is checked line by line first and refused with the line that is wrong.
"""

from __future__ import annotations

import hashlib
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from questsim.errors import InputError
from questsim.motion.recording import AGAIN, Recording, read_bytes
from questsim.rotations import as_quat

POSITIONS = ("Xposition", "Yposition", "Zposition")
ROTATIONS = {"Xrotation", "Yrotation", "Zrotation"}


def read_bvh(path: str | Path) -> Recording:
    """Reads one BVH file.

    Raises:
        InputError: the file is missing, empty, truncated or not what BVH prescribes; the
            message names the line.
    """
    path = Path(path)
    data = read_bytes(path)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError("is not a text file", path, "give a BVH file") from None
    lines = text.splitlines()
    header, first = _check_hierarchy(lines, path)
    frame_time, rows = _check_motion(lines, first, header.num_channels, path)
    loaded = _load(header, frame_time, rows).data
    parents = np.array(loaded["parents"], int)
    parents[0] = -1
    return Recording(
        path=path,
        names=tuple(header.names),
        parents=parents,
        positions=np.asarray(loaded["positions"], float),
        rotations=_quaternions(loaded["rotations"], loaded["rot_order"]),
        fps=_nominal_fps(1.0 / frame_time),
        sha256=hashlib.sha256(data).hexdigest(),
    )


def _nominal_fps(fps: float) -> float:
    """``fps`` or, within 0.05 %, the whole number that a rounded frame time stood for."""
    nearest = round(fps)
    return float(nearest) if nearest and abs(fps - nearest) < 5e-4 * nearest else fps


def _quaternions(degrees: np.ndarray, orders: np.ndarray) -> np.ndarray:
    """Quaternions ``(T, J, 4)`` of Euler angles ``(T, J, 3)`` in each joint's channel order.

    pymotion's own conversion gives the same at twice the whole file's reading time.
    """
    quat = np.empty((*degrees.shape[:2], 4))
    names = np.array(["".join(order).upper() for order in orders])
    for order in np.unique(names):
        joints = names == order
        angles = degrees[:, joints]
        turns = Rotation.from_euler(str(order), angles.reshape(-1, 3), degrees=True)
        quat[:, joints] = as_quat(turns, angles.shape[:2])
    return quat


@dataclass
class _Header:
    """What the HIERARCHY block declares, and its lines with the joints called j0, j1, ..."""

    names: list[str] = field(default_factory=list)
    num_channels: int = 0
    plain_lines: list[str] = field(default_factory=list)


def _check_hierarchy(lines: list[str], path: Path) -> tuple[_Header, int]:
    """Checks lines up to ``MOTION``; returns the header and the index of the line after it."""
    header = _Header()
    depth, in_end_site, expected, roots = 0, False, "HIERARCHY", 0

    def refuse(number: int, what: str, fix: str = AGAIN) -> InputError:
        return InputError(what, f"{path}, line {number + 1}", fix)

    for number, line in enumerate(lines):
        words = line.split()
        if not words:
            continue
        keyword = words[0]
        if expected and keyword != expected:
            raise refuse(number, f"{expected} expected, found {keyword[:40]!r}", "give a BVH file")
        expected = ""
        if keyword == "MOTION":
            if depth or not header.names:
                raise refuse(number, "MOTION before the end of the joint hierarchy")
            return header, number + 1
        plain = " ".join(words)
        if keyword in ("ROOT", "JOINT"):
            roots += keyword == "ROOT"
            if len(words) < 2 or words[-1] == "{" or len(words) > 2:
                raise refuse(
                    number,
                    f"{keyword} needs one name and nothing else on its line",
                    "write joint names without spaces and each brace on its own line",
                )
            if words[1] in header.names:
                raise refuse(number, f"joint {words[1]!r} appears twice", "give joints other names")
            if roots > 1 or (keyword == "JOINT" and not roots):
                raise refuse(number, "a BVH file has one ROOT", "keep one person a file")
            plain = f"{keyword} j{len(header.names)}"
            header.names.append(words[1])
            expected = "{"
        elif keyword == "End":
            in_end_site, expected = True, "{"
        elif keyword == "{":
            depth, expected = depth + 1, "OFFSET"
        elif keyword == "}":
            depth, in_end_site = depth - 1, False
            if depth < 0:
                raise refuse(number, "one closing brace too many")
        elif keyword == "OFFSET":
            _numbers(words[1:], 3, lambda what, n=number: refuse(n, what))
            expected = "" if in_end_site else "CHANNELS"
        elif keyword == "CHANNELS":
            header.num_channels += _check_channels(words[1:], lambda *a, n=number: refuse(n, *a))
        elif keyword != "HIERARCHY":
            raise refuse(number, f"unknown keyword {keyword[:40]!r}", "give a BVH file")
        header.plain_lines.append(plain)
    raise refuse(len(lines) - 1, "file ends inside the joint hierarchy: no MOTION block")


def _check_channels(words: list[str], refuse) -> int:
    """Refuses channel layouts that pymotion reads wrongly or not at all; returns the count."""
    count, channels = words[:1], words[1:]
    if count not in (["3"], ["6"]):
        raise refuse(
            f"a joint with {' '.join(count) or 'no number of'} channels cannot be read",
            "export with three rotation channels a joint (six with position)",
        )
    if len(channels) != int(count[0]):
        raise refuse(f"CHANNELS {count[0]} is followed by {len(channels)} names")
    positions, rotations = channels[:-3], channels[-3:]
    if set(rotations) != ROTATIONS or (positions and set(positions) != set(POSITIONS)):
        raise refuse(
            f"channel order {' '.join(channels)} cannot be read",
            "export with X/Y/Zposition before the three rotation channels",
        )
    return len(channels)


def _numbers(words: list[str], count: int, refuse) -> None:
    try:
        values = np.array(words, float)
    except ValueError:
        raise refuse(f"{' '.join(words)[:40]!r} is not {count} numbers") from None
    if len(values) != count or not np.isfinite(values).all():
        raise refuse(f"{' '.join(words)[:40]!r} is not {count} finite numbers")


def _check_motion(
    lines: list[str], first: int, num_channels: int, path: Path
) -> tuple[float, list[tuple[int, str]]]:
    """Checks the MOTION block from line index ``first``; frame time and numbered frames."""
    declared, at = _value_of(lines, first, "Frames", path)
    frame_time, at = _value_of(lines, at, "Frame Time", path)
    if declared != int(declared) or declared < 1:
        raise InputError(f"Frames is {declared:g}, not a whole number above zero", path, AGAIN)
    if not (np.isfinite(frame_time) and frame_time > 0):
        raise InputError(f"Frame Time is {frame_time:g}, not above zero", path, AGAIN)
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
    _check_values(rows, num_channels, path)
    return frame_time, rows


def _value_of(lines: list[str], at: int, name: str, path: Path) -> tuple[float, int]:
    """The number after ``name:`` in the next line that is not blank, and the index after it."""
    while at < len(lines) and not lines[at].strip():
        at += 1
    where = f"{path}, line {min(at, len(lines) - 1) + 1}"
    label, _, value = (lines[at] if at < len(lines) else "").partition(":")
    try:
        if label.split() != name.split():
            raise ValueError
        return float(value), at + 1
    except ValueError:
        raise InputError(f"'{name}: NUMBER' expected after MOTION", where, AGAIN) from None


def _check_values(rows: list[tuple[int, str]], num_channels: int, path: Path) -> None:
    """Every row must hold ``num_channels`` finite numbers."""
    for number, line in rows:
        count = len(line.split())
        if count != num_channels:
            raise InputError(
                f"frame has {count} values, the channels ask for {num_channels}",
                f"{path}, line {number + 1}",
                AGAIN,
            )
    try:
        # One conversion for the whole block: ten times faster than one a value.
        values = np.array(" ".join(line for _, line in rows).split(), float)
        if np.isfinite(values).all():
            return
    except ValueError:
        pass
    for number, line in rows:
        _numbers(line.split(), num_channels, _refuse_row(path, number))


def _refuse_row(path: Path, number: int):
    return lambda what: InputError(
        "frame holds a value that is not a finite number", f"{path}, line {number + 1}", AGAIN
    )


def _load(header: _Header, frame_time: float, rows: list[tuple[int, str]]) -> Any:
    """A checked file as pymotion's ``BVH`` reads it.

    It gets a plain copy, because its parser finds keywords anywhere in a line (in a joint's
    name too) and stumbles over blank lines and ``Frames:12``.
    """
    from pymotion.io.bvh import BVH  # late, for PyTorch, which it imports

    bvh = BVH()
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "plain.bvh"
        fields = ["MOTION", f"Frames: {len(rows)}", f"Frame Time: {frame_time!r}"]
        plain = [*header.plain_lines, *fields, *(line for _, line in rows)]
        copy.write_text("\n".join(plain) + "\n", encoding="utf-8")
        bvh.load(str(copy))
    return bvh
