"""Reads a motion file of any supported format into a checked ``Motion``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from questsim.errors import InputError
from questsim.motion.amass import read_amass
from questsim.motion.anatomy import anatomy_problems, proportion_problems
from questsim.motion.asf_amc import read_asf_amc
from questsim.motion.bvh import read_bvh
from questsim.motion.checks import (
    FEET_OFF_FLOOR,
    FLOOR_TOLERANCE_M,
    MAX_STATURE_M,
    MIN_CHILD_M,
    MIN_STATURE_M,
    MIN_UPRIGHT,
    UNKNOWN_UNITS,
    Report,
    check,
    jump_at_start,
    refuse,
    stature,
    upright_share,
)
from questsim.motion.convert import axis_vector, global_pose, recording_to_motion
from questsim.motion.deepmimic import read_deepmimic
from questsim.motion.families import SMPL, UNITS, UP_AXES, Family, load_mapping
from questsim.motion.motion import Motion
from questsim.motion.orders import order_problem
from questsim.motion.recognise import MAPPING
from questsim.motion.recording import MAX_FPS, MIN_FPS, Recording
from questsim.motion.rest import some_frames, zero_pose
from questsim.motion.skeletons import find_skeleton, without_rest_frame
from questsim.motion.sources import TEXT_SUFFIXES
from questsim.skeleton import JOINTS

USUAL_STATURE_M = 1.7
"""Of several plausible units, the one whose skeleton is nearest to this height is chosen."""
DETECTED = "detected"
MIN_UNITS = 1e-6
"""A shorter skeleton has no size that could be scaled."""
RESTS_UPRIGHT = 0.95
"""Cosine between up and a rest pose: who lies all the time is no evidence of the up axis."""
CLEARLY = 0.3
"""Legs by which the lowest joints must be nearer to 0 along one axis than along another."""
_CLIP_NAME = re.compile(r"dataset-\d+_(?P<kind>[a-z-]+)_(?P<style>[a-z-]+)_\d+")


@dataclass(frozen=True)
class ReadOptions:
    """What the user declares about files; None means that it is detected.

    Attributes:
        units: a key of ``families.UNITS``.
        up: the up axis, one of ``UP_AXES``.
        fps: the true frame rate.
        mapping: a mapping file for an unknown skeleton (see ``families.load_mapping``).
        height_m: the subject's stature; the skeleton is scaled to it.
        smpl_file: a SMPL model file, for AMASS files.
        licence: the data's licence.
        accept: accept the file even if it fails the checks.
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
        if self.fps is not None and not MIN_FPS <= self.fps <= MAX_FPS:
            what = f"frame rate {self.fps:g} is not within {MIN_FPS:g}-{MAX_FPS:g}"
            raise InputError(what, "--fps")
        if self.height_m is not None and not MIN_STATURE_M <= self.height_m <= MAX_STATURE_M:
            what = (
                f"a height of {self.height_m:g} m is not within {MIN_STATURE_M}-{MAX_STATURE_M} m"
            )
            raise InputError(what, "--height")


def read_motion(
    path: str | Path, options: ReadOptions | None = None, family: Family | None = None
) -> tuple[Motion, Report]:
    """Reads and checks a BVH, AMC, DeepMimic or AMASS file.

    Args:
        path: the file.
        options: the user's declarations about it.
        family: its skeleton; by default that of ``options.mapping`` or the one recognised.

    Raises:
        InputError: the file cannot be read, its skeleton is unknown, or it fails a check and
            ``options.accept`` is not set.
    """
    path, options = Path(path), options or ReadOptions()
    if path.suffix.lower() == ".npz":
        motion, report = _read_amass(path, options)
    else:
        recording = read_as_recorded(path, options.fps)
        motion, report = _on_own_skeleton(recording, options, family)
    motion, report = _on_floor(motion, report)
    if not options.accept:
        refuse(report, str(path))
    return motion, report


def _on_floor(motion: Motion, report: Report) -> tuple[Motion, Report]:
    """Moves a motion far from z = 0 onto the floor, e.g. a file with the hips at the origin."""
    if abs(report.foot_height_m) <= FLOOR_TOLERANCE_M:
        return motion, report
    down = np.array([0.0, 0.0, report.foot_height_m])
    motion = replace(motion, root_position=motion.root_position - down)
    note = f"moved by {-report.foot_height_m:+.2f} m onto the floor"
    again = check(motion, report.units, report.up)
    return motion, replace(
        report,
        foot_height_m=again.foot_height_m,
        problems=tuple(p for p in report.problems if not p.startswith(FEET_OFF_FLOOR)),
        notes=(*report.notes, note),
        lifted_m=-report.foot_height_m,
    )


