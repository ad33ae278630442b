"""A library: motions and retargeted clips in one .npz file.

Clips are stored as poses at 36 Hz; velocities, link poses and contacts follow from them.
"""

from __future__ import annotations

import re
from collections.abc import Container, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from questsim.body_proportions import Proportions
from questsim.errors import InputError
from questsim.files import whole_file
from questsim.motion.clip import FPS, Clip
from questsim.motion.motion import Motion
from questsim.motion.npz import open_npz
from questsim.motion.recording import MAX_LENGTH
from questsim.skeleton import DOFS, JOINT_PARENTS, JOINTS, LINKS, NUM_DOFS, NUM_JOINTS, NUM_LINKS

FORMAT, VERSION = "questsim-library", 1
ABOUT = ("source", "source_sha256", "licence", "kind", "style")
AGAIN = "import the motions again with this version"
MAX_ARRAY_BYTES = 4 << 30
"""An array of a library may take 4 GiB: 100 hours of rotations."""
_SHA256 = re.compile(r"[0-9a-f]{64}")

HEADER: dict[str, np.ndarray] = {
    "format": np.array(FORMAT),
    "version": np.array(VERSION),
    "joints": np.array(JOINTS),
    "joint_parents": np.array(JOINT_PARENTS),
    "links": np.array(LINKS),
    "dofs": np.array(DOFS),
    "clip_fps": np.array(FPS),
    "units": np.array("m"),
    "up": np.array("z"),
}
"""Header values of every library; a file with other values is rejected."""


@dataclass(frozen=True)
class Library:
    """Motions and clips of one file, each list in the order they were saved."""

    motions: list[Motion] = field(default_factory=list)
    clips: list[Clip] = field(default_factory=list)


def save_library(path: str | Path, motions: Sequence[Motion], clips: Sequence[Clip]) -> None:
    """Writes a library; the file appears whole or not at all.

    Raises:
        InputError: the folder does not exist or cannot be written.
    """
    arrays = dict(HEADER)
    arrays |= {
        "motion_name": _strings([m.name for m in motions]),
        "motion_fps": np.array([m.fps for m in motions], float),
        "motion_frames": np.array([len(m) for m in motions], int),
        "motion_root": _joined([m.root_position for m in motions], (3,)),
        "motion_rotations": _joined([m.rotations for m in motions], (NUM_JOINTS, 4)),
        "motion_offsets": np.array([m.offsets for m in motions]).reshape(-1, NUM_JOINTS, 3),
        "clip_name": _strings([c.name for c in clips]),
        "clip_height_m": np.array([c.height_m for c in clips], float),
        "clip_frames": np.array([len(c) for c in clips], int),
        "clip_qpos": _joined([c.qpos for c in clips], (7 + NUM_DOFS,)),
    }
    if any(clip.proportions is not None for clip in clips):
        places = [(c.proportions or Proportions()).array() for c in clips]
        arrays["clip_places"] = np.array(places).reshape(-1, NUM_LINKS, 3)
    for key in ABOUT:
        arrays[f"motion_{key}"] = _strings([getattr(m, key) for m in motions])
        arrays[f"clip_{key}"] = _strings([getattr(c, key) for c in clips])
    # NumPy adds .npz to a file's name that ends otherwise, also in .NPZ.
    with whole_file(path) as fresh, fresh.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def bare(clip: Clip) -> Clip:
    """What a library stores of a clip: its poses, not what follows from them.

    That takes a tenth of the memory, for commands that make thousands of clips.
    """
    derived = ("qvel", "link_position", "link_quat", "link_velocity", "link_angular_velocity")
    none = {key: np.zeros((0, *getattr(clip, key).shape[1:])) for key in derived}
    return replace(clip, qpos=clip.qpos.astype(np.float32), contacts=np.zeros((0, 2), bool), **none)


