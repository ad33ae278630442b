"""Recordings of a user's devices: our own format, iwer's, and CSV.

Our own is text, compressed by gzip (``.jsonl.gz``). Its first line is a JSON object::

    {"format": "questsim-recording", "version": 1, "convention": "openxr", "calibration": null}

Every further line is a frame: ``t`` in seconds, and for each device that reports its position and
quaternion, seven numbers in the order and the axes of the convention::

    {"t": 12.0138, "headset": [0.1, 1.63, -0.2, 0, 0, 0, 1], "left_controller": [...]}
"""

from __future__ import annotations

import csv
import gzip
import io
import json
import math
import zlib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from questsim.devices import DeviceFrame, convention_named, from_ours
from questsim.errors import InputError
from questsim.files import parse_json, whole_file
from questsim.sensors import DEVICES

FORMAT, VERSION = "questsim-recording", 1
SUFFIX = ".jsonl.gz"
DECIMALS = 5
EXAMPLE = "synthetic"
"""Name of the shipped recording, two minutes of a user who does not exist."""
MAX_FRAMES = 1_000_000
"""Greatest number of frames in a file: three hours at 90 Hz."""
MAX_LINE = 100_000
"""Greatest number of characters in a line; a frame has a few hundred."""
MAX_TEXT_BYTES = 512 << 20
"""Greatest size of a file."""
_CSV_PARTS = ("x", "y", "z", "qx", "qy", "qz", "qw")


@dataclass(frozen=True)
class DeviceRecording:
    """Recorded device frames.

    Attributes:
        frames: in our convention, in the order of time.
        calibration: calibration of the user for ``Calibration.of``; None if there is none.
    """

    frames: tuple[DeviceFrame, ...]
    calibration: Mapping[str, Any] | None = None

    @property
    def duration_s(self) -> float:
        """Seconds from the first frame to the last."""
        return self.frames[-1].time_s - self.frames[0].time_s

    @property
    def devices(self) -> tuple[str, ...]:
        """Devices that report at least once, in the order of ``sensors.DEVICES``."""
        seen = {name for frame in self.frames for name in frame.poses}
        return tuple(name for name in DEVICES if name in seen)


class RecordingWriter:
    """Writes frames one by one; the file appears when the block ends without an error.

    Args:
        path: the file, ``.jsonl.gz``.
        convention: convention of the numbers in the file.
        calibration: calibration of the user, if there is one.
        decimals: number of decimals.

    Raises:
        InputError: the file has another suffix, or the convention is unknown.
    """

    def __init__(
        self,
        path: Path,
        convention: str = "questsim",
        calibration: Mapping[str, Any] | None = None,
        decimals: int = DECIMALS,
    ) -> None:
        if not path.name.endswith(SUFFIX):
            raise InputError(f"is not a {SUFFIX} file", path, f"name it {path.stem}{SUFFIX}")
        convention_named(convention)
        self._path, self._convention, self._decimals = path, convention, decimals
        self._header = {
            "format": FORMAT,
            "version": VERSION,
            "convention": convention,
            "calibration": calibration,
        }
        self._stack = ExitStack()
        self.count = 0

    def __enter__(self) -> RecordingWriter:
        fresh = self._stack.enter_context(whole_file(self._path))
        # No time and no name in the archive: the same frames are the same bytes.
        raw = self._stack.enter_context(fresh.open("wb"))
        packed = self._stack.enter_context(
            gzip.GzipFile(filename="", mode="wb", fileobj=raw, mtime=0)
        )
        self._file = self._stack.enter_context(io.TextIOWrapper(packed, "utf-8"))
        self._line(self._header)
        return self

    def __exit__(self, *exception: Any) -> None:
        self._stack.__exit__(*exception)

    def write(self, frame: DeviceFrame) -> None:
        """One more frame."""
        line: dict[str, Any] = {"t": round(frame.time_s, self._decimals)}
        for name, pose in frame.poses.items():
            numbers = np.concatenate(from_ours(pose.position, pose.quat, self._convention))
            line[name] = [round(x, self._decimals) for x in numbers.tolist()]
        self._line(line)
        self.count += 1

    def _line(self, value: Mapping[str, Any]) -> None:
        self._file.write(json.dumps(value, separators=(",", ":")) + "\n")


