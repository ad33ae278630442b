"""The folder of a training run with its record: config, seed, versions, data."""

from __future__ import annotations

import hashlib
import io
import os
import platform
import shutil
import tarfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import MISSING, Field, asdict, fields, is_dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import torch
import yaml
from filelock import FileLock, Timeout

from agents.precision import native_bfloat16
from questsim.errors import InputError
from questsim.extensions import extension_versions
from questsim.files import read_yaml, recover_folder, whole_file
from questsim.motion.clip import Clip
from questsim.motion.motion import Motion

FORMAT, FORMAT_VERSION = "questsim-run", 1
RECORD = "run.yaml"
OWNER = ".training.owner"
"""File that names the process that is training in a run folder."""
PACKAGES = ("mujoco", "numpy", "scipy", "torch", "stable-baselines3", "gymnasium")


def data_record(spec: str, clips: Sequence[Clip]) -> dict[str, Any]:
    """Record of the training data: amount, licences and one hash over all clips."""
    digest = hashlib.sha256()
    for clip in sorted(clips, key=lambda clip: clip.name):
        weight = "" if clip.weight == 1.0 else f" {clip.weight:g}"
        digest.update(f"{clip.name} {clip.source_sha256} {clip.height_m:.3f}{weight}".encode())
        digest.update(clip.qpos.astype("<f4").tobytes())
    return amounts(spec, clips) | {"sha256": digest.hexdigest()}


def amounts(spec: str, data: Sequence[Clip] | Sequence[Motion]) -> dict[str, Any]:
    """Amount and licences of clips or motions, for a record."""
    return {
        "motions": spec,
        "clips": len(data),
        "seconds": round(sum(item.duration for item in data), 1),
        "licences": dict(Counter(item.licence or "not stated" for item in data)),
    }


def versions() -> dict[str, str]:
    """Versions of Python, this package, its numerical libraries and the loaded extensions."""
    found = {"python": platform.python_version()}
    for package in ("questsim", *PACKAGES):
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    # With the same versions, the same seed gives the same bits.
    found["processor"] = torch.backends.cpu.get_cpu_capability()
    found["bfloat16"] = "native" if native_bfloat16() else "not native"
    for module, version in extension_versions().items():
        found[f"extension {module}"] = version
    return found


def plain(value: Any) -> Any:
    """Convert a value for YAML: dataclasses become mappings, tuples lists."""
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value))
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def start_run(
    out: Path,
    args: Any,
    preset: Any,
    data: dict[str, Any],
    behind: Mapping[str, Any] | None = None,
) -> None:
    """Create the run folder with its record.

    Args:
        out: the folder.
        args, preset: options and preset of the run.
        data: see ``data_record``.
        behind: for each option that names a shipped policy, that policy's training record, since
            a later version may have the same name when a card is written.

    Raises:
        InputError: the folder already holds a run or cannot be written.
    """
    refuse_existing(out)
    record = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "args": plain(args),
        "preset": plain(preset),
        "data": data,
        "versions": versions(),
        "behind": dict(behind or {}),
        "resumed": [],
    }
    _write(out, record)


def note_resume(out: Path, args: Any, preset: Any, behind: Mapping[str, Any] | None = None) -> None:
    """Add options and preset of a resumed run to its record; see ``start_run``."""
    record = read_run(out)
    again = {
        "args": plain(args),
        "preset": plain(preset),
        "versions": versions(),
        "behind": dict(behind or {}),
    }
    record["resumed"] = [*record.get("resumed", []), again]
    _write(out, record)


class RunRecord:
    """Writes a training's record when its first stage begins.

    It is not written earlier, so that refused options or motions leave no run behind.

    Args:
        out: the folder of the run.
        args, preset: options and preset.
        data: see ``data_record``.
        behind: returns the records of shipped policies, see ``start_run``.
    """

    def __init__(
        self,
        out: Path,
        args: Any,
        preset: Any,
        data: dict[str, Any],
        behind: Callable[[], Mapping[str, Any]],
    ) -> None:
        self._out, self._args, self._preset = out, args, preset
        self._data, self._behind = data, behind
        self._written = False

    def begin(self) -> None:
        """Write a new record, or add a resumed run to it; nothing from the second call on."""
        if self._written:
            return
        if (self._out / RECORD).exists():
            note_resume(self._out, self._args, self._preset, self._behind())
        else:
            start_run(self._out, self._args, self._preset, self._data, self._behind())
        self._written = True


def _write(out: Path, record: dict[str, Any]) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"cannot be written ({reason})", out, "choose another --out") from error
    with whole_file(out / RECORD) as path:
        path.write_text(yaml.safe_dump(record, sort_keys=False), encoding="utf-8")


