"""Skeletons of mocap files, identified by their joint names, never by joint order.

A family maps file joints to the 22 joints of a ``Motion`` and gives the axes of each joint in the
T-pose; ``convert.py`` does the rest.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from questsim.errors import InputError
from questsim.skeleton import JOINTS

OPTIONAL = (
    "spine1", "spine2", "spine3", "neck", "left_clavicle", "right_clavicle", "left_toe", "right_toe"
)  # fmt: skip
"""Joints that a file may lack. They do not rotate and are placed halfway to the next joint. Toes
are placed in proportion to the leg length."""

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "cmu": 0.0254 / 0.45, "dm": 0.1}
"""Metres per unit; CMU's skeletons are in inches times 0.45 (the ASF files' length unit)."""

UP_AXES = ("y", "z", "x", "-y", "-z", "-x")


@dataclass(frozen=True, eq=False)
class Family:
    """How one kind of skeleton maps onto the 22 joints.

    Attributes:
        name: its name in reports.
        joints: our joint's name to the file's.
        axes: for each joint, which of its own axes point forward, left and up in the T-pose,
            e.g. ``"z -y x"``; a joint that is not listed takes ``zero_axes``.
        zero_axes: the same for a skeleton with a T-pose as zero pose and equal axes in all joints;
            None to find all axes in the file.
        up: the file's up axis (``"x"``, ``"-y"``, ...); None to detect it.
        units: a key of ``UNITS``; None to detect them.
        foot_pitch: radians by which the ankle joint's forward axis points below the horizontal
            when the sole is flat; ``toe_pitch`` likewise for the toe joint.
        feet_follow_shins: whether the zero pose splays the feet with the legs.
        rest: for joints whose axes were found in the file (``rest.find_rest``), forward, left and
            up as columns in the joint's own frame ``(3, 3)``; overrides ``axes``.
    """

    name: str
    joints: Mapping[str, str]
    axes: Mapping[str, str] = field(default_factory=dict)
    zero_axes: str | None = "z x y"
    up: str | None = "y"
    units: str | None = "cm"
    foot_pitch: float = 0.0
    toe_pitch: float = 0.0
    feet_follow_shins: bool = False
    rest: Mapping[str, np.ndarray] = field(default_factory=dict)

    def axes_of(self, joint: str) -> str:
        """The forward, left and up axes of our ``joint`` as declared."""
        return self.axes.get(joint, self.zero_axes or "z x y")

    @property
    def axes_declared(self) -> bool:
        """Whether the axes are known without looking at a file."""
        return self.zero_axes is not None or bool(self.axes) or bool(self.rest)


def _sides(joints: Mapping[str, str], left: str, right: str) -> dict[str, str]:
    """Our names of both sides from the left ones; ``{}`` in a file's name stands for the side."""
    out = {}
    for ours, theirs in joints.items():
        if ours.startswith("left_"):
            out[ours] = theirs.format(left)
            out[ours.replace("left_", "right_")] = theirs.format(right)
        else:
            out[ours] = theirs
    return out


def _limbs(
    trunk: str, legs: Sequence[str], feet: Sequence[str], arms: Sequence[str]
) -> dict[str, str]:
    """Axes by part of the body; the pairs are left and right."""
    out: dict[str, str] = dict.fromkeys(
        ("root", "spine1", "spine2", "spine3", "neck", "head"), trunk
    )
    for i, side in enumerate(("left", "right")):
        out |= {f"{side}_{j}": legs[i] for j in ("hip", "knee")}
        out |= {f"{side}_{j}": feet[i] for j in ("ankle", "toe")}
        out |= {f"{side}_{j}": arms[i] for j in ("clavicle", "shoulder", "elbow", "wrist")}
    return out


# The foot's pitch is that of Foot -> Toes while the sole stands on the floor, measured over
# the data set (asin of 7.49 cm between ankle and toe joint over a bone of 11.75 cm); the toe
# joint is held 16.6 degrees flatter in nearly all frames. Knees flex about +y, elbows about -y.
BANDAI_NAMCO = Family(
    name="Bandai-Namco",
    joints=_sides(
        {
            "root": "Hips", "spine1": "Spine", "spine2": "Chest", "neck": "Neck", "head": "Head",
            "left_hip": "UpperLeg_{}", "left_knee": "LowerLeg_{}",
            "left_ankle": "Foot_{}", "left_toe": "Toes_{}",
            "left_clavicle": "Shoulder_{}", "left_shoulder": "UpperArm_{}",
            "left_elbow": "LowerArm_{}", "left_wrist": "Hand_{}",
        },
        "L", "R",
    ),
    axes={
        **_limbs("y z x", ("z y -x", "-z y x"), ("x y z", "-x y -z"), ("z x y", "-z x -y")),
        "root": "z -y x",
    },
    foot_pitch=0.691,
    toe_pitch=0.691 - 0.290,
)  # fmt: skip