def load_library(
    path: str | Path,
    *,
    motions: bool = True,
    clips: bool = True,
    names: Container[str] | None = None,
) -> Library:
    """Reads a library and checks it by name.

    Args:
        path: the file.
        motions: whether to read the motions.
        clips: whether to read the clips.
        names: read only motions and clips of these names; by default all.

    Raises:
        InputError: the file is missing or none, of another version, of another skeleton, lacks
            a key, or holds numbers that are not finite or hashes that are none.
    """
    path = Path(path)
    with open_npz(path, MAX_ARRAY_BYTES, "a library") as archive:
        _check_header(archive, path)
        return Library(
            motions=_load_motions(archive, path, names) if motions else [],
            clips=_load_clips(archive, path, names) if clips else [],
        )


def clip_names(path: Path) -> list[str]:
    """The names of a library's clips, in their order.

    Raises:
        InputError: as ``load_library``.
    """
    with open_npz(path, MAX_ARRAY_BYTES, "a library") as archive:
        _check_header(archive, path)
        return [str(name) for name in _array(archive, path, "clip_name", "U")]


def is_library(path: str | Path) -> bool:
    """Whether a file is an .npz that calls itself a QuestSim library, of whatever version."""
    try:
        with open_npz(Path(path), 1000) as archive:
            return "format" in archive.files and str(archive["format"]) == FORMAT
    except InputError:
        return False


def _strings(values: list[str]) -> np.ndarray:
    return np.array(values, dtype=np.str_) if values else np.zeros(0, "U1")