def _read_amass(path: Path, options: ReadOptions) -> tuple[Motion, Report]:
    recording = read_amass(
        path, height_m=options.height_m, smpl_file=options.smpl_file, fps=options.fps
    )
    units, up = options.units or "m", options.up or "z"
    motion = recording_to_motion(recording, SMPL, UNITS[units], up, licence=options.licence)
    return motion, check(motion, units, up)


def read_as_recorded(path: Path, fps: float | None = None) -> Recording:
    """Reads a motion file on its own skeleton; its extension decides the format.

    Raises:
        InputError: the file cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix == ".npz":
        return read_amass(path, fps=fps)
    if suffix in TEXT_SUFFIXES:
        return read_deepmimic(path, fps)
    return (read_asf_amc if suffix == ".amc" else read_bvh)(path, fps)


def explain(path: Path, options: ReadOptions) -> tuple[str, ...]:
    """One line for each joint: which file joint it is mapped to, and why.

    Raises:
        InputError: the file cannot be read, or its skeleton is not recognised.
    """
    declared = load_mapping(options.mapping) if options.mapping else None
    skeleton = find_skeleton(read_as_recorded(path, options.fps), declared)
    return (f"{path}:", *skeleton.explanation)


def _on_own_skeleton(
    recording: Recording, options: ReadOptions, declared: Family | None
) -> tuple[Motion, Report]:
    if declared is None and options.mapping:
        declared = load_mapping(options.mapping)
    skeleton = find_skeleton(recording, declared)
    whole, family = skeleton.recording, skeleton.family
    recording = without_rest_frame(whole, family)
    about = {"licence": options.licence}
    if named := _CLIP_NAME.fullmatch(recording.path.stem):
        about |= named.groupdict()
    said = {
        "notes": recording.notes,
        "explanation": skeleton.explanation,
        "skeleton": family.name,
        "foot_pitch": family.foot_pitch,
    }
    metres, units = _units(recording, family, options, declared=declared is not None)
    usual = bool(family.units and family.up and metres == UNITS[family.units])
    if usual and not (options.units or options.up or options.height_m):
        motion, notes = _motion(recording, family, metres, family.up or "y", about)
        report = check(motion, units, f"{family.up} (as {family.name} files)")
        if not report.problems:
            report = replace(report, **said | {"notes": (*recording.notes, *notes)})
            return motion, _with_order(report, recording, family, metres, (family.up or "y",))
    up, up_note = _up_axis(recording, family, options)
    if up_note == DETECTED:
        has_rest_frame = len(recording.positions) < len(whole.positions)
        up = (_standing_up(_first(whole), family) if has_rest_frame else None) or up
        up = _lying_up(recording, family, up)
    motion, notes = _motion(recording, family, metres, up, about)
    said["notes"] = (*recording.notes, *notes)
    report = replace(check(motion, units, f"{up} ({up_note})"), **said)
    # Feet far from the floor are put onto it, and are no reason to skip the anatomy.
    if family.rest and all(p.startswith(FEET_OFF_FLOOR) for p in report.problems):
        report = replace(report, problems=(*report.problems, *anatomy_problems(motion)))
    ups = [up]
    if up_note == DETECTED:  # with wrong angles perhaps wrongly
        rest = _standing_up(zero_pose(recording), family)
        ups += [axis for axis in (rest, family.up or "y") if axis]
    return motion, _with_order(report, recording, family, metres, ups)


def _motion(
    recording: Recording, family: Family, metres: float, up: str, about: dict[str, str]
) -> tuple[Motion, list[str]]:
    """The recording on our skeleton, and what was changed in it."""
    notes: list[str] = []
    motion = recording_to_motion(recording, family, metres, up, notes, **about)
    if begin := jump_at_start(motion):
        motion = replace(
            motion, root_position=motion.root_position[begin:], rotations=motion.rotations[begin:]
        )
        notes.append(f"the root jumps in the first {begin} frames: they are left out")
    return motion, notes


def _with_order(
    report: Report, recording: Recording, family: Family, metres: float, ups: Sequence[str]
) -> Report:
    """The report with wrong angles as its first problem: others may follow from them."""
    problem = order_problem(recording, family, ups, metres)
    return replace(report, problems=(problem, *report.problems)) if problem else report


def _units(
    recording: Recording, family: Family, options: ReadOptions, *, declared: bool
) -> tuple[float, str]:
    """Metres per file unit, the name of the units and how they were determined.

    A family's usual units are used only if they give a plausible human height. Those of a mapping
    file (``declared``) are the user's word: if no units fit, they stay, and the checks refuse them.
    """
    if options.units:
        return UNITS[options.units], f"{options.units} (declared)"
    # One frame is enough for bone lengths, and in one frame no bone can stretch.
    first = _first(recording)
    height = stature(recording_to_motion(first, family, 1.0, family.up or "y"))
    if options.height_m:
        metres = options.height_m / max(height, 1e-9)
        return metres, f"{metres:.3g} m (declared height)"
    fitting = [u for u, m in UNITS.items() if MIN_CHILD_M <= height * m <= MAX_STATURE_M]
    if family.units and declared and not fitting:
        return UNITS[family.units], f"{family.units} (as {family.name} files)"
    if not fitting:
        return _unknown_units(first, family, height)
    nearest = min(fitting, key=lambda unit: abs(np.log(height * UNITS[unit] / USUAL_STATURE_M)))
    how = "detected"
    if family.units in fitting:
        nearest, how = family.units, f"as {family.name} files"
    tall = height * UNITS[nearest]
    if tall < MIN_STATURE_M:
        note = f"{how}; {tall:.2f} m tall, scaled to {MIN_STATURE_M} m"
        return UNITS[nearest] * MIN_STATURE_M / tall, f"{nearest} ({note})"
    return UNITS[nearest], f"{nearest} ({how})"


def _unknown_units(first: Recording, family: Family, height: float) -> tuple[float, str]:
    """Metres per file unit of a skeleton that no known units make a person's height."""
    sized = recording_to_motion(first, family, 1.0 / max(height, 1e-9), family.up or "y")
    if shape := proportion_problems(sized):
        raise InputError("; ".join(shape), first.path, MAPPING if family.rest else "export it anew")
    if not height > MIN_UNITS:
        raise InputError("the legs have no length", first.path, "export the whole skeleton")
    metres = USUAL_STATURE_M / height
    return metres, f"{metres:.3g} m ({UNKNOWN_UNITS}; scaled to {USUAL_STATURE_M} m)"