_MOTIONBUILDER = {
    "root": "Hips", "neck": "Neck", "head": "Head",
    "left_hip": "{}UpLeg", "left_knee": "{}Leg", "left_ankle": "{}Foot",
    "left_clavicle": "{}Shoulder", "left_shoulder": "{}Arm",
    "left_elbow": "{}ForeArm", "left_wrist": "{}Hand",
}  # fmt: skip

# Knees and elbows flex about -z. The toe joint's constant 21.45 degrees is the foot's pitch.
LAFAN1 = Family(
    name="LAFAN1",
    joints=_sides(
        _MOTIONBUILDER
        | {"spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "left_toe": "{}Toe"},
        "Left", "Right",
    ),
    axes=_limbs("y z x", ("y -z -x",) * 2, ("x -z y",) * 2, ("-y x z", "-y -x -z")),
    foot_pitch=0.374,
)  # fmt: skip

CMU = Family(
    name="CMU",
    joints=_sides(
        _MOTIONBUILDER
        | {
            "spine1": "LowerBack", "spine2": "Spine", "spine3": "Spine1",
            "left_toe": "{}ToeBase",
        },
        "Left", "Right",
    ),
    units=None,
    feet_follow_shins=True,
)  # fmt: skip

_SMPL_PARTS = {
    "left_hip": "{}Hip", "left_knee": "{}Knee", "left_ankle": "{}Ankle", "left_toe": "{}Foot",
    "left_clavicle": "{}Collar", "left_shoulder": "{}Shoulder",
    "left_elbow": "{}Elbow", "left_wrist": "{}Wrist",
}  # fmt: skip
_SMPL_TRUNK = ("Pelvis", "Spine1", "Spine2", "Spine3", "Neck", "Head")
_OUR_TRUNK = ("root", "spine1", "spine2", "spine3", "neck", "head")

SMPL = Family(
    name="SMPL",
    joints=dict(zip(_OUR_TRUNK, _SMPL_TRUNK, strict=True)) | _sides(_SMPL_PARTS, "L_", "R_"),
    up=None,
    units=None,
)

SMPL_LOWER = Family(
    name="SMPL (lower case)",
    joints={ours: theirs.lower() for ours, theirs in SMPL.joints.items() if "_" not in ours}
    | {
        f"{side}_{ours[5:]}": theirs.format(f"{side}_").lower()
        for side in ("left", "right")
        for ours, theirs in _SMPL_PARTS.items()
    },
    up=None,
    units=None,
)

# The rest pose has the world's axes everywhere and splays the legs as CMU's BVH files do. Their
# hands start at the start of the wrist bone.
ASF_AMC = Family(
    name="ASF/AMC",
    joints=_sides(
        {
            "root": "root", "spine1": "lowerback", "spine2": "upperback", "spine3": "thorax",
            "neck": "lowerneck", "head": "head",
            "left_hip": "{}femur", "left_knee": "{}tibia", "left_ankle": "{}foot",
            "left_toe": "{}toes", "left_clavicle": "{}clavicle", "left_shoulder": "{}humerus",
            "left_elbow": "{}radius", "left_wrist": "{}wrist",
        },
        "l", "r",
    ),
    units=None,
    feet_follow_shins=True,
)  # fmt: skip

# In the zero pose the arms hang, x is forward and z right.
DEEPMIMIC = Family(
    name="DeepMimic",
    joints=_sides(
        {
            "root": "root", "spine2": "chest", "neck": "neck", "head": "head_base",
            "left_hip": "{}_hip", "left_knee": "{}_knee", "left_ankle": "{}_ankle",
            "left_toe": "{}_ball", "left_shoulder": "{}_shoulder", "left_elbow": "{}_elbow",
            "left_wrist": "{}_wrist",
        },
        "left", "right",
    ),
    zero_axes="x -z y",
    units="m",
)  # fmt: skip

FAMILIES: list[Family] = [BANDAI_NAMCO, LAFAN1, CMU, SMPL, SMPL_LOWER, ASF_AMC, DEEPMIMIC]
"""All families identified by joint names; if several match a file, the first is used."""
_OWN = len(FAMILIES)


def register_family(family: Family) -> None:
    """Add a family, e.g. from a module that ``QUESTSIM_EXTENSIONS`` names.

    Raises:
        InputError: the name is taken, a joint is unknown, or a joint is missing.
    """
    where = f"register_family {family.name}"
    unknown = [joint for joint in (*family.joints, *family.axes) if joint not in JOINTS]
    lacking = [joint for joint in JOINTS if joint not in (*family.joints, *OPTIONAL)]
    if unknown:
        raise InputError(f"there is no joint {unknown[0]!r}", where, f"use {', '.join(JOINTS)}")
    if lacking:
        raise InputError(f"joints lacks {', '.join(lacking)}", where, "name the file's joints")
    same = [known for known in FAMILIES if known.name == family.name]
    if same and repr(same[0]) != repr(family):
        raise InputError(f"there is a family {family.name!r} already", where, "rename it")
    if not same:
        FAMILIES.append(family)


def registered_families() -> tuple[Family, ...]:
    """Families registered by other packages."""
    return tuple(FAMILIES[_OWN:])


def add_families(families: Sequence[Family]) -> None:
    """Register families that were registered in another process."""
    for family in families:
        register_family(family)


def family_of(names: Sequence[str]) -> Family | None:
    """The first family all of whose joints are among the file's ``names``."""
    return next((f for f in FAMILIES if set(f.joints.values()) <= set(names)), None)


def load_mapping(path: str | Path) -> Family:
    """A family from a mapping file (TOML).

    ``[joints]`` gives the file's name of each of our joints (those of ``OPTIONAL`` may be left
    out); optional keys are ``name``, ``units`` (``m``, ``cm``, ``mm``, ``inch``, ``cmu``),
    ``up`` (the file's up axis), ``zero_axes`` (the forward, left and up axes of the T-pose
    that all-zero rotations give, such as ``"z x y"``; without it the file's own rest pose or
    motion shows all axes), ``foot_pitch`` and ``toe_pitch`` in radians, ``feet_follow_shins``,
    and a table ``[axes]`` with the axes of single joints.

    Raises:
        InputError: the file is missing or not TOML, or a key or value is not one of these.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            table = tomllib.load(file)
    except FileNotFoundError:
        raise InputError("no such mapping file", path) from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"mapping file cannot be read ({str(error)[:120]})", path) from None
    table = {"name": path.stem, "joints": {}, "up": None, "units": None} | table
    if not table.get("axes"):
        table.setdefault("zero_axes", None)
    fields = [name for name in Family.__dataclass_fields__ if name != "rest"]
    _check_types(table, path)
    unknown = [key for key in table if key not in fields]
    joints = table["joints"]
    unknown += [joint for joint in (*joints, *table.get("axes", {})) if joint not in JOINTS]
    missing = [j for j in JOINTS if j not in joints and j not in OPTIONAL]
    if unknown:
        raise InputError(f"unknown key {unknown[0]!r}", path, f"keys are {', '.join(fields)}")
    if missing:
        raise InputError(f"[joints] lacks {', '.join(missing)}", path, "name the file's joints")
    if table["units"] not in (None, *UNITS):
        raise InputError(f"units {table['units']!r}", path, f"choose one of {', '.join(UNITS)}")
    family = Family(**table)
    for joint in JOINTS:
        _check_axes(family.axes_of(joint), path)
    twice = [name for name in joints.values() if list(joints.values()).count(name) > 1]
    if twice:
        raise InputError(f"[joints] uses {twice[0][:80]!r} twice", path, "name each joint once")
    return family


def _check_types(table: dict[str, object], path: Path) -> None:
    """Reject values of the wrong type for ``Family``; unknown keys are ignored."""
    number, text = (int, float), (str, type(None))
    kinds = {"joints": dict, "axes": dict, "foot_pitch": number, "toe_pitch": number}
    kinds |= {"name": str, "zero_axes": text, "up": text, "units": text, "feet_follow_shins": bool}
    wrong = [key for key, value in table.items() if not isinstance(value, kinds.get(key, object))]
    for group in ("joints", "axes"):
        entries = table.get(group, {})
        if isinstance(entries, dict):
            wrong += [f"{group}.{key}" for key, v in entries.items() if not isinstance(v, str)]
    wrong += [key for key in ("foot_pitch", "toe_pitch") if isinstance(table.get(key), bool)]
    if wrong:
        raise InputError(f"the value of {wrong[0][:80]!r} is of the wrong type", path)
    for key in ("foot_pitch", "toe_pitch"):
        value = table.get(key, 0.0)
        if not (isinstance(value, number) and abs(value) <= np.pi / 2):
            raise InputError(f"{key} is {value}, not radians up to pi / 2", path)
    if table.get("up") not in (None, *UP_AXES):
        raise InputError(f"up axis {table['up']!r}", path, f"choose one of {', '.join(UP_AXES)}")


def _check_axes(axes: str, path: Path) -> None:
    if sorted(axis.lstrip("-") for axis in axes.split()) != ["x", "y", "z"]:
        raise InputError(f"axes {axes!r} are not x, y and z in some order", path, 'try "z x y"')
