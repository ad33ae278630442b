"""The skeleton of a recording: a known, declared or recognised family."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from questsim import rotations as rot
from questsim.errors import InputError
from questsim.motion.convert import axes_matrix, bones, global_pose
from questsim.motion.families import Family, family_of
from questsim.motion.recognise import END, MAPPING, find_roles, with_ends
from questsim.motion.recording import Recording
from questsim.motion.rest import body_axes, find_rest, some_frames
from questsim.skeleton import JOINTS

RECOGNISED = "recognised"
AGREE = np.cos(np.radians(45.0))
"""A declared axis may differ from the file's bone by 45 degrees; zero poses splay legs up to 25."""
MAX_TURN = np.radians(15.0)
"""The zero pose may be turned or lean by less against the declared axes; it is 0 in all families'
own files."""
JUMP_M, JUMP_RATIO = 0.12, 4.0
"""Between a rest pose and the motion, joints jump further than this and than in later frames."""
TURNED = np.radians(2.0)


@dataclass(frozen=True)
class Skeleton:
    """A recording and its skeleton family.

    Attributes:
        recording: the recording; ends of leaf joints may have been added as joints.
        family: the joint mapping and the joint axes.
        explanation: one line for each of our joints and one for the axes.
    """

    recording: Recording
    family: Family
    explanation: tuple[str, ...]


def find_skeleton(recording: Recording, declared: Family | None = None) -> Skeleton:
    """Finds the skeleton of a recording.

    A known family is used only if its declared axes agree with the file's offsets; names alone
    never decide the axes.

    Args:
        recording: the motion on its own joints.
        declared: the family of a mapping file.

    Raises:
        InputError: no human skeleton is recognised; the message says what is missing.
    """
    family = declared or family_of(recording.names)
    contradiction = ""
    if family and declared is None:
        contradiction = _contradiction(recording, family)
        family = None if contradiction else family
    if family:
        if any(name.endswith(END) for name in family.joints.values()):
            recording = with_ends(recording)
        _check_joints(family, recording)
    if family and family.axes_declared:
        return Skeleton(recording, family, _lines(family, {}, f"axes as {family.name} files have"))
    reasons: dict[str, str] = {}
    if family:
        joints, name = dict(family.joints), family.name
    else:
        roles = find_roles(recording)
        recording, joints, reasons, name = roles.recording, roles.joints, roles.reasons, RECOGNISED
    rest, why = find_rest(recording, joints)
    if rest is None:
        raise InputError(f"the axes of the joints cannot be found: {why}", recording.path, MAPPING)
    found = replace(
        family or Family(name, joints, up=None, units=None),
        rest=rest.axes,
        feet_follow_shins=rest.feet_follow_shins,
    )
    how = f"axes from {rest.how}" + (f" ({contradiction})" if contradiction else "")
    return Skeleton(recording, found, _lines(found, reasons, how))


def _lines(family: Family, reasons: dict[str, str], how: str) -> tuple[str, ...]:
    lines = [f"skeleton {family.name}: {how}"]
    for joint in JOINTS:
        name = family.joints.get(joint, "-")
        reason = reasons.get(joint, "named so" if name != "-" else "not named")
        lines.append(f"  {joint:15} {name:24} {reason}")
    return tuple(lines)


def _check_joints(family: Family, recording: Recording) -> None:
    for theirs in family.joints.values():
        if theirs not in recording.names:
            raise InputError(
                f"there is no joint {theirs[:80]!r}", recording.path, "check the mapping"
            )


