"""Exporters' files as a stranger's scene has them: other programs, props, carriers, mixed orders.

Combinations of what ``rig_styles`` has one by one, and styles of more programs.
"""

from __future__ import annotations

from dataclasses import replace

from rig_styles import MIXAMO_ARM, MIXAMO_LEG, RIGS, body, spines
from rigs import Rig

PROPS = (("Camera1", (1.0, 0.5, 1.5)), ("Sword", (0.3, 0.0, 0.4)))
BIPED = RIGS["3ds Max Biped"]
ROLLS = tuple(
    (f"{{}}{name}Roll", follows, "", place)
    for name, follows, place in (
        ("Arm", "left_shoulder", (0, 0.1, 0)), ("ForeArm", "left_elbow", (0, 0.1, 0)),
        ("UpLeg", "left_hip", (0, 0, -0.2)), ("Leg", "left_knee", (0, 0, -0.2)),
    )
)  # fmt: skip
SMPL_FBX = Rig(
    body(
        spines("m_avg_Pelvis", "m_avg_Spine1", "m_avg_Spine2", "m_avg_Spine3",
               neck="m_avg_Neck", head="m_avg_Head"),
        "m_avg_{}_Collar m_avg_{}_Shoulder m_avg_{}_Elbow m_avg_{}_Wrist",
        "m_avg_{}_Hip m_avg_{}_Knee m_avg_{}_Ankle m_avg_{}_Foot",
    ),
    sides=("L", "R"), units="m", above_hips=("m_avg_root",),
    extra=(("m_avg_{}_Hand", "left_wrist", "", (0, 0.09, 0)),),
)  # fmt: skip
RUSSIAN = Rig(
    body(
        spines("Таз", "Позвоночник", "Грудь", neck="Шея", head="Голова"),
        "{}_ключица {}_плечо {}_предплечье {}_кисть", "{}_бедро {}_голень {}_стопа {}_носок",
    ),
    sides=("левая", "правая"),
)  # fmt: skip
KOREAN = Rig(
    body(
        spines("골반", "척추", "가슴", neck="목", head="머리"),
        "{}쇄골 {}어깨 {}팔꿈치 {}손목", "{}엉덩이 {}무릎 {}발목 {}발가락",
    ),
    sides=("왼쪽", "오른쪽"), pose="own",
)  # fmt: skip
BIPED_SCENE = Rig(
    body(
        spines("Bip001_Pelvis", "Bip001_Spine", "Bip001_Spine1", neck="Bip001_Neck",
               head="Bip001_Head"),
        "Bip001_{}_Clavicle Bip001_{}_UpperArm Bip001_{}_Forearm Bip001_{}_Hand",
        "Bip001_{}_Thigh Bip001_{}_Calf Bip001_{}_Foot Bip001_{}_Toe0",
    ),
    sides=("L", "R"), up="y",
    extra=(
        ("Bip001_{}_Toe0Nub", "left_toe", "", (0.07, 0, 0)),
        ("Bip001_HeadNub", "head", "", (0, 0, 0.18)),
        ("Bip001_{}_ForeTwist", "left_elbow", "", (0, 0.1, 0)),
        ("Bip001_Ponytail1", "head", "", (-0.1, 0, 0.1)),
        ("Bip001_Prop1", "root", "", (0.2, 0.4, 0)),
    ),
)  # fmt: skip

