"""Converts a recording on its own skeleton to a ``Motion`` on ours by constant rotations."""

from __future__ import annotations

from collections.abc import Container
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from questsim import rotations as rot
from questsim.errors import InputError
from questsim.motion.families import Family
from questsim.motion.motion import Motion
from questsim.motion.recording import Recording
from questsim.motion.twist import ARBITRARY, untwist
from questsim.skeleton import JOINT_PARENTS, JOINTS, NUM_JOINTS, generations

DOWN = np.array([0.0, 0.0, -1.0])
STRAIGHT: dict[str, tuple[str, np.ndarray]] = {
    "left_hip": ("left_knee", DOWN),
    "left_knee": ("left_ankle", DOWN),
    "right_hip": ("right_knee", DOWN),
    "right_knee": ("right_ankle", DOWN),
    "left_shoulder": ("left_elbow", np.array([0.0, 1.0, 0.0])),
    "left_elbow": ("left_wrist", np.array([0.0, 1.0, 0.0])),
    "right_shoulder": ("right_elbow", np.array([0.0, -1.0, 0.0])),
    "right_elbow": ("right_wrist", np.array([0.0, -1.0, 0.0])),
}
"""Limbs that the T-pose stretches: the joint at the bone's end, and the bone's direction."""

MAX_STRETCH_M = 0.02
"""How far joints may shift in their parents, in files with positions of all joints."""
MIN_BONE = 0.02
"""A limb bone shorter than this share of the longest one has no usable direction."""
TOE_AHEAD, TOE_BELOW = 0.076, 0.030
"""Ball of the foot from the ankle as fractions of stature (see ``amass``), without toes."""


