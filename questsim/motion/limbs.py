"""The avatar's trunk, legs and arms from a motion's joints: the steps of retargeting.

Trunk and head take the motion's orientations; legs and arms are bent by two-bone inverse
kinematics in the plane of the motion's knee or elbow. ``retarget`` uses these steps for a whole
clip, ``retarget_stream`` for a stream of poses.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M, build_body
from questsim.body_proportions import Proportions
from questsim.motion.kinematics import link_offsets
from questsim.motion.motion import Motion
from questsim.skeleton import DOFS, JOINT_PARENTS, JOINTS, LINKS

SIDES = ("left", "right")
FULL_STRETCH = 0.999
"""Maximum extension of a limb as a share of its length; beyond it the knee would snap."""
FLOOR_PERCENTILE = 10.0
"""The floor lies where the lower foot is lowest; a percentile is robust to single dips."""
# The arms point sideways in the motion's T-pose and hang in the avatar's zero pose.
ARM_REST = {
    "left": rot.as_quat(Rotation.from_euler("x", 90, degrees=True)),
    "right": rot.as_quat(Rotation.from_euler("x", -90, degrees=True)),
}
# The shoulders' first two hinges are rotated about z by these angles (humanoid.xml).
SHOULDER_TURN = {"left": -np.pi / 4, "right": np.pi / 4}
ARM_JOINTS = ("wrist", "elbow", "shoulder")
STRAIGHT_ARM_WEIGHT = 0.1
"""Weight of the upper arm's own hinge axis against the sine of its angle to the wrist's line."""


def joint_index(name: str) -> int:
    """Row of a motion's joint."""
    return JOINTS.index(name)


def _dofs(*names: str) -> list[int]:
    return [DOFS.index(name) for name in names]


def dofs_of_sides(*names: str) -> np.ndarray:
    """Columns ``(2, n)`` of hinges, left and right."""
    return np.array([_dofs(*(f"{side}_{name}" for name in names)) for side in SIDES])


def _link_offset(link: str, height: float, proportions: Proportions | None = None) -> np.ndarray:
    return link_offsets(proportions)[LINKS.index(link)] * (height / DEFAULT_HEIGHT_M)


def _length(link: str, height: float, proportions: Proportions | None = None) -> float:
    """Metres from the parent's origin to the link's."""
    return float(np.linalg.norm(_link_offset(link, height, proportions)))


def _lengths(part: str, height: float, proportions: Proportions | None = None) -> np.ndarray:
    """``(2,)`` metres from the parent's origin to the left and the right link."""
    return np.array([_length(f"{side}_{part}", height, proportions) for side in SIDES])


def leg_m(height: float, proportions: Proportions | None = None) -> float:
    """Metres from the avatar's hip to its ankle with the knee stretched."""
    return _length("left_shin", height, proportions) + _length("left_foot", height, proportions)


def hips_of(
    root: np.ndarray, quat: np.ndarray, height: float, proportions: Proportions | None = None
) -> np.ndarray:
    """Positions ``(T, 2, 3)`` of the hips for a pelvis at ``root``, oriented as ``quat``."""
    pelvis = quat[:, joint_index("root")]
    offsets = [_link_offset(f"{side}_thigh", height, proportions) for side in SIDES]
    return np.stack([root + rot.quat_rotate(pelvis, offset) for offset in offsets], axis=1)


def leg_ratio(motion: Motion, height: float, proportions: Proportions | None = None) -> float:
    """Ratio of the avatar's leg length (thigh and shin) to the motion's."""
    motion_leg = sum(
        np.linalg.norm(motion.offsets[joint_index(f"{side}_{part}")])
        for side in SIDES
        for part in ("knee", "ankle")
    )
    avatar_leg = sum(
        np.linalg.norm(_link_offset(f"{side}_{part}", height, proportions))
        for side in SIDES
        for part in ("shin", "foot")
    )
    return float(avatar_leg / motion_leg)


def root_path(
    motion: Motion, position: np.ndarray, height: float, proportions: Proportions | None = None
) -> np.ndarray:
    """``(T, 3)`` path of the pelvis (midway between the hips) before floor placement."""
    hips = position[:, [joint_index("left_hip"), joint_index("right_hip")]].mean(axis=1)
    return hips * leg_ratio(motion, height, proportions)


