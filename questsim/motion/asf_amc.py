"""ASF/AMC (Acclaim) files: a skeleton file for each subject, a motion file for each take.

A bone rotates about its start, in its own axes, whose world orientation is given by ``axis``.
The recording's joints are the starts of the bones, all with the world's axes in the rest pose.

Source: Lander, "Working with Motion Capture File Formats", Game Developer, January 1998; the
files of mocap.cs.cmu.edu.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from questsim import rotations as rot
from questsim.errors import InputError
from questsim.motion.recording import AGAIN, MAX_LENGTH, Recording, decode, read_bytes

FPS = 120.0
"""AMC files do not store their frame rate; CMU's and HDM05's are recorded at 120 Hz."""
_DOFS = {"TX", "TY", "TZ", "RX", "RY", "RZ"}
_SUBJECT = re.compile(r"[_\-. ]")


@dataclass
class _Bone:
    """A bone; for the root, only ``axis`` and ``dofs`` are used."""

    name: str = ""
    direction: np.ndarray = field(default_factory=lambda: np.zeros(3))
    length: float = 0.0
    axis: tuple[str, np.ndarray] = ("XYZ", field(default_factory=lambda: np.zeros(3)))
    dofs: tuple[str, ...] = ()


@dataclass
class AsfSkeleton:
    """Content of an ASF file.

    Attributes:
        bones: by name, the root under ``"root"``.
        parents: each bone's parent, parents before children; without the root.
        degrees: whether angles are in degrees.
        position: ``(3,)`` the root's position in the rest pose.
    """

    bones: dict[str, _Bone]
    parents: dict[str, str]
    degrees: bool
    position: np.ndarray


def skeleton_of(amc: Path) -> Path:
    """The ASF file that belongs to an AMC file: next to it or in the folder above.

    Its name is the motion's or the longest matching prefix of it (``02.asf`` for ``02_01.amc``),
    or it is the only ASF file there.

    Raises:
        InputError: there is none, or there are several and none matches.
    """
    found: list[Path] = []
    for folder in (amc.parent, amc.parent.parent):
        found = sorted(p for p in folder.glob("*") if p.suffix.lower() == ".asf")
        fitting = [p for p in found if _names_subject(p.stem, amc.stem)]
        if fitting:
            return max(fitting, key=lambda p: len(p.stem))
        if len(found) == 1:
            return found[0]
        if found:
            break
    if found:
        names = ", ".join(p.name for p in found[:4])
        raise InputError(f"which of {names} is its skeleton?", amc, f"name one {amc.stem}.asf")
    raise InputError("its skeleton is missing", amc, "put the subject's .asf file next to it")


def _names_subject(skeleton: str, motion: str) -> bool:
    skeleton, motion = skeleton.lower(), motion.lower()
    rest = motion[len(skeleton) :]
    return motion.startswith(skeleton) and (not rest or bool(_SUBJECT.match(rest)))


def read_asf_amc(path: str | Path, fps: float | None = None) -> Recording:
    """Reads an AMC file with its ASF file.

    Args:
        path: the AMC file.
        fps: frames a second; 120 if not given.

    Raises:
        InputError: either file is missing or violates the format; the message names the line.
    """
    path = Path(path)
    data = read_bytes(path)
    skeleton_path = skeleton_of(path)
    skeleton_data = read_bytes(skeleton_path)
    skeleton = read_asf(decode(skeleton_data, skeleton_path), skeleton_path)
    values = _read_amc(decode(data, path), skeleton, path)
    count = len(values["root"])
    names = ("root", *skeleton.parents)
    parents = [-1] + [names.index(parent) for parent in skeleton.parents.values()]
    positions = np.zeros((count, len(names), 3))
    rotations = np.zeros((count, len(names), 4))
    tips: dict[int, np.ndarray] = {}
    for joint, name in enumerate(names):
        bone = skeleton.bones[name]
        rotations[:, joint] = _turns(bone, values.get(name), skeleton.degrees, count)
        if joint == 0:
            positions[:, 0] = skeleton.position + _moves(bone, values[name])
        elif parents[joint] > 0:
            above = skeleton.bones[names[parents[joint]]]
            positions[:, joint] = above.direction * above.length
        if joint and joint not in parents:
            tips[joint] = bone.direction * bone.length
    return Recording(
        path=path,
        names=names,
        parents=np.array(parents),
        positions=positions,
        rotations=rotations,
        fps=fps or FPS,
        sha256=hashlib.sha256(data + skeleton_data).hexdigest(),
        tips=tips,
        notes=(f"skeleton {skeleton_path.name}", *(() if fps else ("rate as usual in AMC files",))),
    )


def _turns(bone: _Bone, values: np.ndarray | None, degrees: bool, count: int) -> np.ndarray:
    """Quaternions ``(T, 4)`` of a bone in the world's axes at rest."""
    order, angles = bone.axis
    own = Rotation.from_euler(order.lower(), angles, degrees=degrees)
    turns = [(dof[1].lower(), i) for i, dof in enumerate(bone.dofs) if dof.startswith("R")]
    if values is None or not turns:
        return np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    letters = "".join(letter for letter, _ in turns)
    turned = Rotation.from_euler(letters, values[:, [i for _, i in turns]], degrees=degrees)
    return rot.as_quat(own * turned * own.inv(), (count,))


