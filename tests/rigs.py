"""BVH files in the styles of many producers, written from one motion whose joints are known.

A style names the joints, adds those that we lack (twist joints, fingers, more spine joints, ends)
and says in what pose, axes and units the file's skeleton is. Every file joint follows one joint
of the true motion: its frame is that joint's turned by a constant, so that its place is exact.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from questsim import rotations as rot
from questsim.motion.convert import world_axes
from questsim.motion.motion import Motion
from questsim.skeleton import JOINT_PARENTS, JOINTS

# Metres in the T-pose: forward, left, up; the left side and the trunk.
OFFSETS: dict[str, tuple[float, float, float]] = {
    "root": (0, 0, 0), "left_hip": (0, 0.09, -0.05), "left_knee": (0, 0, -0.43),
    "left_ankle": (0, 0, -0.42), "left_toe": (0.13, 0, -0.06),
    "spine1": (0, 0, 0.08), "spine2": (-0.01, 0, 0.13), "spine3": (0, 0, 0.10),
    "neck": (0, 0, 0.21), "head": (0.02, 0, 0.09),
    "left_clavicle": (0, 0.03, 0.14), "left_shoulder": (0, 0.15, 0),
    "left_elbow": (0, 0.29, 0), "left_wrist": (0, 0.26, 0),
}  # fmt: skip
TIPS = {"toe": (0.07, 0.0, -0.02), "wrist": (0.0, 0.17, 0.0), "head": (0.0, 0.0, 0.18)}
CARRIED = np.array([0.01, 0.0, -0.04])
"""Metres from a carrier to the hips."""
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "dm": 0.1}


@dataclass(frozen=True)
class Rig:
    """A producer's style.

    Attributes:
        joints: our joint (of the left side for both) to the file's name, ``{}`` for the side;
            joints that are missing do not turn in the true motion.
        sides: how left and right are written.
        extra: more joints: name, our joint that it follows, the file joint above it (as in
            ``joints``), its place in metres from our joint; ``between`` joints also take over the
            children of the joint above that lie beyond them.
        between: names of extra joints that are links of the chain.
        pose: of the skeleton with all rotations zero: T, A, I (arms down), or own (every joint
            has axes of its own).
        rest_frame: whether the first frame is a T-pose.
        up, units: of the file.
        rest_up, rest_yaw, rest_pitch: of the zero pose: up axis, if it is another, heading and
            forward lean in degrees.
        order: of the rotation channels.
        all_positions: whether every joint has position channels.
        tips: whether End Sites say where bones end.
        above_hips: names of joints above the hips that do not move.
        carrier: the joint above the hips that has the motion's place and turn; the hips hang on
            it and have rotation channels only.
        props: joints that hang on the top joint beside the body, metres from it.
        orders: orders of the rotation channels that the joints take in turn; else all ``order``.
        turns_first: whether rotation channels come before position channels.
        facing: heading of the whole motion in degrees.
        stands: whether the performer stands and gestures instead of walking.
        seed: of the joints' own axes.
    """

    joints: dict[str, str]
    sides: tuple[str, str] = ("Left", "Right")
    extra: tuple[tuple[str, str, str, tuple[float, float, float]], ...] = ()
    between: tuple[str, ...] = ()
    pose: str = "T"
    rest_frame: bool = False
    up: str = "y"
    rest_up: str = ""
    rest_yaw: float = 0.0
    rest_pitch: float = 0.0
    units: str = "cm"
    order: str = "ZXY"
    all_positions: bool = False
    tips: bool = True
    above_hips: tuple[str, ...] = ()
    carrier: str = ""
    props: tuple[tuple[str, tuple[float, float, float]], ...] = ()
    orders: tuple[str, ...] = ()
    turns_first: bool = False
    facing: float = 0.0
    stands: bool = False
    seed: int = 5
    encoding: str = "utf-8"
    namespace: str = ""
    frames: int = 48
    fps: float = 30.0


@dataclass
class _Row:
    name: str
    parent: int
    follows: str
    offset: np.ndarray  # from the parent's followed joint, in that joint's T-pose axes
    tip: np.ndarray = field(default_factory=lambda: np.zeros(3))


def true_motion(rig: Rig) -> Motion:
    """Someone who walks, turns and swings the arms; joints that the rig lacks do not turn."""
    t = np.arange(rig.frames) / rig.fps
    phase = 2 * np.pi * 0.9 * t
    turns = np.zeros((len(t), len(JOINTS), 3))

    def at(joint: str) -> int:
        return JOINTS.index(joint)

    turn = 0.2 + (0.0 if rig.stands else 0.4) * t
    turns[:, at("root")] = np.stack([0.03 * np.sin(phase), 0 * t + 0.04, turn], axis=-1)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        swing = (0.05 if rig.stands else 1.0) * sign * np.sin(phase)
        turns[:, at(f"{side}_hip"), 1] = -0.1 - 0.45 * swing
        bend = np.full(len(t), -0.3) if rig.stands else 0.4 * np.sin(phase + sign)
        turns[:, at(f"{side}_knee"), 1] = 0.5 + bend
        turns[:, at(f"{side}_ankle"), 1] = -0.35 + 0.45 * swing - bend
        turns[:, at(f"{side}_toe"), 1] = -0.1
        turns[:, at(f"{side}_clavicle"), 0] = sign * 0.05 * swing
        turns[:, at(f"{side}_shoulder")] = Rotation.from_euler(
            "yx", np.stack([0.5 * swing, np.full(len(t), -sign * 1.25)], axis=-1)
        ).as_rotvec()
        turns[:, at(f"{side}_elbow"), 2] = -sign * (0.6 + 0.4 * np.cos(phase))
        turns[:, at(f"{side}_wrist"), 0] = 0.1 * swing
    turns[:, at("spine1"), 1] = 0.05 + 0.03 * np.sin(2 * phase)
    turns[:, at("spine2"), 2] = 0.08 * np.sin(phase)
    turns[:, at("spine3"), 0] = 0.04 * np.sin(phase)
    turns[:, at("neck"), 1] = -0.06
    turns[:, at("head"), 2] = 0.2 * np.sin(0.7 * phase)
    missing = [j for j in JOINTS if j.replace("right_", "left_") not in rig.joints]
    turns[:, [at(joint) for joint in missing]] = 0.0
    if rig.rest_frame:
        turns[0] = 0.0
    offsets = np.array(
        [np.array(OFFSETS[j.replace("right_", "left_")]) * _mirror(j) for j in JOINTS]
    )
    quat = Rotation.from_rotvec(turns.reshape(-1, 3)).as_quat(scalar_first=True)
    heading = np.cumsum(np.stack([np.cos(turn), np.sin(turn), 0 * t], -1), 0) * (not rig.stands)
    motion = Motion(
        "truth", rig.fps, 1.1 / rig.fps * heading, quat.reshape(*turns.shape[:2], 4), offsets
    )
    lowest = motion.forward_kinematics()[0][..., 2].min(axis=1)
    root = motion.root_position.copy()
    root[:, 2] = -lowest + 0.03
    turned = motion.rotations.copy()
    facing = Rotation.from_euler("z", rig.facing, degrees=True)
    turned[:, 0] = rot.as_quat(facing * rot.as_rotation(turned[:, 0]))
    return Motion("truth", rig.fps, facing.apply(root), turned, offsets)


def _mirror(joint: str) -> np.ndarray:
    return np.array([1.0, -1.0 if joint.startswith("right_") else 1.0, 1.0])


def _rest(rig: Rig) -> dict[str, Rotation]:
    """Orientations of our joints in the file's zero pose, from the T-pose."""
    drop = {"T": 0.0, "A": 50.0, "I": 85.0, "own": 0.0}[rig.pose]
    out = {}
    for joint in JOINTS:
        arm = joint.split("_")[-1] in ("shoulder", "elbow", "wrist")
        sign = -1.0 if joint.startswith("left_") else 1.0
        out[joint] = Rotation.from_euler("x", sign * drop * arm, degrees=True)
    return out