def _euler(relative: np.ndarray, order: str) -> np.ndarray:
    """Intrinsic angles ``(T, ..., 3)`` in radians, without jumps by full turns."""
    angles = rot.as_rotation(relative).as_euler(order)
    return np.unwrap(angles.reshape(*relative.shape[:-1], 3), axis=0)


def _relative(parent: np.ndarray, child: np.ndarray) -> np.ndarray:
    return rot.quat_multiply(rot.quat_conjugate(parent), child)


def fill_trunk(quat: np.ndarray, angles: np.ndarray) -> dict[str, np.ndarray]:
    """Fill the trunk's and neck's angles; return orientations ``(T, 4)`` of its links."""
    links = {
        "pelvis": quat[:, joint_index("root")],
        "spine": quat[:, joint_index("spine1")],
        "chest": quat[:, joint_index("spine3")],
        "head": quat[:, joint_index("head")],
    }
    chain = np.stack(list(links.values()), axis=1)
    hinges = ("spine", "chest", "neck")
    dofs = [_dofs(f"{hinge}_y", f"{hinge}_x", f"{hinge}_z") for hinge in hinges]
    angles[:, dofs] = _euler(_relative(chain[:, :-1], chain[:, 1:]), "YXZ")
    return links


def ankle_rise(motion: Motion, position: np.ndarray) -> float:
    """Metres from sole to ankle of the motion's flat foot.

    The toe joint's drop below the ankle in the rest pose plus its height above the sole. No
    skeleton stores the latter: the lowest height of the toe joint in the file is used, clipped to
    plausible values.
    """
    toes = [joint_index(f"{side}_toe") for side in SIDES]
    drop = -motion.offsets[toes, 2].mean()
    toe_height = np.percentile(position[:, toes, 2].min(axis=1), FLOOR_PERCENTILE)
    return float(max(drop, 0.0) + np.clip(toe_height, 0.01, 0.05))


