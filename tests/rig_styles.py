"""The styles of producers: how each names joints, which more it has, its pose, axes and units."""

from __future__ import annotations

from dataclasses import replace

from rigs import Rig


def body(trunk: dict[str, str], arm: str, leg: str) -> dict[str, str]:
    """Our joints to names; ``arm`` and ``leg`` are four names each, "-" for a missing one."""
    limbs = dict(zip(("clavicle", "shoulder", "elbow", "wrist"), arm.split(), strict=True))
    limbs |= dict(zip(("hip", "knee", "ankle", "toe"), leg.split(), strict=True))
    out = trunk | {f"left_{part}": name for part, name in limbs.items() if name != "-"}
    return {joint: name.replace("~", " ") for joint, name in out.items()}


def spines(root: str, *names: str, neck: str = "Neck", head: str = "Head") -> dict[str, str]:
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
MIXAMO = body(spines("Hips", "Spine", "Spine1", "Spine2"), MIXAMO_ARM, MIXAMO_LEG)

RIGS: dict[str, Rig] = {
    "Mixamo": Rig(MIXAMO, extra=FINGERS, namespace="mixamorig:"),
    "Rokoko": Rig(
        body(
            spines("Hips", "Spine1", "Spine2", "Spine4"), MIXAMO_ARM,
            "{}Thigh {}Shin {}Foot {}Toe",
        ),
        extra=(("Spine3", "spine2", "", (0, 0, 0.05)),), between=("Spine3",), order="YXZ",
    ),
    "Xsens": Rig(
        body(
            spines("Hips", "Chest", "Chest2", "Chest4"),
            "{}Collar {}Shoulder {}Elbow {}Wrist", "{}Hip {}Knee {}Ankle {}Toe",
        ),
        extra=(("Chest3", "spine2", "", (0, 0, 0.05)),), between=("Chest3",), order="YXZ",
    ),
    "Xsens segments": Rig(
        body(
            spines("Pelvis", "L5", "L3", "T8"),
            "{}Shoulder {}UpperArm {}Forearm {}Hand", "{}UpperLeg {}LowerLeg {}Foot {}Toe",
        ),
        extra=(("T12", "spine2", "", (0, 0, 0.05)),), between=("T12",), up="z", units="m",
    ),
    "Axis Neuron": Rig(
        body(
            spines("Hips", "Spine", "Spine1", "Spine3"), MIXAMO_ARM, "{}UpLeg {}Leg {}Foot -",
        ),
        extra=(("Spine2", "spine2", "", (0, 0, 0.05)), *FINGERS), between=("Spine2",),
        all_positions=True, order="YXZ", tips=False,
    ),
    "Character Creator": Rig(
        body(
            spines("CC_Base_Hip", "CC_Base_Waist", "CC_Base_Spine01", "CC_Base_Spine02",
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
        body(
            spines("DEF-spine", "DEF-spine.001", "DEF-spine.002", "DEF-spine.003",
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
        body(
            spines("root", "spine05", "spine03", "spine01", neck="neck01", head="head"),
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
        body(
            spines("hip", "abdomenLower", "abdomenUpper", "chestUpper",
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
        body(
            spines("hip", "abdomen", "chest", neck="neck", head="head"),
            "{}Collar {}Shldr {}ForeArm {}Hand", "{}Thigh {}Shin {}Foot -",
        ),
        sides=("l", "r"), units="inch",
    ),
    "3ds Max Biped": Rig(
        body(
            spines("Bip01 Pelvis", "Bip01 Spine", "Bip01 Spine1", "Bip01 Spine2",
                    neck="Bip01 Neck", head="Bip01 Head"),
            "Bip01~{}~Clavicle Bip01~{}~UpperArm Bip01~{}~Forearm Bip01~{}~Hand",
            "Bip01~{}~Thigh Bip01~{}~Calf Bip01~{}~Foot Bip01~{}~Toe0",
        ),
        sides=("L", "R"), pose="own", up="z", units="inch", above_hips=("Bip01",),
        extra=(("Bip01 {} Finger0", "left_wrist", "", (0.02, 0.08, 0)),),
    ),
    "VRM": Rig(
        body(
            spines("J_Bip_C_Hips", "J_Bip_C_Spine", "J_Bip_C_Chest", "J_Bip_C_UpperChest",
                    neck="J_Bip_C_Neck", head="J_Bip_C_Head"),
            "J_Bip_{}_Shoulder J_Bip_{}_UpperArm J_Bip_{}_LowerArm J_Bip_{}_Hand",
            "J_Bip_{}_UpperLeg J_Bip_{}_LowerLeg J_Bip_{}_Foot J_Bip_{}_ToeBase",
        ),
        sides=("L", "R"), units="m", above_hips=("Root",),
        extra=(("J_Adj_{}_FaceEye", "head", "", (0.08, 0.03, 0.05)),),
    ),
    "Unity humanoid": Rig(
        body(
            spines("Hips", "Spine", "Chest", "UpperChest"),
            "{}Shoulder {}UpperArm {}LowerArm {}Hand", "{}UpperLeg {}LowerLeg {}Foot {}Toes",
        ),
        units="m", pose="A",
    ),
    "Unreal mannequin": Rig(
        body(
            spines("pelvis", "spine_01", "spine_02", "spine_03", neck="neck_01", head="head"),
            "clavicle_{} upperarm_{} lowerarm_{} hand_{}", "thigh_{} calf_{} foot_{} ball_{}",
        ),
        sides=("l", "r"), up="z", pose="A", above_hips=("root",),
        extra=(("upperarm_twist_01_{}", "left_shoulder", "", (0, 0.1, 0)),
               ("thigh_twist_01_{}", "left_hip", "", (0, 0, -0.1)),
               ("ik_head", "head", "", (0, 0, 0))),
    ),
    "SMPL-X": Rig(
        body(
            spines("pelvis", "spine1", "spine2", "spine3", neck="neck", head="head"),
            "{}_collar {}_shoulder {}_elbow {}_wrist", "{}_hip {}_knee {}_ankle {}_foot",
        ),
        sides=("left", "right"), units="m", up="z",
        extra=(("{}_index1", "left_wrist", "", (0, 0.09, 0)),
               ("{}_eye_smplhf", "head", "", (0.08, 0.03, 0.05)),
               ("jaw", "head", "", (0.03, 0, 0))),
    ),
    "SOMA": Rig(
        body(
            spines("Hips", "Spine1", "Spine2", "Chest", neck="Neck1"), MIXAMO_ARM,
            "{}Leg {}Shin {}Foot {}ToeBase",
        ),
        extra=(("Neck2", "neck", "", (0, 0, 0.04)), ("HeadEnd", "head", "", (0, 0, 0.18)),
               ("Jaw", "head", "", (0.05, 0, 0)), ("{}Eye", "head", "", (0.08, 0.03, 0.05)),
               ("{}ToeEnd", "left_toe", "", (0.07, 0, -0.02)), *FINGERS),
        between=("Neck2",), above_hips=("Root",), pose="A",
    ),
    "short names": Rig(
        body(
            spines("root", "lowerback", "upperback", neck="neck", head="head"),
            "- {}shoulder {}elbow {}wrist", "{}hip {}knee {}ankle {}toe",
        ),
        sides=("l", "r"), pose="I", units="m",
    ),
    "Kinect": Rig(
        body(
            spines("SpineBase", "SpineMid", "SpineShoulder"),
            "- Shoulder{} Elbow{} Wrist{}", "Hip{} Knee{} Ankle{} Foot{}",
        ),
        units="m", extra=(("HandTip{}", "left_wrist", "", (0, 0.15, 0)),),
    ),
    "Biovision": Rig(
        body(
            spines("Hips", "Chest"), "{}Collar {}UpArm {}LowArm {}Hand",
            "{}UpLeg {}LowLeg {}Foot -",
        ),
        pose="I", units="inch",
    ),
    "MikuMikuDance": Rig(
        body(
            spines("センター", "上半身", "上半身2", neck="首", head="頭"),
            "{}肩 {}腕 {}ひじ {}手首", "{}足 {}ひざ {}足首 {}つま先",
        ),
        sides=("左", "右"), pose="A", encoding="shift_jis",
        extra=(("{}腕捩", "left_shoulder", "", (0, 0.14, 0)),),
    ),
    "OptiTrack Motive": Rig(
        body(
            spines("Hip", "Ab", "Chest"), "{}Shoulder {}UArm {}FArm {}Hand",
            "{}Thigh {}Shin {}Foot {}Toe",
        ),
        sides=("L", "R"), units="m",
    ),
    "Second Life": Rig(
        body(
            spines("mPelvis", "mTorso", "mChest", neck="mNeck", head="mHead"),
            "mCollar{} mShoulder{} mElbow{} mWrist{}", "mHip{} mKnee{} mAnkle{} mToe{}",
        ),
        units="m", up="z", extra=(("mFoot{}", "left_ankle", "", (0.05, 0, -0.03)),),
        between=("mFoot{}",),
    ),
    "DeepMotion": Rig(
        body(
            spines("hips_JNT", "spine_JNT", "spine1_JNT", "spine2_JNT", neck="neck_JNT",
                    head="head_JNT"),
            "{}_shoulder_JNT {}_arm_JNT {}_forearm_JNT {}_hand_JNT",
            "{}_upleg_JNT {}_leg_JNT {}_foot_JNT {}_toebase_JNT",
        ),
        sides=("l", "r"), extra=(("{}_handIndex1_JNT", "left_wrist", "", (0, 0.09, 0)),),
        pose="own",
    ),
    "Chinese names": Rig(
        body(
            spines("骨盆", "脊椎", "脊椎1", neck="颈", head="头"),
            "{}锁骨 {}上臂 {}前臂 {}手", "{}大腿 {}小腿 {}脚 {}脚趾",
        ),
        sides=("左", "右"),
    ),
    "zero pose of another up axis": Rig(MIXAMO, rest_up="z", pose="A"),
    "zero pose that faces sideways": Rig(MIXAMO, rest_yaw=90.0, up="z"),
    "zero pose that leans and is turned": Rig(MIXAMO, rest_yaw=13.0, rest_pitch=16.0),
    "own axes, z up": Rig(MIXAMO, pose="own", up="z", units="m"),
    "z up with known names": Rig(MIXAMO | {"left_toe": "{}Toe"}, up="z", units="m"),
    "100STYLE": Rig(
        body(
            spines("Hips", "Chest", "Chest2", "Chest4"),
            "{}Collar {}Shoulder {}Elbow {}Wrist", "{}Hip {}Knee {}Ankle {}Toe",
        ),
        extra=(("Chest3", "spine2", "", (0, 0, 0.05)),), between=("Chest3",), order="YXZ",
        all_positions=True, fps=60.0,
    ),
}  # fmt: skip
# Names of a known family do not say how its zero pose stands; split bones with axes of their own.
RIGS["SMPL's names, zero pose turned"] = replace(RIGS["SMPL-X"], up="y", rest_yaw=40.0)
RIGS["Rigify, own axes"] = replace(RIGS["Rigify"], pose="own")