def _joined(parts: list[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    return np.concatenate([np.zeros((0, *shape)), *parts]).astype(np.float32)


def _check_header(archive: Any, path: Path) -> None:
    for key, expected in HEADER.items():
        if key not in archive.files:
            what = "is not a QuestSim library" if key == "format" else f"library lacks {key!r}"
            raise InputError(what, path, AGAIN)
        found = _read(archive, path, key)
        if found.shape != expected.shape or not np.array_equal(found, expected):
            if expected.ndim:
                raise InputError(f"library is for another list of {key}", path, AGAIN)
            told = f"an array {found.shape}" if found.ndim else " ".join(str(found).split())
            raise InputError(f"library has {key} {told}, not {expected}", path, AGAIN)


def _read(archive: Any, path: Path, key: str) -> np.ndarray:
    """The array ``key``; text is checked, since Python fails on strings with damaged characters."""
    array = archive[key]
    if array.dtype.kind == "U":
        points = np.frombuffer(array.tobytes(), f"{array.dtype.byteorder}u4")
        if ((points > 0x10FFFF) | ((points >= 0xD800) & (points <= 0xDFFF))).any():
            raise InputError(f"{key} holds damaged text", path, AGAIN)
    return array


def _array(archive: Any, path: Path, key: str, kinds: str, row: tuple[int, ...] = ()) -> np.ndarray:
    """The array ``key``, if its rows have the shape ``row`` and its type is of ``kinds``."""
    array = _read(archive, path, key)
    if array.dtype.kind not in kinds or array.ndim == 0 or array.shape[1:] != row:
        raise InputError(f"{key} is {array.dtype} of shape {array.shape}", path, AGAIN)
    # Half precision cannot be compared with MAX_LENGTH.
    return array.astype(np.float32) if array.dtype == np.float16 else array


def _parts(archive: Any, path: Path, kind: str, arrays: dict[str, tuple[int, ...]]) -> dict:
    """Arrays of ``kind``, with these rows, cut into the frames of each entry, and its text."""
    frames = _array(archive, path, f"{kind}_frames", "iu")
    if (frames < 1).any():
        raise InputError(f"{kind}_frames are not counts above zero", path, AGAIN)
    out: dict[str, list] = {}
    for key in ("name", *ABOUT):
        out[key] = [str(text) for text in _array(archive, path, f"{kind}_{key}", "U")]
        if len(out[key]) != len(frames):
            raise InputError(f"{kind}_{key} does not fit {kind}_frames", path, AGAIN)
    for name, digest in zip(out["name"], out["source_sha256"], strict=True):
        if digest and not _SHA256.fullmatch(digest):
            what = f"{kind}_source_sha256 of {name} is not a SHA-256 hash (64 hexadecimal digits)"
            raise InputError(what, path, AGAIN)
    edges = np.concatenate([[0], np.cumsum(frames)])
    for key, row in arrays.items():
        array = _array(archive, path, f"{kind}_{key}", "f", row)
        if len(array) != edges[-1]:
            raise InputError(f"{kind}_{key} has {len(array)} frames, not {edges[-1]}", path, AGAIN)
        bad = ~(abs(array) <= MAX_LENGTH)
        if bad.any():
            entry = int(np.searchsorted(edges, np.argwhere(bad)[0][0], "right"))
            what = f"is not finite or above {MAX_LENGTH:g}"
            raise InputError(f"{kind}_{key} of {out['name'][entry - 1]} {what}", path, AGAIN)
        out[key] = [array[a:b] for a, b in pairwise(edges)]
    return out


def _unit(quat: np.ndarray, what: str, path: Path) -> np.ndarray:
    """Quaternions ``(..., 4)`` of unit length up to rounding, of exactly that length."""
    quat = quat.astype(float)
    norm = np.linalg.norm(quat, axis=-1, keepdims=True)
    if (abs(norm - 1.0) > 1e-3).any():
        raise InputError(f"{what} has rotations that are not unit quaternions", path, AGAIN)
    return quat / norm


def _load_motions(archive: Any, path: Path, names: Container[str] | None) -> list[Motion]:
    parts = _parts(archive, path, "motion", {"root": (3,), "rotations": (NUM_JOINTS, 4)})
    fps = _array(archive, path, "motion_fps", "f")
    offsets = _array(archive, path, "motion_offsets", "f", (NUM_JOINTS, 3))
    if len(fps) != len(parts["name"]) or len(offsets) != len(fps):
        raise InputError("motion_fps or motion_offsets do not fit motion_frames", path, AGAIN)
    for key, array in (("fps", fps), ("offsets", offsets)):
        if not (abs(array) <= MAX_LENGTH).all():
            raise InputError(f"motion_{key} is not finite or above {MAX_LENGTH:g}", path, AGAIN)
    return [
        Motion(
            name=name,
            fps=float(fps[i]),
            root_position=parts["root"][i].astype(float),
            rotations=_unit(parts["rotations"][i], f"motion {name}", path),
            offsets=offsets[i].astype(float),
            **{key: parts[key][i] for key in ABOUT},
        )
        for i, name in enumerate(parts["name"])
        if names is None or name in names
    ]


def _load_clips(archive: Any, path: Path, names: Container[str] | None) -> list[Clip]:
    from questsim.body import MAX_HEIGHT_M, MIN_HEIGHT_M
    from questsim.motion.kinematics import clips_from_qpos

    parts = _parts(archive, path, "clip", {"qpos": (7 + NUM_DOFS,)})
    heights = _array(archive, path, "clip_height_m", "f")
    if len(heights) != len(parts["name"]):
        raise InputError("clip_height_m does not fit clip_frames", path, AGAIN)
    chosen = [i for i, name in enumerate(parts["name"]) if names is None or name in names]
    for i in chosen:
        if not MIN_HEIGHT_M <= heights[i] <= MAX_HEIGHT_M:
            raise InputError(f"clip {parts['name'][i]} is {heights[i]:g} m tall", path, AGAIN)
        _unit(parts["qpos"][i][:, 3:7], f"clip {parts['name'][i]}", path)
    bodies = _load_proportions(archive, path, len(heights))
    return clips_from_qpos(
        [parts["name"][i] for i in chosen],
        [parts["qpos"][i] for i in chosen],
        [float(heights[i]) for i in chosen],
        [{key: parts[key][i] for key in ABOUT} for i in chosen],
        [bodies[i] for i in chosen],
    )


def _load_proportions(archive: Any, path: Path, count: int) -> list[Proportions | None]:
    """Of each clip; None for the default body's."""
    if "clip_places" not in archive.files:
        return [None] * count
    places = _array(archive, path, "clip_places", "f", (NUM_LINKS, 3))
    if len(places) != count:
        raise InputError("clip_places does not fit clip_frames", path, AGAIN)
    usual = Proportions()
    try:
        found = [Proportions(tuple(map(tuple, rows.tolist()))) for rows in places]
    except InputError as error:
        raise InputError(f"clip_places: {error}", path, AGAIN) from None
    return [None if body == usual else body for body in found]