def _frame(down: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Quaternions ``(..., 4)`` of links that hang along ``down``, their y axis near ``left``."""
    z = -rot.unit(down)
    y = rot.unit(left - np.sum(left * z, axis=-1, keepdims=True) * z)
    return rot.matrix_to_quat(np.stack([np.cross(y, z), y, z], axis=-1))


def _two_bones(
    reach: np.ndarray, axis: np.ndarray, upper: np.ndarray, lower: np.ndarray, bend: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bend both two-bone limbs so that their ends are at ``reach`` ``(T, 2, 3)`` from their starts.

    Args:
        reach: from hips or shoulders to ankles or wrists, metres.
        axis: ``(T, 2, 3)`` approximate axes of the hinges in the world.
        upper, lower: ``(2,)`` lengths of the bones in metres.
        bend: sign of the hinges' rotation about their axes: +1 knees, -1 elbows.

    Returns:
        orientations ``(T, 2, 4)`` of the upper and the lower links, and the angles ``(T, 2)``.
    """
    distance = np.linalg.norm(reach, axis=-1)
    distance = np.clip(distance, abs(upper - lower) + 1e-3, FULL_STRETCH * (upper + lower))
    at_start = (upper**2 + distance**2 - lower**2) / (2 * upper * distance)
    at_hinge = (upper**2 + lower**2 - distance**2) / (2 * upper * lower)
    angle = bend * (np.pi - np.arccos(np.clip(at_hinge, -1.0, 1.0)))
    lead = -bend * np.arccos(np.clip(at_start, -1.0, 1.0))
    straight = _frame(reach, axis)
    upper_quat = rot.quat_multiply(straight, _about_y(lead))
    return upper_quat, rot.quat_multiply(upper_quat, _about_y(angle)), angle


def _about_y(angle: np.ndarray) -> np.ndarray:
    zero = np.zeros_like(angle)
    return np.stack([np.cos(angle / 2), zero, np.sin(angle / 2), zero], axis=-1)


def fill_legs(
    root: np.ndarray,
    quat: np.ndarray,
    ankles: np.ndarray,
    feet: np.ndarray,
    height: float,
    angles: np.ndarray,
    proportions: Proportions | None = None,
) -> None:
    """Fill the angles of the legs: ankles at ``(T, 2, 3)``, feet oriented as ``(T, 2, 4)``."""
    pelvis = quat[:, joint_index("root"), None]
    hips = hips_of(root, quat, height, proportions)
    thighs = quat[:, [joint_index(f"{side}_hip") for side in SIDES]]
    knee_axes = rot.quat_rotate(thighs, np.array([0.0, 1.0, 0.0]))
    upper, lower = (_lengths(part, height, proportions) for part in ("shin", "foot"))
    thigh, shin, knee = _two_bones(ankles - hips, knee_axes, upper, lower, bend=1.0)
    turns = np.stack([_relative(pelvis, thigh), _relative(shin, feet)], axis=1)
    found = _euler(turns, "YXZ")
    angles[:, dofs_of_sides("hip_y", "hip_x", "hip_z")] = found[:, 0]
    angles[:, dofs_of_sides("knee_y")] = knee[..., None]
    angles[:, dofs_of_sides("ankle_y", "ankle_x")] = found[:, 1, :, :2]


def fill_arms(
    motion: Motion,
    position: np.ndarray,
    quat: np.ndarray,
    links: dict[str, np.ndarray],
    height: float,
    angles: np.ndarray,
    proportions: Proportions | None = None,
) -> None:
    """Fill the angles of the arms; positions are relative, so the root does not matter."""
    upper_lengths, lower_lengths = (
        _lengths(part, height, proportions) for part in ("forearm", "hand")
    )
    shoulders = np.stack([_link_offset(f"{s}_upper_arm", height, proportions) for s in SIDES])
    span, centre = _arm_rest(motion)
    ratios = (np.abs(shoulders[:, 1]) + upper_lengths + lower_lengths) / span
    spine = joint_index("spine3")
    middle = position[:, spine] + rot.quat_rotate(quat[:, spine], centre)
    wrists, elbows, starts = ([joint_index(f"{s}_{part}") for s in SIDES] for part in ARM_JOINTS)
    wrist = (position[:, wrists] - middle[:, None]) * ratios[:, None]
    across = shoulders * np.array([0.0, 1.0, 0.0])
    reach = wrist - rot.quat_rotate(links["chest"][:, None], across)

    upper = position[:, elbows] - position[:, starts]
    rest = np.stack([ARM_REST[side] for side in SIDES])
    own_axis = rot.quat_rotate(rot.quat_multiply(quat[:, starts], rest), np.array([0.0, 1.0, 0.0]))
    # A bent arm defines its plane; towards a straight arm, the upper arm's axis takes over.
    axis = np.cross(rot.unit(reach), rot.unit(upper)) + STRAIGHT_ARM_WEIGHT * own_axis
    arm, forearm, elbow = _two_bones(reach, axis, upper_lengths, lower_lengths, bend=-1.0)

    turn = np.stack([rot.yaw_quat(np.array(SHOULDER_TURN[side])) for side in SIDES])
    relative = _relative(turn, _relative(links["chest"][:, None], arm))
    relative = rot.quat_multiply(relative, turn)
    dofs = dofs_of_sides("shoulder_x", "shoulder_y", "shoulder_z")
    angles[:, dofs] = _within_turn(_euler(relative, "XYZ"), dofs)
    angles[:, dofs_of_sides("elbow_y")] = elbow[..., None]
    hand = rot.quat_multiply(quat[:, wrists], rest)
    dofs = dofs_of_sides("wrist_z", "wrist_x")
    angles[:, dofs] = _within_turn(_euler(_relative(forearm, hand), "ZXY")[..., :2], dofs)


def _arm_rest(motion: Motion) -> tuple[float, np.ndarray]:
    """Half the arm span, and the midpoint of the shoulders from spine3, in the rest pose."""

    def from_spine(name: str) -> np.ndarray:
        joint, place = joint_index(name), np.zeros(3)
        while joint != joint_index("spine3"):
            place = place + motion.offsets[joint]
            joint = JOINT_PARENTS[joint]
        return place

    centre = (from_spine("left_shoulder") + from_spine("right_shoulder")) / 2.0
    span = (from_spine("left_wrist")[1] - from_spine("right_wrist")[1]) / 2.0
    return float(span), centre


def _within_turn(values: np.ndarray, dofs: np.ndarray) -> np.ndarray:
    """Adds full turns to angles ``(T, *dofs.shape)`` to bring them close to their ranges."""
    limits = build_body().model.jnt_range[1:][dofs]
    middle = limits.mean(axis=-1)
    turns = np.round((np.median(values, axis=0) - middle) / (2 * np.pi))
    return values - 2 * np.pi * turns