def write_recording(
    path: Path,
    frames: Iterable[DeviceFrame],
    convention: str = "questsim",
    calibration: Mapping[str, Any] | None = None,
    decimals: int = DECIMALS,
) -> None:
    """Write a complete list of frames; see ``RecordingWriter``."""
    with RecordingWriter(path, convention, calibration, decimals) as writer:
        for frame in frames:
            writer.write(frame)


def read_recording(path: Path, convention: str | None = None) -> DeviceRecording:
    """Read a recording: ours (``.jsonl.gz``), iwer's (``.json``) or named columns (``.csv``).

    Args:
        path: the file, or ``synthetic`` for the shipped one.
        convention: convention of a CSV file; not allowed for other files, which contain it.

    Raises:
        InputError: naming file and line: another format or version, values that are no poses,
            times that do not go forward, no headset, no convention where one is needed.
    """
    if str(path) == EXAMPLE:
        path = example_path()
    if not path.is_file():
        raise InputError("there is no such file", path, f"{EXAMPLE} is the shipped one")
    if path.stat().st_size > MAX_TEXT_BYTES:
        raise InputError(f"is larger than {MAX_TEXT_BYTES >> 20} MiB", path, "split it")
    name = path.name.lower()
    if name.endswith(".csv"):
        if convention is None:
            raise InputError(
                "a CSV file does not state its axes", path, "add --convention unity, ..."
            )
        try:
            frames = _csv_frames(path, convention)
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            reason = str(error)[:100]
            raise InputError(f"cannot be read as CSV ({reason})", path) from None
        return _checked(path, frames, None)
    if convention is not None:
        raise InputError("the file already states its convention", path, "leave --convention out")
    if name.endswith(SUFFIX):
        return _read_own(path)
    if name.endswith(".json"):
        return _checked(path, _iwer_frames(path), None)
    raise InputError("is not a recording", path, f"use {SUFFIX}, .json of iwer, or .csv")


def example_path() -> Path:
    """Path of the shipped recording; ``synthetic_user.example_frames`` made it."""
    return Path(__file__).parent / "examples" / f"synthetic-user{SUFFIX}"


def _checked(
    path: Path, frames: Sequence[DeviceFrame], calibration: Mapping[str, Any] | None
) -> DeviceRecording:
    if not any("headset" in frame.poses for frame in frames):
        raise InputError("no frame has a headset", path)
    if len(frames) > MAX_FRAMES:
        raise InputError(f"has more than {MAX_FRAMES} frames", path, "split it")
    for number, (a, b) in enumerate(pairwise(frames)):
        if not b.time_s > a.time_s:
            raise InputError(
                f"time goes from {a.time_s:.4f} to {b.time_s:.4f} s",
                f"{path}, frame {number + 2}",
                "frames must be in order of time",
            )
    return DeviceRecording(tuple(frames), calibration)


def _read_own(path: Path) -> DeviceRecording:
    frames, header, where = [], None, str(path)
    try:
        with gzip.open(path, "rt", encoding="utf-8") as file:
            for number in range(1, MAX_FRAMES + 3):
                where = f"{path}, line {number}"
                text = file.readline(MAX_LINE + 1)
                if not text:
                    break
                if len(text) > MAX_LINE:
                    raise InputError("the line is too long for a frame", where)
                line = _parsed(text, where)
                if not isinstance(line, dict):
                    raise InputError("is not a JSON object", where)
                if header is None:
                    header = _checked_header(line, where)
                    continue
                if "t" not in line:
                    raise InputError("has no time t", where)
                time_s = line.pop("t")
                frames.append(_frame(time_s, line, header["convention"], where))
    except (OSError, EOFError, UnicodeDecodeError, zlib.error):
        raise InputError(
            "is not gzip-compressed text, or is incomplete", path, "record it again"
        ) from None
    if header is None:
        raise InputError("is empty", path)
    return _checked(path, frames, header.get("calibration"))


def _parsed(text: str, where: str) -> Any:
    try:
        return parse_json(text)
    except ValueError as error:
        raise InputError(f"is not JSON: {error}", where) from None