def _moves(bone: _Bone, values: np.ndarray) -> np.ndarray:
    """``(T, 3)`` of the root's translation channels."""
    moves = np.zeros((len(values), 3))
    for i, dof in enumerate(bone.dofs):
        if dof.startswith("T"):
            moves[:, "XYZ".index(dof[1])] = values[:, i]
    return moves


def read_asf(text: str, path: Path) -> AsfSkeleton:
    """The skeleton of an ASF file's text.

    Raises:
        InputError: the text violates the format; the message names the line.
    """
    sections = _sections(text)
    for needed in ("root", "bonedata", "hierarchy"):
        if needed not in sections:
            raise InputError(f"has no section :{needed}", path, "give an ASF file")
    units = {words[0].lower(): words[-1].lower() for _, words in sections.get("units", [])}
    root, position = _root(sections["root"], path)
    bones = {"root": root} | _bones(sections["bonedata"], path)
    parents = _hierarchy(sections["hierarchy"], bones, path)
    return AsfSkeleton(bones, parents, not units.get("angle", "deg").startswith("rad"), position)


_Lines = list[tuple[int, list[str]]]


def _sections(text: str) -> dict[str, _Lines]:
    """The words of each section's lines, with the lines' numbers from 1."""
    sections: dict[str, _Lines] = {}
    current: _Lines = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        if words[0].startswith(":"):
            current = sections.setdefault(words[0][1:].lower(), [])
            words = words[1:]
        if words:
            current.append((number, words))
    return sections


def _root(lines: _Lines, path: Path) -> tuple[_Bone, np.ndarray]:
    bone, position = _Bone("root"), np.zeros(3)
    letters, angles = "XYZ", np.zeros(3)
    for number, (key, *words) in lines:
        where = f"{path}, line {number}"
        if key.lower() == "order":
            bone.dofs = _dofs(words, where)
        elif key.lower() == "axis":
            letters = _axis_order(words, where)
        elif key.lower() == "position":
            position = _vector(words, where)
        elif key.lower() == "orientation":
            angles = _vector(words, where)
    if len(bone.dofs) < 6:
        raise InputError("the root's order needs TX TY TZ RX RY RZ", path, AGAIN)
    bone.axis = (letters, angles)
    return bone, position


def _bones(lines: _Lines, path: Path) -> dict[str, _Bone]:
    bones: dict[str, _Bone] = {}
    bone = _Bone()
    for number, (key, *words) in lines:
        where = f"{path}, line {number}"
        key = key.lower()
        if key == "begin":
            bone = _Bone()
            bone.axis = ("XYZ", np.zeros(3))
        elif key == "name":
            bone.name = " ".join(words)
        elif key == "direction":
            bone.direction = _vector(words, where)
        elif key == "length":
            bone.length = float(_numbers(words, 1, where)[0])
        elif key == "axis":
            bone.axis = (_axis_order(words[3:], where), _vector(words[:3], where))
        elif key == "dof":
            bone.dofs = _dofs(words, where)
            if any(dof.startswith("T") for dof in bone.dofs):
                raise InputError(
                    "a bone with translation cannot be read", where, "export rigid bones"
                )
        elif key == "end":
            if not bone.name or bone.name in bones or bone.name == "root":
                raise InputError(f"bone {bone.name[:40]!r} lacks a unique name", where, AGAIN)
            bones[bone.name] = bone
    if not bones:
        raise InputError("has no bones", path, AGAIN)
    return bones


