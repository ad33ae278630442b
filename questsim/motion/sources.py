"""Finds the motion files in a folder or a zip."""

from __future__ import annotations

import shutil
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath

from questsim.errors import InputError
from questsim.files import whole_file
from questsim.motion import datasets
from questsim.motion.asf_amc import skeleton_of
from questsim.motion.deepmimic import is_deepmimic

SUFFIXES = (".bvh", ".npz", ".amc")
TEXT_SUFFIXES = (".txt", ".json")
"""Extensions of DeepMimic files and of many other files; the content decides."""
MAX_UNPACKED_BYTES = 8 << 30
"""Zip files that unpack to more than 8 GiB are rejected."""
KINDS = "BVH, AMC, DeepMimic JSON and npz files"


def motion_files(path: str | Path) -> list[Path]:
    """The file itself, or all motion files below a folder or in a zip, sorted.

    A zip is unpacked into the cache, once.

    Raises:
        InputError: the file does not exist, or the folder or zip holds no motion.
    """
    path = Path(path)
    if not path.exists():
        raise InputError("no such file or folder", path)
    if path.is_file():
        if path.suffix.lower() == ".zip":
            return _in_folder(unpack(path), path)
        if path.suffix.lower() == ".asf":
            raise InputError("is a skeleton without motion", path, "give its .amc files")
        if path.suffix.lower() not in (*SUFFIXES, *TEXT_SUFFIXES):
            known = ", ".join((*SUFFIXES, *TEXT_SUFFIXES))
            fix = f"give {KINDS}, or a folder or zip of these"
            if path.suffix.lower() == ".fbx":
                fix = "export it as BVH first (docs/motion.md says how with Blender)"
            raise InputError(f"the extension {path.suffix!r} is not one of {known}", path, fix)
        return [path]
    return _in_folder(path, path)


def _in_folder(folder: Path, named: Path) -> list[Path]:
    found = sorted(p for p in _walk(folder) if is_motion(p))
    if not found:
        raise InputError("there is no motion in it", named, f"it reads {KINDS}")
    return found


def is_motion(path: Path) -> bool:
    """Whether a file is a motion, by its extension or, for text files, by its first characters."""
    suffix = path.suffix.lower()
    return suffix in SUFFIXES or (suffix in TEXT_SUFFIXES and is_deepmimic(path))


def _walk(folder: Path) -> Iterator[Path]:
    return (p for p in folder.rglob("*") if p.is_file() and not p.name.startswith("."))


def unpack(path: Path) -> Path:
    """The folder in the cache with the motions and skeletons of a zip.

    Raises:
        InputError: it is not a zip, is too large unpacked, or the cache cannot be written.
    """
    folder = datasets.cache_dir() / "unpacked" / datasets.file_digest(path)[:32]
    done = folder / "done"
    if done.is_file():
        return folder / "files"
    try:
        with zipfile.ZipFile(path) as archive:
            entries = [entry for entry in archive.infolist() if _wanted(entry)]
            size = sum(entry.file_size for entry in entries)
            if size > MAX_UNPACKED_BYTES:
                raise InputError(f"unpacks to {size / 2**30:.0f} GiB, more than 8 GiB", path)
            for entry in entries:
                target = folder / "files" / PurePosixPath(entry.filename.replace("\\", "/"))
                target.parent.mkdir(parents=True, exist_ok=True)
                with (
                    archive.open(entry) as source,
                    whole_file(target) as fresh,
                    fresh.open("wb") as out,
                ):
                    shutil.copyfileobj(source, out)
        done.parent.mkdir(parents=True, exist_ok=True)
        done.touch()
    except InputError:
        raise
    except (OSError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(f"cannot be unpacked ({str(error)[:100]})", path) from None
    return folder / "files"


def _wanted(entry: zipfile.ZipInfo) -> bool:
    """Whether an entry is a motion or skeleton with a path inside the folder."""
    inside = PurePosixPath(entry.filename.replace("\\", "/"))
    if entry.is_dir() or inside.is_absolute() or ".." in inside.parts or ":" in entry.filename:
        return False
    if any(part.startswith((".", "__MACOSX")) for part in inside.parts):
        return False
    return inside.suffix.lower() in (*SUFFIXES, *TEXT_SUFFIXES, ".asf")


def content_digest(path: Path) -> str:
    """SHA-256 of a motion file, for AMC with its skeleton; empty if the file is missing."""
    digest = datasets.file_digest(path)
    if path.suffix.lower() == ".amc":
        with suppress(InputError):  # none is there: reading the file says so
            digest += datasets.file_digest(skeleton_of(path))
    return digest