def axis_vector(axis: str) -> np.ndarray:
    """The unit vector ``(3,)`` of ``"x"``, ``"-y"``, ..."""
    vector = np.zeros(3)
    vector["xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return vector


def axes_matrix(axes: str, where: str = "") -> np.ndarray:
    """Columns: forward, left and up of an axes string such as ``"z -y x"``, ``(3, 3)``."""
    matrix, right_handed = _axes(axes)
    if not right_handed:
        raise InputError(f"axes {axes!r} are left-handed", where or None, "reverse one axis")
    return matrix.copy()


@lru_cache(maxsize=64)
def _axes(axes: str) -> tuple[np.ndarray, bool]:
    matrix = np.stack([axis_vector(axis) for axis in axes.split()], axis=1)
    return matrix, not np.linalg.det(matrix) < 0.5


def world_axes(up: str) -> np.ndarray:
    """The rotation ``(3, 3)`` that takes a file's world with that up axis to ours, z up.

    Files with y up face +z and files with z up face -y by custom; only the heading depends on it.
    """
    forward = {"y": "z", "z": "-y", "x": "y"}[up[-1]]
    up_vector, forward_vector = axis_vector(up), axis_vector(forward)
    return np.stack([forward_vector, np.cross(up_vector, forward_vector), up_vector])


def global_pose(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """World positions ``(T, J, 3)`` and orientations ``(T, J, 4)`` in the file's frame."""
    positions, orientations = recording.positions.copy(), recording.rotations.copy()
    for joints, parents in generations(tuple(int(p) for p in recording.parents)):
        turn = orientations[:, parents]
        bones = rot.quat_rotate(turn, recording.positions[:, joints])
        positions[:, joints] = positions[:, parents] + bones
        orientations[:, joints] = rot.quat_multiply(turn, recording.rotations[:, joints])
    return positions, orientations


def recording_to_motion(
    recording: Recording,
    family: Family,
    metres: float,
    up: str,
    changes: list[str] | None = None,
    **meta: Any,
) -> Motion:
    """The recording on the 22-joint skeleton.

    Joint positions are kept to within rounding if the file's bones are rigid.

    Args:
        recording: the motion as the file has it.
        family: the joint mapping, and the joint axes in the T-pose.
        metres: metres per file unit.
        up: the file's up axis, ``"y"``, ``"-z"``, ...
        changes: if given, what was changed in the motion is added to it.
        **meta: ``kind``, ``style``, ``licence`` of the ``Motion``.

    Raises:
        InputError: a joint of the family is not in the file, or bones change length.
    """
    where = str(recording.path)
    index = _file_joints(recording, family)
    positions, orientations = global_pose(recording)
    # Keyed by our joints, since a file may lack some: positions (m), turns in the file's frame.
    places = {j: positions[:, column] * metres for j, column in index.items()}
    own = {j: orientations[:, column] for j, column in index.items()}
    rest = _rest_rotations(family, bones(places, own), where)
    _check_axes(rest, where)
    world = world_axes(up)
    turned = _orientations(own, rest, world)
    placed = {joint: place @ world.T for joint, place in places.items()}
    _check_rigid(recording, set(index.values()), metres)
    if untwist(placed, turned) and changes is not None:
        changes.append(ARBITRARY)
    offsets = _offsets(placed, turned, _toes(placed))
    return Motion(
        name=recording.path.stem,
        fps=recording.fps,
        root_position=placed[0],
        rotations=rot.continuous(_local(turned)),
        offsets=offsets,
        source=recording.path.name,
        source_sha256=recording.sha256,
        **meta,
    )


def _check_axes(rest: dict[int, np.ndarray], where: str) -> None:
    """Refuse a file in which the axes of a joint are undefined."""
    with np.errstate(invalid="ignore"):
        sizes = np.linalg.det(np.stack(list(rest.values())))
    for joint, size in zip(rest, sizes, strict=True):
        if not size > 0.5:  # NaN is not
            what = f"the axes of {JOINTS[joint]} cannot be found: bones around it have no length"
            raise InputError(what, where, "export the whole skeleton")


def _orientations(
    own: dict[int, np.ndarray], rest: dict[int, np.ndarray], world: np.ndarray
) -> np.ndarray:
    """Orientations of our 22 joints in our axes ``(T, 22, 4)``; a missing one has its parent's.

    Args:
        own: ``(T, 4)`` in the file's frame, by joint.
        rest: ``(3, 3)`` the joint's axes in the T-pose, by joint.
        world: ``(3, 3)`` from the file's frame to ours.
    """
    turned = np.empty((len(own[0]), NUM_JOINTS, 4))
    turned[:, list(rest)] = rot.quat_multiply(
        rot.matrix_to_quat(world),
        rot.quat_multiply(
            np.stack([own[joint] for joint in rest], axis=1),
            rot.matrix_to_quat(np.stack(list(rest.values()))),
        ),
    )
    for joint in range(NUM_JOINTS):
        if joint not in rest:
            turned[:, joint] = turned[:, JOINT_PARENTS[joint]]
    return turned


def _file_joints(recording: Recording, family: Family) -> dict[int, int]:
    """File index of each of our joints that the file has."""
    index = {}
    for ours, theirs in family.joints.items():
        if theirs not in recording.names:
            raise InputError(
                f"there is no joint {theirs!r}", str(recording.path), "check the mapping"
            )
        index[JOINTS.index(ours)] = recording.names.index(theirs)
    return index


def bones(places: dict[int, np.ndarray], own: dict[int, np.ndarray]) -> dict[int, np.ndarray]:
    """Median position ``(3,)`` of each joint in the frame of its nearest mapped parent."""
    above = {joint: _mapped_parent(joint, places) for joint in places}
    pairs = [(joint, parent) for joint, parent in above.items() if parent is not None]
    back = rot.quat_conjugate(np.stack([own[parent] for _, parent in pairs], axis=1))
    apart = np.stack([places[joint] - places[parent] for joint, parent in pairs], axis=1)
    middle = np.median(rot.quat_rotate(back, apart), axis=0)
    return {joint: bone for (joint, _), bone in zip(pairs, middle, strict=True)}


def _local(turned: np.ndarray) -> np.ndarray:
    """Local rotations ``(T, 22, 4)`` from world orientations ``(T, 22, 4)``."""
    local = turned.copy()
    above = rot.quat_conjugate(turned[:, JOINT_PARENTS[1:]])
    local[:, 1:] = rot.quat_multiply(above, turned[:, 1:])
    return local / np.linalg.norm(local, axis=-1, keepdims=True)


def _mapped_parent(joint: int, mapped: Container[int]) -> int | None:
    """The nearest ancestor that the file has; None for the root."""
    while joint:
        joint = JOINT_PARENTS[joint]
        if joint in mapped:
            return joint
    return None


def _rest_rotations(
    family: Family, bones: dict[int, np.ndarray], where: str
) -> dict[int, np.ndarray]:
    """For each mapped joint our T-pose axes as columns in the joint's own frame ``(3, 3)``.

    Limb bones that are not straight in the family's rest pose are straightened by the shortest
    rotation, so that the hinge axes of knees and elbows stay lateral and vertical.
    """
    own = _declared_axes(family, where)
    turns = _straightening(family, own, bones, where)
    rest, straightened = {}, {}
    for joint, matrix in own.items():
        name = JOINTS[joint]
        part, turn = name.split("_")[-1], turns.get(joint, np.eye(3))
        if part == "wrist" or (part in ("ankle", "toe") and family.feet_follow_shins):
            turn = straightened[JOINT_PARENTS[joint]]
        straightened[joint] = turn
        rest[joint] = matrix @ turn.T
    return rest


def _declared_axes(family: Family, where: str) -> dict[int, np.ndarray]:
    """The family's T-pose axes ``(3, 3)`` of each mapped joint, before limbs are straightened."""
    axes = {}
    for joint, name in enumerate(JOINTS):
        if name not in family.joints:
            continue
        found = family.rest.get(name)
        matrix = axes_matrix(family.axes_of(name), where) if found is None else found
        part = name.split("_")[-1]
        pitch = {"ankle": family.foot_pitch, "toe": family.toe_pitch}.get(part, 0.0)
        if pitch:
            matrix = matrix @ Rotation.from_euler("y", -pitch).as_matrix()
        axes[joint] = matrix
    return axes


def _straightening(
    family: Family, axes: dict[int, np.ndarray], bones: dict[int, np.ndarray], where: str
) -> dict[int, np.ndarray]:
    """The turn ``(3, 3)`` that straightens each limb bone which the rest pose bends."""
    longest = max(float(np.linalg.norm(bone)) for bone in bones.values())
    turns = {}
    for joint, matrix in axes.items():
        if JOINTS[joint] not in STRAIGHT:
            continue
        child, direction = STRAIGHT[JOINTS[joint]]
        bone = bones[JOINTS.index(child)]
        if np.linalg.norm(bone) <= MIN_BONE * longest:
            raise InputError(
                f"the bone from {family.joints[JOINTS[joint]]!r} to {family.joints[child]!r} has "
                "no length",
                where,
                "export with all bones, or map other joints",
            )
        turn = _shortest_turn(matrix.T @ bone, direction)
        if turn is not None:
            turns[joint] = turn
    if not turns:
        return {}
    matrices = Rotation.from_rotvec(np.stack(list(turns.values()))).as_matrix()
    return dict(zip(turns, matrices, strict=True))


def _shortest_turn(vector: np.ndarray, onto: np.ndarray) -> np.ndarray | None:
    """Rotation vector ``(3,)`` that points ``vector`` along ``onto``; None if it does already."""
    vector = vector / np.linalg.norm(vector)
    axis = _cross(vector, onto)
    sine = np.linalg.norm(axis)
    return None if sine < 1e-12 else axis / sine * np.arctan2(sine, vector @ onto)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The cross product of two single vectors; ``np.cross`` takes ten times as long."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _check_rigid(recording: Recording, mapped: Container[int], metres: float) -> None:
    """Rejects bones that change length, in files with positions of all joints."""
    length = np.linalg.norm(recording.positions, axis=-1) * metres
    stretches = abs(length - np.median(length, axis=0))
    greatest = stretches.max(axis=0)
    for joint, parent in enumerate(recording.parents):
        above = int(parent)
        while above >= 0 and above not in mapped:
            above = int(recording.parents[above])
        if joint not in mapped or above < 0:
            continue
        if greatest[joint] > MAX_STRETCH_M:
            frame = int(stretches[:, joint].argmax())
            raise InputError(
                f"{recording.names[joint][:40]!r} is {100 * greatest[joint]:.1f} cm further from "
                f"its parent or nearer at frame {frame}: bones are not rigid",
                str(recording.path),
                "export with rigid bones",
            )


def _toes(placed: dict[int, np.ndarray]) -> dict[int, np.ndarray]:
    """Offsets ``(3,)`` of toes that the file lacks, for legs of their length."""
    toes = [JOINTS.index(f"{side}_toe") for side in ("left", "right")]
    missing = [joint for joint in toes if joint not in placed]
    if not missing:
        return {}

    def length(a: str, b: str) -> float:
        bone = placed[JOINTS.index(a)] - placed[JOINTS.index(b)]
        return float(np.median(np.linalg.norm(bone, axis=-1)))

    legs = [
        length(f"{side}_{a}", f"{side}_{b}")
        for side in ("left", "right")
        for a, b in (("hip", "knee"), ("knee", "ankle"))
    ]
    stature = sum(legs) / 2.0 / (0.530 - 0.039)
    toe = np.array([TOE_AHEAD, 0.0, -TOE_BELOW]) * stature
    return dict.fromkeys(missing, toe)


def _offsets(
    placed: dict[int, np.ndarray], turned: np.ndarray, toes: dict[int, np.ndarray]
) -> np.ndarray:
    """Offsets ``(22, 3)`` of all joints in their parents; missing ones are put halfway.

    If a joint's position in its parent varies (the file bends at a joint that we lack) and the
    parent has no other child, the parent is rotated in ``turned`` to point at it.
    """
    offsets = np.zeros((NUM_JOINTS, 3))
    mapped, placed = set(placed), dict(placed)
    for joint in range(1, NUM_JOINTS):
        if joint in toes or joint in placed:
            continue
        parent = JOINT_PARENTS[joint]
        target = placed[_next_mapped(joint, placed)]
        inverse = rot.quat_conjugate(turned[:, parent])
        bone = rot.quat_rotate(inverse, target - placed[parent])
        offsets[joint] = np.median(bone, axis=0) / 2.0
        placed[joint] = placed[parent] + rot.quat_rotate(turned[:, parent], offsets[joint])
    for joint, toe in toes.items():
        offsets[joint] = toe
    there = [j for j in range(1, NUM_JOINTS) if j in mapped]
    parents = [JOINT_PARENTS[joint] for joint in there]
    apart = np.stack([placed[j] - placed[p] for j, p in zip(there, parents, strict=True)], axis=1)
    bent = rot.quat_rotate(rot.quat_conjugate(turned[:, parents]), apart)
    offsets[there] = np.median(bent, axis=0)
    strays = np.linalg.norm(bent - offsets[there], axis=-1).max(axis=0) > 1e-3
    for column in np.flatnonzero(strays):
        parent = parents[column]
        if JOINT_PARENTS.count(parent) == 1:
            _aim(turned[:, parent], bent[:, column], offsets[there[column]])
    return offsets


def _next_mapped(joint: int, placed: dict[int, np.ndarray]) -> int:
    """The first joint below a missing one that the file has; the neck below the spine."""
    below = [j for j in range(joint + 1, NUM_JOINTS) if JOINT_PARENTS[j] == joint]
    for child in below:
        if child in placed:
            return child
    return _next_mapped(below[0], placed)


def _aim(turned: np.ndarray, bone: np.ndarray, mean: np.ndarray) -> None:
    """Turns orientations ``(T, 4)`` in place so that ``mean`` points along each ``bone``."""
    if min(np.linalg.norm(mean), np.linalg.norm(bone, axis=-1).min()) < 1e-6:
        return
    a = mean / np.linalg.norm(mean)
    b = bone / np.linalg.norm(bone, axis=-1, keepdims=True)
    half = np.concatenate([1.0 + b @ a[:, None], np.cross(a, b)], axis=-1)
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    turned[:] = rot.quat_multiply(turned, half)