def _checked_header(line: dict[str, Any], where: str) -> dict[str, Any]:
    if line.get("format") != FORMAT:
        raise InputError(f"format is {line.get('format')!r}, not {FORMAT!r}", where)
    if line.get("version") != VERSION:
        raise InputError(f"version is {line.get('version')!r}, not {VERSION}", where)
    convention_named(str(line.get("convention")))
    return line


def _frame(time_s: Any, poses: Mapping[str, Any], convention: str, where: str) -> DeviceFrame:
    try:
        return DeviceFrame.of(time_s, poses, convention)
    except InputError as error:
        raise InputError(error.what, where, error.fix) from None


def _csv_frames(path: Path, convention: str) -> list[DeviceFrame]:
    """Columns ``time_s`` and ``DEVICE_x`` to ``DEVICE_qw``; empty cells mean no report."""
    convention_named(convention)
    frames = []
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = csv.DictReader(file)
        columns = [name.strip() for name in rows.fieldnames or ()]
        rows.fieldnames = columns
        devices = [name for name in DEVICES if f"{name}_x" in columns]
        wanted = {"time_s", *(f"{name}_{part}" for name in devices for part in _CSV_PARTS)}
        missing, extra = sorted(wanted - set(columns)), sorted(set(columns) - wanted)
        if missing or extra:
            what = f"no column {missing[0]!r}" if missing else f"unknown column {extra[0]!r}"
            raise InputError(what, f"{path}, line 1", "see docs/live.md for the columns")
        for row in rows:
            where = f"{path}, line {rows.line_num}"
            poses = {name: _csv_pose(row, name, convention, where) for name in devices}
            frames.append(_frame(_number(row["time_s"], "time_s", where), poses, convention, where))
    return frames


def _csv_pose(row: Mapping[str, str], name: str, convention: str, where: str) -> list[float] | None:
    cells = [(row.get(f"{name}_{part}") or "").strip() for part in _CSV_PARTS]
    if not any(cells):
        return None
    numbers = [
        _number(cell, f"{name}_{part}", where) for cell, part in zip(cells, _CSV_PARTS, strict=True)
    ]
    if convention_named(convention).scalar_first:
        return [*numbers[:3], numbers[6], *numbers[3:6]]
    return numbers


def _number(cell: str | None, column: str, where: str) -> float:
    try:
        return float(cell or "")
    except ValueError:
        raise InputError(f"{column} is {cell!r}, not a number", where) from None


def _iwer_frames(path: Path) -> list[DeviceFrame]:
    """Read a log of iwer's ActionRecorder: a schema of input sources, and frames of numbers.

    A frame is: time in ms, position and quaternion of the head, and for each source its index,
    target ray, and grip where it has one. Source: iwer 2.5.0, ``ActionRecorder.log``.
    """
    try:
        content = parse_json(path.read_text(encoding="utf-8"))
        schema = {int(index): dict(source) for index, source in content["schema"]}
        lines = list(content["frames"])
    except (OSError, KeyError, TypeError, ValueError, OverflowError):
        raise InputError(
            "is not a recording of iwer", path, "give what ActionRecorder logs"
        ) from None
    frames = []
    for number, line in enumerate(lines, 1):
        where = f"{path}, frame {number}"
        try:
            time_s, poses = float(line[0]) / 1000.0, {"headset": list(line[1:8])}
            for source in line[8:]:
                about = schema[int(source[0])]
                side = about["handedness"]
                if about.get("hasGrip") and side in ("left", "right"):
                    poses[f"{side}_controller"] = list(source[8])
        except (IndexError, KeyError, TypeError, ValueError, OverflowError):
            raise InputError("is not a frame of iwer", where) from None
        frames.append(_frame(time_s, _unit(poses), "openxr", where))
    return frames


def _unit(poses: Mapping[str, list[float]]) -> dict[str, list[float]]:
    """Poses with normalised quaternions: iwer rounds them to three decimals."""
    out = {}
    for name, pose in poses.items():
        try:
            length = math.hypot(*map(float, pose[3:]))
        except (TypeError, ValueError, OverflowError):  # reported when the frame is made
            length = 0.0
        near = abs(length - 1.0) < 0.01
        out[name] = [*pose[:3], *(np.array(pose[3:]) / length)] if near else pose
    return out