def _rows(rig: Rig) -> list[_Row]:
    """The file's joints, parents first."""
    rows: list[_Row] = []
    number: dict[str, int] = {}
    held: dict[str, int] = {}  # our joint to the file joint that its children hang on

    def add(name: str, parent: int, follows: str, offset: np.ndarray) -> int:
        rows.append(_Row(name, parent, follows, offset))
        return len(rows) - 1

    for name in rig.above_hips:
        add(name, len(rows) - 1, "still", np.zeros(3))
    for name, place in rig.props:
        add(name, 0, "still", np.array(place))
    top = len(rig.above_hips) - 1
    if rig.carrier:
        top = add(rig.carrier, top, "carrier", np.zeros(3))
    for joint in JOINTS:
        left = joint.replace("right_", "left_")
        if left not in rig.joints:
            continue
        side = rig.sides[joint.startswith("right_")]
        above, offset = joint, np.zeros(3)
        while True:
            place = np.array(OFFSETS[above.replace("right_", "left_")]) * _mirror(above)
            offset = offset + place
            parent = JOINTS[JOINT_PARENTS[JOINTS.index(above)]]
            if above == "root" or parent in number:
                break
            above = parent
        if joint == "root":
            number[joint] = add(rig.joints["root"], top, joint, CARRIED * bool(rig.carrier))
        else:
            holder = held.get(parent, number[parent])
            # A link between the two has taken part of the way.
            taken = rows[holder].offset if holder != number[parent] else np.zeros(3)
            number[joint] = add(rig.joints[left].format(side), holder, joint, offset - taken)
        part = joint.split("_")[-1]
        if part in TIPS:
            rows[number[joint]].tip = np.array(TIPS[part]) * _mirror(joint)
        for name, follows, _, place in rig.extra:
            if follows != left:
                continue
            extra = add(
                name.format(side), held.get(joint, number[joint]), joint,
                np.array(place) * _mirror(joint),
            )  # fmt: skip
            if name in rig.between:
                held[joint] = extra
    return rows