def _hierarchy(lines: _Lines, bones: dict[str, _Bone], path: Path) -> dict[str, str]:
    """Each bone's parent, in an order in which parents come first."""
    parents: dict[str, str] = {}
    for number, words in lines:
        if words[0].lower() in ("begin", "end"):
            continue
        where = f"{path}, line {number}"
        for word in words:
            if word not in bones:
                raise InputError(f"there is no bone {word[:40]!r}", where, AGAIN)
        if words[0] != "root" and words[0] not in parents:
            raise InputError(f"bone {words[0]!r} comes before its parent", where, AGAIN)
        for child in words[1:]:
            if child in parents or child == "root":
                raise InputError(f"bone {child!r} has two parents", where, AGAIN)
            parents[child] = words[0]
    if not parents:
        raise InputError("has no hierarchy", path, AGAIN)
    return parents


def _numbers(words: list[str], count: int, where: str) -> np.ndarray:
    try:
        values = np.array(words, float)
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(f"{' '.join(words)[:40]!r} is not {count} finite numbers", where, AGAIN)
    if (abs(values) > MAX_LENGTH).any():
        raise InputError(f"{' '.join(words)[:40]!r} is beyond {MAX_LENGTH:g}", where, AGAIN)
    return values


def _vector(words: list[str], where: str) -> np.ndarray:
    return _numbers(words, 3, where)


def _axis_order(words: list[str], where: str) -> str:
    if len(words) != 1 or sorted(words[0].upper()) != ["X", "Y", "Z"]:
        raise InputError(f"{' '.join(words)[:40]!r} is not an order such as XYZ", where, AGAIN)
    return words[0].upper()


def _dofs(words: list[str], where: str) -> tuple[str, ...]:
    dofs = tuple(word.upper() for word in words)
    unknown = [dof for dof in dofs if dof not in _DOFS]
    if unknown or len(set(dofs)) != len(dofs):
        raise InputError(f"{' '.join(words)[:40]!r} are not degrees of freedom", where, AGAIN)
    return dofs


def _read_amc(text: str, skeleton: AsfSkeleton, path: Path) -> dict[str, np.ndarray]:
    """The values ``(T, number of dofs)`` of each moving bone.

    Raises:
        InputError: a line is wrong, or a frame lacks a bone; the message names it.
    """
    moving = {name: len(bone.dofs) for name, bone in skeleton.bones.items() if bone.dofs}
    frames: list[dict[str, list[str]]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words or words[0][0] in "#:":
            continue
        where = f"{path}, line {number}"
        name, *values = words
        if not values and name.isdigit():
            _check_whole(frames, moving, where)
            frames.append({})
            continue
        if not frames:
            raise InputError("a frame's number expected", where, "give an AMC file")
        if name not in skeleton.bones:
            raise InputError(
                f"the skeleton has no bone {name[:40]!r}",
                where,
                "check that it is the subject's .asf file",
            )
        if name in frames[-1]:
            raise InputError(f"{name} comes twice in frame {len(frames)}", where, AGAIN)
        expected = moving.get(name, 0)
        if len(values) != expected:
            raise InputError(
                f"{name} has {len(values)} values, its skeleton asks for {expected}", where, AGAIN
            )
        frames[-1][name] = values
    if not frames:
        raise InputError("has no frames", path, AGAIN)
    _check_whole(frames, moving, path)
    return {name: _values([frame[name] for frame in frames], name, path) for name in moving}


def _check_whole(frames: list[dict], moving: dict[str, int], where: str | Path) -> None:
    """Reject a last frame that lacks a bone."""
    missing = [name for name in moving if name not in frames[-1]] if frames else []
    if missing:
        raise InputError(f"frame {len(frames)} has no line of {missing[0]}", where, AGAIN)


def _values(rows: list[list[str]], name: str, path: Path) -> np.ndarray:
    """A bone's values ``(T, n)``."""
    try:
        values = np.array(rows, float)
        if (abs(values) <= MAX_LENGTH).all():
            return values
    except ValueError:
        pass
    for number, row in enumerate(rows, start=1):
        _numbers(row, len(row), f"{path}, {name} of frame {number}")
    raise AssertionError