def _contradiction(recording: Recording, family: Family) -> str:
    """The first disagreement of declared axes and the file's bones; empty if they agree."""
    few = some_frames(recording, 50)
    position, quat = global_pose(few)
    index = {JOINTS.index(j): few.names.index(name) for j, name in family.joints.items()}
    found = bones(
        {joint: position[:, j] for joint, j in index.items()},
        {joint: quat[:, j] for joint, j in index.items()},
    )

    def seen(upper: str, bone: np.ndarray) -> np.ndarray:
        return rot.unit(axes_matrix(family.axes_of(upper)).T @ bone)

    def along(upper: str, lower: str, direction: tuple[float, float, float]) -> bool:
        return float(seen(upper, found[JOINTS.index(lower)]) @ np.array(direction)) > AGREE

    hips = [found[JOINTS.index(f"{side}_hip")] for side in ("left", "right")]
    if seen("root", hips[0] - hips[1])[1] < np.cos(MAX_TURN):
        return f"the hips do not lie as {family.name} files have them"
    thighs = [seen(f"{s}_hip", found[JOINTS.index(f"{s}_knee")]) for s in ("left", "right")]
    if abs(rot.unit(thighs[0] + thighs[1])[0]) > np.sin(MAX_TURN):
        return f"the legs do not hang as {family.name} files have them"
    for side in ("left", "right"):
        if not (
            along(f"{side}_hip", f"{side}_knee", (0.0, 0.0, -1.0))
            and along(f"{side}_knee", f"{side}_ankle", (0.0, 0.0, -1.0))
        ):
            return f"the legs do not hang as {family.name} files have them"
    return ""


def without_rest_frame(recording: Recording, family: Family) -> Recording:
    """Drops a leading rest pose (T, A or I) that is not part of the motion.

    Such a frame is recognised by a jump of the joints to the next frame that is larger than
    between later frames.
    """
    if len(recording.positions) < 3:
        return recording
    begin = replace(
        recording,
        positions=recording.positions[: int(recording.fps) + 2],
        rotations=recording.rotations[: int(recording.fps) + 2],
    )
    position, _ = global_pose(begin)
    index = {joint: begin.names.index(name) for joint, name in family.joints.items()}
    pose = position[:, list(index.values())] - position[:, [index["root"]]]
    moved = np.linalg.norm(np.diff(pose, axis=0), axis=-1).max(axis=1)
    leg = np.linalg.norm(position[0, index["left_hip"]] - position[0, index["left_knee"]])
    # A thigh is about 0.42 m long.
    jump = JUMP_M * leg / 0.42
    last = int(moved[: max(1, int(0.5 * recording.fps))].argmax())
    usual = np.percentile(np.delete(moved, last), 95)
    if moved[last] < max(jump, JUMP_RATIO * usual) or moved[:last].max(initial=0.0) > 0.05 * jump:
        return recording
    if not _at_rest(begin, position[0], index):
        return recording
    count = last + 1
    what = (
        "the first frame, a rest pose, is" if count == 1 else f"{count} frames of a rest pose are"
    )
    return replace(
        recording,
        positions=recording.positions[count:],
        rotations=recording.rotations[count:],
        notes=(*recording.notes, f"{what} left out"),
    )


def _at_rest(recording: Recording, place: np.ndarray, index: dict[str, int]) -> bool:
    """Whether the first frame is a rest pose: nearly all rotations zero, or a T-pose."""
    below = [joint for joint in index.values() if recording.parents[joint] >= 0]
    turns = rot.angle_between(recording.rotations[0, below], np.array([1.0, 0.0, 0.0, 0.0]))
    if turns.max() < TURNED:
        return True
    axes, _ = body_axes({joint: place[j] for joint, j in index.items()}, snap=False)
    if axes is None:
        return False
    arms = [place[index[f"{s}_elbow"]] - place[index[f"{s}_shoulder"]] for s in ("left", "right")]
    return bool(min(abs(rot.unit(arm) @ axes[:, 1]) for arm in arms) > AGREE)


def write_mapping(recording: Recording, path: Path) -> str:
    """Writes a draft mapping file with the recognised joints.

    Args:
        recording: the motion whose joints are to be named.
        path: the file to write; a comment in it lists all joints.

    Returns:
        what remains to be done, in one line.
    """
    from questsim.files import whole_file

    lines = ["# Joints of the file, for the right-hand side:"]
    lines += [f"#   {name}" for name in with_ends(recording).names]
    try:
        skeleton = find_skeleton(recording)
        joints, todo = dict(skeleton.family.joints), "check it, and import with --mapping"
    except InputError as error:
        family = family_of(recording.names)
        joints = dict(family.joints) if family else {}
        todo = f"{error.what}: fill in what is missing"
    lines += ["", "[joints]"]
    for joint in JOINTS:
        name = joints.get(joint, "")
        escaped = name.replace("\\", "\\\\").replace('"', '\\"')
        lines.append(f'{joint} = "{escaped}"' if name else f'# {joint} = ""')
    with whole_file(path) as fresh:
        fresh.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return todo