def write_rig(path: Path, rig: Rig) -> Motion:
    """Writes the file; returns the true motion."""
    motion = true_motion(rig)
    position, quat = motion.forward_kinematics()
    world = Rotation.from_matrix(world_axes(rig.up).T)
    zero = Rotation.from_matrix(world_axes(rig.rest_up or rig.up).T)
    zero = zero * Rotation.from_euler("ZY", [rig.rest_yaw, rig.rest_pitch], degrees=True)
    rest = _rest(rig)
    rows = _rows(rig)
    rng = np.random.default_rng(rig.seed)
    own: list[Rotation] = []  # each file joint's frame in our joint's
    for row in rows:
        follows = rest.get(row.follows, Rotation.identity())
        frame = follows.inv() * zero.inv()
        if rig.pose == "own" and row.parent >= 0:
            frame = frame * Rotation.from_quat(rng.normal(size=4))
        own.append(frame if row.follows != "still" else Rotation.identity())
    turned = []
    for row, frame in zip(rows, own, strict=True):
        if row.follows == "still":
            turned.append(Rotation.identity(len(motion)))
        else:
            follows = row.follows if row.follows in JOINTS else "root"
            ours = Rotation.from_quat(quat[:, JOINTS.index(follows)], scalar_first=True)
            turned.append(world * ours * frame)
    hips = position[:, 0]
    if rig.carrier:
        hips = hips - Rotation.from_quat(quat[:, 0], scalar_first=True).apply(CARRIED)
    columns, header = _text(rig, rows, own, turned, world.apply(hips))
    lines = [*header, "MOTION", f"Frames: {len(motion)}", f"Frame Time: {1 / rig.fps:.7f}"]
    lines += [" ".join(f"{value:.6f}" for value in row) for row in np.concatenate(columns, axis=1)]
    path.write_bytes(("\n".join(lines) + "\n").encode(rig.encoding))
    return motion


def _text(
    rig: Rig,
    rows: list[_Row],
    own: list[Rotation],
    turned: list[Rotation],
    moved: np.ndarray,
) -> tuple[list[np.ndarray], list[str]]:
    """The frames' columns and the hierarchy's lines; ``moved`` ``(T, 3)`` is the body's place."""
    unit = METRES[rig.units]
    columns: list[np.ndarray] = []
    header = ["HIERARCHY"]
    orders = rig.orders or (rig.order,)

    def write(number: int) -> None:
        row = rows[number]
        parent = row.parent
        moves = row.follows == ("carrier" if rig.carrier else "root")
        offset = np.zeros(3)
        if parent >= 0:
            offset = own[parent].inv().apply(row.offset) / unit
        if moves and parent >= 0:
            offset = moved[0] / unit
        header.append(f"{'ROOT' if parent < 0 else 'JOINT'} {rig.namespace}{row.name}")
        header.append("{")
        header.append("OFFSET " + " ".join(f"{value:.6f}" for value in offset))
        order = orders[number % len(orders)]
        parts = [[f"{letter}rotation" for letter in order]]
        local = turned[number] if parent < 0 else turned[parent].inv() * turned[number]
        values = [local.as_euler(order, degrees=True)]
        if moves or parent < 0 or rig.all_positions:
            parts.insert(0, [f"{letter}position" for letter in "XYZ"])
            values.insert(0, moved / unit if moves else np.tile(offset, (len(moved), 1)))
        if rig.turns_first:
            parts, values = parts[::-1], values[::-1]
        names = [name for part in parts for name in part]
        header.append(f"CHANNELS {len(names)} {' '.join(names)}")
        columns.extend(values)
        children = [i for i, other in enumerate(rows) if other.parent == number]
        for child in children:
            write(child)
        if not children:
            tip = own[number].inv().apply(row.tip) / unit if rig.tips else np.zeros(3)
            header.extend(["End Site", "{", "OFFSET " + " ".join(f"{v:.6f}" for v in tip), "}"])
        header.append("}")

    write(0)
    return columns, header