STRANGERS: dict[str, Rig] = {
    "Biped in inches, z up, A-pose, motion on the root": replace(
        BIPED, pose="A", above_hips=(), carrier="Bip01", fps=100.0, frames=100
    ),
    "Biped with underscores, keyed smoothly": replace(
        BIPED_SCENE, units="m", pose="own", carrier="Bip001"
    ),
    "VRM with a root above the hips and a camera": replace(
        RIGS["VRM"], pose="A", props=PROPS, fps=60.0
    ),
    "VRM with hair, skirt and tail": replace(
        RIGS["VRM"],
        extra=(
            ("J_Sec_Hair1_01", "head", "", (-0.1, 0, 0.1)),
            ("J_Sec_{}_SkirtSide1", "left_hip", "", (0, 0.03, -0.1)),
            ("J_Sec_{}_Bust1", "spine3", "", (0.1, 0.05, 0.05)),
            ("J_Sec_C_Tail1", "root", "", (-0.1, 0, 0)),
        ),
    ),
    "Rokoko with a Root joint and props": replace(
        RIGS["Rokoko"], above_hips=("Root",), props=PROPS, fps=100.0, frames=100
    ),
    "Rokoko with the motion on the root": replace(RIGS["Rokoko"], carrier="Root"),
    "Xsens at 240 frames a second": replace(RIGS["Xsens"], fps=240.0, frames=240),
    "Xsens with collars, z up, mixed orders": replace(
        RIGS["Xsens"], up="z", orders=("ZXY", "YXZ"), turns_first=True
    ),
    "DAZ with axes of its own": replace(RIGS["DAZ Genesis"], pose="own"),
    "DAZ with an order for each joint": replace(
        RIGS["DAZ Genesis"], orders=("XYZ", "XZY", "ZYX", "YZX"), pose="A"
    ),
    "Rigify, arms down, with props": replace(
        RIGS["Rigify"], pose="I", props=PROPS, above_hips=("root",)
    ),
    "MakeHuman in metres with axes of its own": replace(
        RIGS["MakeHuman"], pose="own", units="m", up="z"
    ),
    "Character Creator with props and mixed orders": replace(
        RIGS["Character Creator"], orders=("XYZ", "ZXY"), props=PROPS, fps=60.0
    ),
    "MotionBuilder with a camera": replace(
        RIGS["MotionBuilder"], above_hips=("Reference",), props=(("Camera", (2, 1, 1)),)
    ),
    "MotionBuilder, a performer called Footman": replace(
        RIGS["MotionBuilder"], namespace="Footman_", pose="A"
    ),
    "Mixamo, turns before places, facing left": replace(
        RIGS["Mixamo"], turns_first=True, facing=90.0
    ),
    "Mixamo, facing back": replace(RIGS["Mixamo"], facing=180.0, rest_yaw=180.0),
    "someone who stands, own axes": replace(
        RIGS["Mixamo"], pose="own", stands=True, frames=90, up="z", facing=135.0, units="m"
    ),
    "SOMA with axes of its own": replace(
        RIGS["SOMA"], pose="own", units="m", carrier="Root", above_hips=()
    ),
    "Unity with the motion on the armature": replace(
        RIGS["Unity humanoid"], pose="own", carrier="Armature"
    ),
    "SMPL's FBX": SMPL_FBX,
    "SMPL-X with mixed orders, facing right": replace(
        RIGS["SMPL-X"], up="y", orders=("XYZ", "ZYX"), facing=-90.0
    ),
    "Unreal's fifth": Rig(
        body(
            spines("pelvis", "spine_01", "spine_03", "spine_05", neck="neck_01", head="head"),
            "clavicle_{} upperarm_{} lowerarm_{} hand_{}", "thigh_{} calf_{} foot_{} ball_{}",
        ),
        sides=("l", "r"), up="z", pose="own", above_hips=("root",),
        extra=(
            ("spine_02", "spine1", "", (0, 0, 0.05)), ("spine_04", "spine2", "", (0, 0, 0.05)),
            ("neck_02", "neck", "", (0, 0, 0.04)),
            ("upperarm_twist_01_{}", "left_shoulder", "", (0, 0.1, 0)),
            ("upperarm_correctiveRoot_{}", "left_shoulder", "", (0, 0, 0)),
            ("clavicle_out_{}", "left_clavicle", "", (0, 0.1, 0)),
            ("wrist_inner_{}", "left_wrist", "", (0, 0, 0.01)),
            ("ankle_bck_{}", "left_ankle", "", (-0.05, 0, 0)),
        ),
        between=("spine_02", "spine_04", "neck_02"),
        props=(("ik_foot_root", (0, 0, 0)), ("ik_foot_l", (0, 0.1, 0)),
               ("ik_hand_gun", (0, -0.5, 1)), ("interaction", (0, 0, 0))),
    ),
    "Source engine": Rig(
        body(
            spines("Bip01_Pelvis", "Bip01_Spine", "Bip01_Spine1", "Bip01_Spine4",
                   neck="Bip01_Neck1", head="Bip01_Head1"),
            "Bip01_{}_Clavicle Bip01_{}_UpperArm Bip01_{}_Forearm Bip01_{}_Hand",
            "Bip01_{}_Thigh Bip01_{}_Calf Bip01_{}_Foot Bip01_{}_Toe0",
        ),
        sides=("L", "R"), namespace="ValveBiped.", units="inch", up="z", pose="own",
        extra=(("Bip01_Spine2", "spine2", "", (0, 0, 0.05)),
               ("Anim_Attachment_{}H", "left_wrist", "", (0, 0.05, 0))),
        between=("Bip01_Spine2",),
    ),
    "Vicon with roll joints": Rig(
        body(spines("Hips", "Spine", "Spine1", "Spine2"), MIXAMO_ARM, MIXAMO_LEG),
        namespace="Solving:", units="mm", up="z", order="XYZ", fps=120.0, frames=120,
        extra=ROLLS, between=tuple(roll[0] for roll in ROLLS),
    ),
    "Captury, ends of hands called EE": Rig(
        body(spines("Hips", "Spine", "Spine2", "Spine4"), MIXAMO_ARM, MIXAMO_LEG),
        extra=(("{}FootEE", "left_ankle", "", (0, 0, -0.05)),
               ("{}HandEE", "left_wrist", "", (0, 0.05, 0))),
        units="mm",
    ),
    "a gun in each hand": replace(
        RIGS["Mixamo"], extra=(("{}HandGun", "left_wrist", "", (0, 0.05, 0)),), namespace=""
    ),
    "iPi, a spine called middle": Rig(
        body(
            spines("Hip", "LowerSpine", "MiddleSpine", "Chest"),
            "{}Clavicle {}Shoulder {}Forearm {}Hand", "{}Thigh {}Shin {}Foot {}Toe",
        ),
        sides=("L", "R"),
    ),
    "Theia, shanks": Rig(
        body(
            spines("pelvis", "abdomen", "thorax", neck="neck", head="head"),
            "{}_clavicle {}_uarm {}_larm {}_hand", "{}_thigh {}_shank {}_foot {}_toes",
        ),
        sides=("l", "r"), units="m", up="z", pose="own",
    ),
    "Poser, an order for each joint": Rig(
        body(
            spines("Hip", "Abdomen", "Chest"),
            "{}_Collar {}_Shoulder {}_Forearm {}_Hand", "{}_Thigh {}_Shin {}_Foot {}_Toe",
        ),
        units="inch", orders=("YZX", "XZY", "ZYX"), above_hips=("BODY",),
    ),
    "Spanish names": Rig(
        body(
            spines("Cadera", "Columna", "Columna1", neck="Cuello", head="Cabeza"),
            "Hombro_{} Brazo_{} Antebrazo_{} Mano_{}", "Muslo_{} Pantorrilla_{} Pie_{} Dedos_{}",
        ),
        sides=("izq", "der"),
    ),
    "German names": Rig(
        body(
            spines("Becken", "Wirbel1", "Wirbel2", neck="Hals", head="Kopf"),
            "Schluesselbein_{} Oberarm_{} Unterarm_{} Hand_{}",
            "Oberschenkel_{} Unterschenkel_{} Fuss_{} Zehen_{}",
        ),
        sides=("links", "rechts"),
    ),
    "Russian names": RUSSIAN,
    "Korean names": KOREAN,
    "x up": replace(RIGS["Mixamo"], up="x"),
    "y down": replace(RIGS["SMPL-X"], up="-y"),
}  # fmt: skip