def refuse_existing(out: Path) -> None:
    """Refuse a folder that already holds a run.

    Raises:
        InputError: ``out`` holds a run or is a file.
    """
    if (out / RECORD).exists():
        raise InputError("holds a run already", out, "add --resume or choose another --out")
    if out.exists() and not out.is_dir():
        raise InputError("is a file", out, "choose another --out")


def read_run(out: Path) -> dict[str, Any]:
    """The record of an existing run.

    Raises:
        InputError: no run there, or its record has another format version.
    """
    path = out / RECORD
    try:
        record = read_yaml(path, "run record")
    except FileNotFoundError:
        raise InputError("there is no run to resume", out, "leave out --resume") from None
    if record.get("format") != FORMAT:
        raise InputError(f"is not of format {FORMAT!r}", path)
    version = record.get("format_version")
    if version != FORMAT_VERSION:
        raise InputError(
            f"format_version is {version!r}, this version reads {FORMAT_VERSION}",
            path,
            "start a new run",
        )
    for field in ("args", "data"):
        if not isinstance(record.get(field), dict):
            raise InputError(f"has no {field}", path, "start a new run")
    if not isinstance(record["data"].get("sha256"), str):
        raise InputError("has no hash of its motions", path, "start a new run")
    return record


@contextmanager
def only_training(out: Path) -> Iterator[None]:
    """Lock a run folder for one training, and repair files that a killed training half replaced.

    Raises:
        InputError: another training is writing there, or the folder cannot be written.
    """
    made = not out.exists()
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock = FileLock(out / ".training.lock")
        lock.acquire(timeout=0)
    except Timeout:
        owner = _owner(out)
        raise InputError(
            f"another training is writing there{owner}", out, "wait for it, or choose another --out"
        ) from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"cannot be written ({reason})", out, "choose another --out") from error
    try:
        (out / OWNER).write_text(f"process {os.getpid()} on {platform.node()}\n", encoding="utf-8")
        for name in ("best", "last"):
            for old in (*out.glob(f"{name}.old"), *out.glob(f"*/{name}.old")):
                recover_folder(old.with_name(name))
        yield
    finally:
        (out / OWNER).unlink(missing_ok=True)
        lock.release()
        (out / ".training.lock").unlink(missing_ok=True)
        if made:
            with suppress(OSError):  # keep the folder: something was written
                out.rmdir()


def _owner(out: Path) -> str:
    with suppress(OSError, UnicodeDecodeError):
        return f" ({(out / OWNER).read_text(encoding='utf-8').strip()})"
    return ""


def check_same_run(
    record: dict[str, Any], args: Any, data: dict[str, Any], may_differ: set[str], out: Path
) -> None:
    """Refuse to resume a run with different options or data.

    Raises:
        InputError: names the option that differs.
    """
    # Records older than an option lack it.
    defaults = _by_option(plain({option.name: default_of(option) for option in fields(args)}))
    before = defaults | _by_option(record["args"])
    for name, value in _by_option(plain(args)).items():
        if name.partition(".")[0] not in may_differ and value != before.get(name):
            what = f"--{name.replace('_', '-')} was {before.get(name)}, not {value}"
            raise InputError(what, out / RECORD, "use it again")
    known = record["data"]
    digests = {
        "motions": (known["sha256"], data["sha256"]),
        "validation clips": tuple(d.get("validation", {}).get("sha256") for d in (known, data)),
    }
    for which, (held, given) in digests.items():
        if held != given:
            what = f"the {which} differ from those at the start of this run"
            raise InputError(what, out / RECORD, f"name the same {which}, or another --out")


def _by_option(args: dict[str, Any]) -> dict[str, Any]:
    """Values by the names of their options: ``starts.standing`` is a part of ``starts``."""
    found: dict[str, Any] = {}
    for name, value in args.items():
        parts = value if isinstance(value, dict) else {}
        found |= {f"{name}.{part}": part_value for part, part_value in parts.items()}
        if not parts:
            found[name] = value
    return found


def default_of(option: Field[Any]) -> Any:
    """The default of an option; None if it is required."""
    if option.default_factory is not MISSING:
        return option.default_factory()
    return None if option.default is MISSING else option.default


def packed(folder: Path) -> bytes:
    """All files of a folder as a tar, to be sent to another machine."""
    data = io.BytesIO()
    with tarfile.open(fileobj=data, mode="w:gz") as tar:
        tar.add(folder, ".")
    return data.getvalue()


def unpack(files: bytes, folder: Path) -> None:
    """Write a folder from ``packed``, in place of what an interrupted run left there."""
    fresh = folder.with_name(f".{folder.name}.new")
    shutil.rmtree(fresh, ignore_errors=True)
    with tarfile.open(fileobj=io.BytesIO(files)) as tar:
        tar.extractall(fresh, filter="data")
    shutil.rmtree(folder, ignore_errors=True)
    fresh.rename(folder)