def _up_axis(recording: Recording, family: Family, options: ReadOptions) -> tuple[str, str]:
    """The file's up axis, along which the head is above the feet, and how it was determined."""
    if options.up:
        return options.up, "declared"
    shares = _upright_shares(some_frames(recording, 200), family)
    best = max(UP_AXES, key=lambda axis: shares[axis])
    if family.up and shares[family.up] >= min(0.8, shares[best]):
        return family.up, f"as {family.name} files"
    if shares[best] < MIN_UPRIGHT and family.up:
        return family.up, f"as {family.name} files"
    return best, DETECTED


def _first(recording: Recording) -> Recording:
    return replace(recording, positions=recording.positions[:1], rotations=recording.rotations[:1])


def _standing_up(pose: Recording, family: Family) -> str | None:
    """The axis along which a pose of one frame stands upright; None if it does not."""
    shares = _upright_shares(pose, family)
    best = max(UP_AXES, key=lambda axis: shares[axis])
    return best if shares[best] > RESTS_UPRIGHT else None


def _lying_up(recording: Recording, family: Family, up: str) -> str:
    """The zero pose's up axis if the motion lies on the floor along it, else ``up``.

    Someone who only lies is as upright along a horizontal axis as others along the vertical, but
    the lowest joints are on the floor, at 0, along the vertical only.
    """
    rest = _standing_up(zero_pose(recording), family)
    if rest in (None, up):
        return up
    position, _ = global_pose(some_frames(recording, 200))
    index = {ours: recording.names.index(theirs) for ours, theirs in family.joints.items()}
    places = position[:, list(index.values())]
    thigh = position[:, index["left_knee"]] - position[:, index["left_hip"]]
    leg = max(2.0 * float(np.linalg.norm(thigh, axis=-1).mean()), 1e-9)

    def off_floor(axis: str) -> float:
        return abs(float(np.median((places @ axis_vector(axis)).min(axis=1)))) / leg

    return rest if off_floor(rest) + CLEARLY < off_floor(up) else up


def _upright_shares(recording: Recording, family: Family) -> dict[str, float]:
    """How upright the performer is along each axis (``checks.upright_share``)."""
    position, _ = global_pose(recording)
    ours = np.zeros((len(position), len(JOINTS), 3))
    for joint in ("head", "left_ankle", "right_ankle"):
        ours[:, JOINTS.index(joint)] = position[:, recording.names.index(family.joints[joint])]
    return {axis: upright_share(ours, axis_vector(axis)) for axis in UP_AXES}
