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
        order: of the rotation channels.
        all_positions: whether every joint has position channels.
        tips: whether End Sites say where bones end.
        above_hips: names of joints above the hips that do not move.
    """

    joints: dict[str, str]
    sides: tuple[str, str] = ("Left", "Right")
    extra: tuple[tuple[str, str, str, tuple[float, float, float]], ...] = ()
    between: tuple[str, ...] = ()
    pose: str = "T"
    rest_frame: bool = False
    up: str = "y"
    units: str = "cm"
    order: str = "ZXY"
    all_positions: bool = False
    tips: bool = True
    above_hips: tuple[str, ...] = ()
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

    turns[:, at("root")] = np.stack([0.03 * np.sin(phase), 0 * t + 0.04, 0.2 + 0.4 * t], axis=-1)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        swing = sign * np.sin(phase)
        turns[:, at(f"{side}_hip"), 1] = -0.1 - 0.45 * swing
        turns[:, at(f"{side}_knee"), 1] = 0.5 + 0.4 * np.sin(phase * 1.0 + sign)
        turns[:, at(f"{side}_ankle"), 1] = -0.35 + 0.45 * swing - 0.4 * np.sin(phase + sign)
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
    heading = np.cumsum(np.stack([np.cos(0.2 + 0.4 * t), np.sin(0.2 + 0.4 * t), 0 * t], -1), 0)
    motion = Motion(
        "truth", rig.fps, 1.1 / rig.fps * heading, quat.reshape(*turns.shape[:2], 4), offsets
    )
    lowest = motion.forward_kinematics()[0][..., 2].min(axis=1)
    root = motion.root_position.copy()
    root[:, 2] = -lowest + 0.03
    return Motion("truth", rig.fps, root, motion.rotations, offsets)


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
            number[joint] = add(rig.joints["root"], len(rows) - 1, joint, np.zeros(3))
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
    rest = _rest(rig)
    rows = _rows(rig)
    rng = np.random.default_rng(5)
    own: list[Rotation] = []  # each file joint's frame in our joint's
    for row in rows:
        follows = rest.get(row.follows, Rotation.identity())
        frame = follows.inv() * world.inv()
        if rig.pose == "own" and row.parent >= 0:
            frame = frame * Rotation.from_quat(rng.normal(size=4))
        own.append(frame if row.follows != "still" else Rotation.identity())
    turned, places = [], []
    for row, frame in zip(rows, own, strict=True):
        if row.follows == "still":
            turned.append(Rotation.identity(len(motion)))
        else:
            ours = Rotation.from_quat(quat[:, JOINTS.index(row.follows)], scalar_first=True)
            turned.append(world * ours * frame)
    columns, header = _text(rig, rows, own, turned, world.apply(position[:, 0]), places)
    lines = [*header, "MOTION", f"Frames: {len(motion)}", f"Frame Time: {1 / rig.fps:.7f}"]
    lines += [" ".join(f"{value:.6f}" for value in row) for row in np.concatenate(columns, axis=1)]
    path.write_bytes(("\n".join(lines) + "\n").encode(rig.encoding))
    return motion


def _text(rig, rows, own, turned, hips, _) -> tuple[list[np.ndarray], list[str]]:
    unit = METRES[rig.units]
    columns: list[np.ndarray] = []
    header = ["HIERARCHY"]
    axes = {"X": "Xposition", "Y": "Yposition", "Z": "Zposition"}
    turns = " ".join(f"{letter}rotation" for letter in rig.order)

    def write(number: int) -> None:
        row = rows[number]
        parent = row.parent
        offset = np.zeros(3)
        if parent >= 0 and row.follows != "still":
            offset = own[parent].inv().apply(row.offset) / unit
        root = row.follows == "root"
        if root and parent >= 0:
            offset = hips[0] / unit
        header.append(f"{'ROOT' if parent < 0 else 'JOINT'} {rig.namespace}{row.name}")
        header.append("{")
        header.append("OFFSET " + " ".join(f"{value:.6f}" for value in offset))
        with_position = root or parent < 0 or rig.all_positions
        given = f"6 {' '.join(axes.values())} {turns}" if with_position else f"3 {turns}"
        header.append(f"CHANNELS {given}")
        if with_position:
            where = hips / unit if root else np.tile(offset, (len(hips), 1))
            columns.append(where)
        local = turned[number] if parent < 0 else turned[parent].inv() * turned[number]
        columns.append(local.as_euler(rig.order, degrees=True))
        children = [i for i, other in enumerate(rows) if other.parent == number]
        for child in children:
            write(child)
        if not children:
            tip = own[number].inv().apply(row.tip) / unit if rig.tips else np.zeros(3)
            header.extend(["End Site", "{", "OFFSET " + " ".join(f"{v:.6f}" for v in tip), "}"])
        header.append("}")

    write(0)
    return columns, header


def _body(trunk: dict[str, str], arm: str, leg: str) -> dict[str, str]:
    """Our joints to names; ``arm`` and ``leg`` are four names each, "-" for a missing one."""
    limbs = dict(zip(("clavicle", "shoulder", "elbow", "wrist"), arm.split(), strict=True))
    limbs |= dict(zip(("hip", "knee", "ankle", "toe"), leg.split(), strict=True))
    out = trunk | {f"left_{part}": name for part, name in limbs.items() if name != "-"}
    return {joint: name.replace("~", " ") for joint, name in out.items()}


def _spines(root: str, *names: str, neck: str = "Neck", head: str = "Head") -> dict[str, str]:
    spine = {1: ("spine2",), 2: ("spine1", "spine2"), 3: ("spine1", "spine2", "spine3")}
    out = {"root": root} | dict(zip(spine.get(len(names), ()), names, strict=False))
    return out | ({"neck": neck} if neck else {}) | {"head": head}


FINGERS = tuple(
    (f"{name}{number}", "left_wrist", "", (0.01, 0.08 + 0.02 * number, 0.0))
    for name in ("{}HandThumb", "{}HandIndex", "{}HandMiddle")
    for number in (1, 2)
)
MIXAMO_ARM = "{}Shoulder {}Arm {}ForeArm {}Hand"
MIXAMO_LEG = "{}UpLeg {}Leg {}Foot {}ToeBase"
MIXAMO = _body(_spines("Hips", "Spine", "Spine1", "Spine2"), MIXAMO_ARM, MIXAMO_LEG)

RIGS: dict[str, Rig] = {
    "Mixamo": Rig(MIXAMO, extra=FINGERS, namespace="mixamorig:"),
    "Rokoko": Rig(
        _body(
            _spines("Hips", "Spine1", "Spine2", "Spine4"), MIXAMO_ARM,
            "{}Thigh {}Shin {}Foot {}Toe",
        ),
        extra=(("Spine3", "spine2", "", (0, 0, 0.05)),), between=("Spine3",), order="YXZ",
    ),
    "Xsens": Rig(
        _body(
            _spines("Hips", "Chest", "Chest2", "Chest4"),
            "{}Collar {}Shoulder {}Elbow {}Wrist", "{}Hip {}Knee {}Ankle {}Toe",
        ),
        extra=(("Chest3", "spine2", "", (0, 0, 0.05)),), between=("Chest3",), order="YXZ",
    ),
    "Xsens segments": Rig(
        _body(
            _spines("Pelvis", "L5", "L3", "T8"),
            "{}Shoulder {}UpperArm {}Forearm {}Hand", "{}UpperLeg {}LowerLeg {}Foot {}Toe",
        ),
        extra=(("T12", "spine2", "", (0, 0, 0.05)),), between=("T12",), up="z", units="m",
    ),
    "Axis Neuron": Rig(
        _body(
            _spines("Hips", "Spine", "Spine1", "Spine3"), MIXAMO_ARM, "{}UpLeg {}Leg {}Foot -",
        ),
        extra=(("Spine2", "spine2", "", (0, 0, 0.05)), *FINGERS), between=("Spine2",),
        all_positions=True, order="YXZ", tips=False,
    ),
    "Character Creator": Rig(
        _body(
            _spines("CC_Base_Hip", "CC_Base_Waist", "CC_Base_Spine01", "CC_Base_Spine02",
                    neck="CC_Base_NeckTwist01", head="CC_Base_Head"),
            "CC_Base_{}_Clavicle CC_Base_{}_Upperarm CC_Base_{}_Forearm CC_Base_{}_Hand",
            "CC_Base_{}_Thigh CC_Base_{}_Calf CC_Base_{}_Foot CC_Base_{}_ToeBase",
        ),
        sides=("L", "R"),
        extra=(
            ("CC_Base_{}_ThighTwist01", "left_hip", "", (0, 0, -0.1)),
            ("CC_Base_{}_CalfTwist01", "left_knee", "", (0, 0, -0.1)),
            ("CC_Base_{}_KneeShareBone", "left_knee", "", (0, 0, 0)),
            ("CC_Base_{}_UpperarmTwist01", "left_shoulder", "", (0, 0.1, 0)),
            ("CC_Base_{}_ForearmTwist01", "left_elbow", "", (0, 0.1, 0)),
            ("CC_Base_{}_Mid1", "left_wrist", "", (0, 0.09, 0)),
            ("CC_Base_{}_BigToe1", "left_toe", "", (0.03, 0, 0)),
            ("CC_Base_{}_Eye", "head", "", (0.08, 0.03, 0.05)),
            ("CC_Base_NeckTwist02", "neck", "", (0, 0, 0.03)),
        ),
        between=("CC_Base_NeckTwist02",), pose="A", above_hips=("RL_BoneRoot",),
    ),
    "MotionBuilder": Rig(MIXAMO, namespace="Character1_", pose="own", rest_frame=True),
    "Rigify": Rig(
        _body(
            _spines("DEF-spine", "DEF-spine.001", "DEF-spine.002", "DEF-spine.003",
                    neck="DEF-spine.004", head="DEF-spine.006"),
            "DEF-shoulder.{} DEF-upper_arm.{} DEF-forearm.{} DEF-hand.{}",
            "DEF-thigh.{} DEF-shin.{} DEF-foot.{} DEF-toe.{}",
        ),
        sides=("L", "R"),
        extra=(
            ("DEF-upper_arm.{}.001", "left_shoulder", "", (0, 0.145, 0)),
            ("DEF-forearm.{}.001", "left_elbow", "", (0, 0.13, 0)),
            ("DEF-thigh.{}.001", "left_hip", "", (0, 0, -0.215)),
            ("DEF-shin.{}.001", "left_knee", "", (0, 0, -0.21)),
            ("DEF-spine.005", "neck", "", (0, 0, 0.04)),
        ),
        between=(
            "DEF-upper_arm.{}.001", "DEF-forearm.{}.001", "DEF-thigh.{}.001", "DEF-shin.{}.001",
            "DEF-spine.005",
        ),
        up="z", units="m", order="XYZ", pose="A",
    ),
    "MakeHuman": Rig(
        _body(
            _spines("root", "spine05", "spine03", "spine01", neck="neck01", head="head"),
            "clavicle.{} upperarm01.{} lowerarm01.{} wrist.{}",
            "upperleg01.{} lowerleg01.{} foot.{} toe1-1.{}",
        ),
        sides=("L", "R"),
        extra=(
            ("shoulder01.{}", "left_clavicle", "", (0, 0.1, 0)),
            ("upperarm02.{}", "left_shoulder", "", (0, 0.145, 0)),
            ("lowerarm02.{}", "left_elbow", "", (0, 0.13, 0)),
            ("upperleg02.{}", "left_hip", "", (0, 0, -0.215)),
            ("lowerleg02.{}", "left_knee", "", (0, 0, -0.21)),
            ("neck02", "neck", "", (0, 0, 0.04)),
            ("jaw", "head", "", (0.05, 0, 0.01)),
        ),
        between=("shoulder01.{}", "upperarm02.{}", "lowerarm02.{}", "upperleg02.{}",
                 "lowerleg02.{}", "neck02"),
        units="dm", pose="A", order="XZY",
    ),
    "DAZ Genesis": Rig(
        _body(
            _spines("hip", "abdomenLower", "abdomenUpper", "chestUpper",
                    neck="neckLower", head="head"),
            "{}Collar {}ShldrBend {}ForearmBend {}Hand",
            "{}ThighBend {}Shin {}Foot {}Toe",
        ),
        sides=("l", "r"),
        extra=(
            ("{}ShldrTwist", "left_shoulder", "", (0, 0.14, 0)),
            ("{}ForearmTwist", "left_elbow", "", (0, 0.13, 0)),
            ("{}ThighTwist", "left_hip", "", (0, 0, -0.2)),
            ("{}Metatarsals", "left_ankle", "", (0.05, 0, -0.03)),
            ("chestLower", "spine2", "", (0, 0, 0.05)),
            ("neckUpper", "neck", "", (0, 0, 0.04)),
            ("{}Eye", "head", "", (0.08, 0.03, 0.05)),
        ),
        between=("{}ShldrTwist", "{}ForearmTwist", "{}ThighTwist", "{}Metatarsals", "chestLower",
                 "neckUpper"),
        order="XYZ",
    ),
    "DAZ for Poser": Rig(
        _body(
            _spines("hip", "abdomen", "chest", neck="neck", head="head"),
            "{}Collar {}Shldr {}ForeArm {}Hand", "{}Thigh {}Shin {}Foot -",
        ),
        sides=("l", "r"), units="inch",
    ),
    "3ds Max Biped": Rig(
        _body(
            _spines("Bip01 Pelvis", "Bip01 Spine", "Bip01 Spine1", "Bip01 Spine2",
                    neck="Bip01 Neck", head="Bip01 Head"),
            "Bip01~{}~Clavicle Bip01~{}~UpperArm Bip01~{}~Forearm Bip01~{}~Hand",
            "Bip01~{}~Thigh Bip01~{}~Calf Bip01~{}~Foot Bip01~{}~Toe0",
        ),
        sides=("L", "R"), pose="own", up="z", units="inch", above_hips=("Bip01",),
        extra=(("Bip01 {} Finger0", "left_wrist", "", (0.02, 0.08, 0)),),
    ),
    "VRM": Rig(
        _body(
            _spines("J_Bip_C_Hips", "J_Bip_C_Spine", "J_Bip_C_Chest", "J_Bip_C_UpperChest",
                    neck="J_Bip_C_Neck", head="J_Bip_C_Head"),
            "J_Bip_{}_Shoulder J_Bip_{}_UpperArm J_Bip_{}_LowerArm J_Bip_{}_Hand",
            "J_Bip_{}_UpperLeg J_Bip_{}_LowerLeg J_Bip_{}_Foot J_Bip_{}_ToeBase",
        ),
        sides=("L", "R"), units="m", above_hips=("Root",),
        extra=(("J_Adj_{}_FaceEye", "head", "", (0.08, 0.03, 0.05)),),
    ),
    "Unity humanoid": Rig(
        _body(
            _spines("Hips", "Spine", "Chest", "UpperChest"),
            "{}Shoulder {}UpperArm {}LowerArm {}Hand", "{}UpperLeg {}LowerLeg {}Foot {}Toes",
        ),
        units="m", pose="A",
    ),
    "Unreal mannequin": Rig(
        _body(
            _spines("pelvis", "spine_01", "spine_02", "spine_03", neck="neck_01", head="head"),
            "clavicle_{} upperarm_{} lowerarm_{} hand_{}", "thigh_{} calf_{} foot_{} ball_{}",
        ),
        sides=("l", "r"), up="z", pose="A", above_hips=("root",),
        extra=(("upperarm_twist_01_{}", "left_shoulder", "", (0, 0.1, 0)),
               ("thigh_twist_01_{}", "left_hip", "", (0, 0, -0.1)),
               ("ik_head", "head", "", (0, 0, 0))),
    ),
    "SMPL-X": Rig(
        _body(
            _spines("pelvis", "spine1", "spine2", "spine3", neck="neck", head="head"),
            "{}_collar {}_shoulder {}_elbow {}_wrist", "{}_hip {}_knee {}_ankle {}_foot",
        ),
        sides=("left", "right"), units="m", up="z",
        extra=(("{}_index1", "left_wrist", "", (0, 0.09, 0)),
               ("{}_eye_smplhf", "head", "", (0.08, 0.03, 0.05)),
               ("jaw", "head", "", (0.03, 0, 0))),
    ),
    "SOMA": Rig(
        _body(
            _spines("Hips", "Spine1", "Spine2", "Chest", neck="Neck1"), MIXAMO_ARM,
            "{}Leg {}Shin {}Foot {}ToeBase",
        ),
        extra=(("Neck2", "neck", "", (0, 0, 0.04)), ("HeadEnd", "head", "", (0, 0, 0.18)),
               ("Jaw", "head", "", (0.05, 0, 0)), ("{}Eye", "head", "", (0.08, 0.03, 0.05)),
               ("{}ToeEnd", "left_toe", "", (0.07, 0, -0.02)), *FINGERS),
        between=("Neck2",), above_hips=("Root",), pose="A",
    ),
    "short names": Rig(
        _body(
            _spines("root", "lowerback", "upperback", neck="neck", head="head"),
            "- {}shoulder {}elbow {}wrist", "{}hip {}knee {}ankle {}toe",
        ),
        sides=("l", "r"), pose="I", units="m",
    ),
    "Kinect": Rig(
        _body(
            _spines("SpineBase", "SpineMid", "SpineShoulder"),
            "- Shoulder{} Elbow{} Wrist{}", "Hip{} Knee{} Ankle{} Foot{}",
        ),
        units="m", extra=(("HandTip{}", "left_wrist", "", (0, 0.15, 0)),),
    ),
    "Biovision": Rig(
        _body(
            _spines("Hips", "Chest"), "{}Collar {}UpArm {}LowArm {}Hand",
            "{}UpLeg {}LowLeg {}Foot -",
        ),
        pose="I", units="inch",
    ),
    "MikuMikuDance": Rig(
        _body(
            _spines("センター", "上半身", "上半身2", neck="首", head="頭"),
            "{}肩 {}腕 {}ひじ {}手首", "{}足 {}ひざ {}足首 {}つま先",
        ),
        sides=("左", "右"), pose="A", encoding="shift_jis",
        extra=(("{}腕捩", "left_shoulder", "", (0, 0.14, 0)),),
    ),
    "OptiTrack Motive": Rig(
        _body(
            _spines("Hip", "Ab", "Chest"), "{}Shoulder {}UArm {}FArm {}Hand",
            "{}Thigh {}Shin {}Foot {}Toe",
        ),
        sides=("L", "R"), units="m",
    ),
    "Second Life": Rig(
        _body(
            _spines("mPelvis", "mTorso", "mChest", neck="mNeck", head="mHead"),
            "mCollar{} mShoulder{} mElbow{} mWrist{}", "mHip{} mKnee{} mAnkle{} mToe{}",
        ),
        units="m", up="z", extra=(("mFoot{}", "left_ankle", "", (0.05, 0, -0.03)),),
        between=("mFoot{}",),
    ),
    "DeepMotion": Rig(
        _body(
            _spines("hips_JNT", "spine_JNT", "spine1_JNT", "spine2_JNT", neck="neck_JNT",
                    head="head_JNT"),
            "{}_shoulder_JNT {}_arm_JNT {}_forearm_JNT {}_hand_JNT",
            "{}_upleg_JNT {}_leg_JNT {}_foot_JNT {}_toebase_JNT",
        ),
        sides=("l", "r"), extra=(("{}_handIndex1_JNT", "left_wrist", "", (0, 0.09, 0)),),
        pose="own",
    ),
    "own axes": Rig(MIXAMO, pose="own"),
    "own axes, z up": Rig(MIXAMO, pose="own", up="z", units="m"),
    "z up with known names": Rig(MIXAMO | {"left_toe": "{}Toe"}, up="z", units="m"),
    "100STYLE": Rig(
        _body(
            _spines("Hips", "Chest", "Chest2", "Chest4"),
            "{}Collar {}Shoulder {}Elbow {}Wrist", "{}Hip {}Knee {}Ankle {}Toe",
        ),
        extra=(("Chest3", "spine2", "", (0, 0, 0.05)),), between=("Chest3",), order="YXZ",
        all_positions=True, fps=60.0,
    ),
}  # fmt: skip
