"""One motion file of any kind becomes a checked ``Motion``."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from questsim.errors import InputError
from questsim.motion.amass import is_amass, read_amass
from questsim.motion.asf_amc import read_asf_amc
from questsim.motion.bvh import read_bvh
from questsim.motion.checks import (
    FLOOR_TOLERANCE_M,
    MAX_STATURE_M,
    MIN_STATURE_M,
    MIN_UPRIGHT,
    Report,
    check,
    refuse,
    stature,
    upright_share,
)
from questsim.motion.convert import axis_vector, global_pose, to_motion
from questsim.motion.deepmimic import read_deepmimic
from questsim.motion.families import SMPL, UNITS, UP_AXES, Family, load_mapping, recognise
from questsim.motion.motion import Motion
from questsim.motion.recording import Recording
from questsim.motion.sources import TEXT_SUFFIXES
from questsim.skeleton import JOINTS

_CLIP_NAME = re.compile(r"dataset-\d+_(?P<kind>[a-z-]+)_(?P<style>[a-z-]+)_\d+")


@dataclass(frozen=True)
class ReadOptions:
    """What the user declares about files; None is to detect it.

    Attributes:
        units: a key of ``families.UNITS``.
        up: the up axis, one of ``UP_AXES``.
        fps: the true frame rate.
        mapping: a mapping file for an unknown skeleton (see ``families.load_mapping``).
        height_m: the subject's stature, for AMASS files.
        smpl_file: a SMPL model file, for AMASS files.
        licence: the data's licence.
        accept: take the file even where it fails the checks.
    """

    units: str | None = None
    up: str | None = None
    fps: float | None = None
    mapping: str | None = None
    height_m: float | None = None
    smpl_file: str | None = None
    licence: str = ""
    accept: bool = False

    def __post_init__(self) -> None:
        if self.units not in (None, *UNITS):
            raise InputError(f"units {self.units!r}", fix=f"choose one of {', '.join(UNITS)}")
        if self.up not in (None, *UP_AXES):
            raise InputError(f"up axis {self.up!r}", fix=f"choose one of {', '.join(UP_AXES)}")
        if self.fps is not None and not self.fps > 0:
            raise InputError(f"frame rate {self.fps:g} is not above zero", "--fps")


def read_motion(
    path: str | Path, options: ReadOptions | None = None, family: Family | None = None
) -> tuple[Motion, Report]:
    """Reads and checks a BVH, AMC, DeepMimic or AMASS file.

    Args:
        path: the file.
        options: what is declared about it.
        family: its skeleton; by default that of ``options.mapping`` or the one recognised.

    Raises:
        InputError: the file cannot be read, its skeleton is unknown, or it fails a check and
            ``options.accept`` is not set.
    """
    path, options = Path(path), options or ReadOptions()
    if path.suffix.lower() == ".npz":
        motion, report = _read_amass(path, options)
    else:
        recording = _recording(path, options)
        motion, report = _on_own_skeleton(recording, options, family)
        report = replace(report, notes=(*recording.notes, *report.notes))
    motion, report = _on_floor(motion, report)
    if not options.accept:
        refuse(report, str(path))
    return motion, report


def _on_floor(motion: Motion, report: Report) -> tuple[Motion, Report]:
    """Puts a motion whose floor is far from 0 on it, as of files with the hips at the origin."""
    if abs(report.foot_height_m) <= FLOOR_TOLERANCE_M:
        return motion, report
    down = np.array([0.0, 0.0, report.foot_height_m])
    motion = replace(motion, root_position=motion.root_position - down)
    note = f"moved by {-report.foot_height_m:+.2f} m onto the floor"
    return motion, replace(check(motion, report.units, report.up), notes=(*report.notes, note))


def _read_amass(path: Path, options: ReadOptions) -> tuple[Motion, Report]:
    if not is_amass(path):
        # Also says why a file is none: missing, empty, no .npz.
        read_amass(path)
    recording = read_amass(path, height_m=options.height_m, smpl_file=options.smpl_file)
    if options.fps:
        recording = replace(recording, fps=options.fps)
    units, up = options.units or "m", options.up or "z"
    motion = to_motion(recording, SMPL, UNITS[units], up, licence=options.licence)
    return motion, check(motion, units, up)


def _recording(path: Path, options: ReadOptions) -> Recording:
    """The file by its ending; text that is not BVH or AMC is DeepMimic's."""
    suffix = path.suffix.lower()
    if suffix in TEXT_SUFFIXES:
        return read_deepmimic(path, options.fps)
    recording = read_asf_amc(path, options.fps) if suffix == ".amc" else read_bvh(path)
    return replace(recording, fps=options.fps) if options.fps else recording


def _on_own_skeleton(
    recording: Recording, options: ReadOptions, family: Family | None
) -> tuple[Motion, Report]:
    path = recording.path
    if family is None:
        family = load_mapping(options.mapping) if options.mapping else None
    family = family or recognise(recording.names, path)
    about = {"licence": options.licence}
    if named := _CLIP_NAME.fullmatch(path.stem):
        about |= named.groupdict()
    usual = f"as {family.name} files"
    if family.units and family.up and not (options.units or options.up):
        motion = to_motion(recording, family, UNITS[family.units], family.up, **about)
        report = check(motion, f"{family.units} ({usual})", f"{family.up} ({usual})")
        if not report.problems:
            return motion, report
    units, units_note = _units(recording, family, options)
    up, up_note = _up_axis(recording, family, options)
    motion = to_motion(recording, family, UNITS[units], up, **about)
    return motion, check(motion, f"{units} ({units_note})", f"{up} ({up_note})")


def _units(recording: Recording, family: Family, options: ReadOptions) -> tuple[str, str]:
    """The file's units and how they are known.

    What a family usually has is believed only if it gives a person's height.
    """
    if options.units:
        return options.units, "declared"
    # One frame is enough for bone lengths, and in one frame no bone can stretch.
    first = replace(recording, positions=recording.positions[:1], rotations=recording.rotations[:1])
    height = stature(to_motion(first, family, 1.0, family.up or "y"))
    fitting = [u for u, m in UNITS.items() if MIN_STATURE_M <= height * m <= MAX_STATURE_M]
    if family.units in fitting or (family.units and not fitting):
        return family.units, f"as {family.name} files"
    if not fitting:
        raise InputError(
            f"the skeleton is {height:.3g} units tall, a person in none of {', '.join(UNITS)}",
            recording.path,
            "scale it to one of these",
        )
    return fitting[0], "detected"


def _up_axis(recording: Recording, family: Family, options: ReadOptions) -> tuple[str, str]:
    """The file's up axis and how it is known: where the head is above the feet."""
    if options.up:
        return options.up, "declared"
    every = max(1, len(recording.positions) // 200)
    few = replace(
        recording,
        positions=recording.positions[::every],
        rotations=recording.rotations[::every],
    )
    position, _ = global_pose(few)
    ours = np.zeros((len(position), len(JOINTS), 3))
    for joint in ("head", "left_ankle", "right_ankle"):
        ours[:, JOINTS.index(joint)] = position[:, recording.names.index(family.joints[joint])]
    shares = {axis: upright_share(ours, axis_vector(axis)) for axis in UP_AXES}
    best = max(UP_AXES, key=lambda axis: shares[axis])
    if family.up and shares[family.up] >= min(0.8, shares[best]):
        return family.up, f"as {family.name} files"
    if shares[best] < MIN_UPRIGHT and family.up:
        return family.up, f"as {family.name} files"
    return best, "detected"
