"""Joint angles of the avatar from targets of its pelvis, feet, trunk and arms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M, build_body
from questsim.motion.kinematics import link_poses
from questsim.motion.synthesis.feet import Feet, leg_lengths
from questsim.skeleton import DOFS

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

FULL_STRETCH, JOGGING_STRETCH = 0.9985, 0.99
"""Maximum extension of a leg as a share of its length. Beyond it the knee would snap; joggers land
on a bent knee."""
_SHOULDER_TURN = (-np.pi / 4, np.pi / 4)


@dataclass
class Arm:
    """One arm over time.

    Attributes:
        upper: ``(T, 4)`` orientation of the upper arm in the chest's frame, quaternions wxyz.
        elbow: ``(T,)`` flexion in radians.
        wrist: ``(T, 2)`` turn of the hand about the forearm, and its side bend, in radians.
    """

    upper: np.ndarray
    elbow: np.ndarray
    wrist: np.ndarray


@dataclass
class Posture:
    """The upper body over time; yaw, pitch, roll in radians against the heading.

    Attributes:
        heading: ``(T,)`` radians.
        pelvis, chest, head: ``(T, 3)`` yaw, pitch (forward is positive), roll (to the right).
        arms: left and right.
    """

    heading: np.ndarray
    pelvis: np.ndarray
    chest: np.ndarray
    head: np.ndarray
    arms: tuple[Arm, Arm]


def dof(name: str) -> int:
    """Index of a hinge among the 33."""
    return DOFS.index(name)


def world(heading: np.ndarray, ypr: np.ndarray) -> Rotation:
    """Rotations of a link that is turned by ``(T, 3)`` yaw, pitch, roll against the heading."""
    angles = ypr.copy()
    angles[:, 0] += heading
    return rot.from_euler("ZYX", angles)


def hips(root: np.ndarray, pelvis: Rotation) -> np.ndarray:
    """World positions ``(2, T, 3)`` of the hip joints."""
    half = leg_lengths()[2]
    return np.stack([root + pelvis.apply([0.0, side * half, 0.0]) for side in (1.0, -1.0)])


def solve(posture: Posture, root: np.ndarray, feet: Feet) -> np.ndarray:
    """The poses ``(T, 40)`` with the root at ``(T, 3)`` and the feet at their targets."""
    pelvis = world(posture.heading, posture.pelvis)
    chest = world(posture.heading, posture.chest)
    head = world(posture.heading, posture.head)
    qpos = np.zeros((len(root), 7 + len(DOFS)))
    qpos[:, :3] = root
    qpos[:, 3:7] = rot.continuous(rot.as_quat(pelvis))
    angles = qpos[:, 7:]
    for foot, hip in enumerate(hips(root, pelvis)):
        angles[:, 6 * foot : 6 * foot + 6] = _leg(hip, pelvis, feet, foot)
    # The trunk bends equally below and above the waist.
    half = rot.from_rotvec((pelvis.inv() * chest).as_rotvec() / 2.0).as_euler("YXZ")
    angles[:, dof("spine_y") : dof("spine_y") + 3] = half
    angles[:, dof("chest_y") : dof("chest_y") + 3] = half
    neck = (chest.inv() * head).as_euler("YXZ")
    angles[:, dof("neck_y") : dof("neck_y") + 3] = neck
    for side, arm in enumerate(posture.arms):
        first = dof("left_shoulder_x") + 6 * side
        angles[:, first : first + 3] = shoulder_angles(arm.upper, side)
        angles[:, first + 3] = -arm.elbow
        angles[:, first + 4 : first + 6] = arm.wrist
    return qpos


def _leg(hip: np.ndarray, pelvis: Rotation, feet: Feet, foot: int) -> np.ndarray:
    """``(T, 6)`` angles of a leg: three of the hip, knee, two of the ankle, in closed form."""
    thigh, shank, _ = leg_lengths()
    yaw, pitch = feet.yaw[foot], feet.pitch[foot]
    seen = rot.from_euler("Z", -yaw[:, None]).apply(hip - feet.ankle[foot])
    roll = feet.hanging[foot] * np.arctan2(-seen[:, 1], seen[:, 2])
    attitude = rot.from_euler("ZXY", np.stack([yaw, roll, pitch], axis=-1))
    to_hip = attitude.inv().apply(hip - feet.ankle[foot])
    distance = np.minimum(np.linalg.norm(to_hip, axis=-1), (thigh + shank) * (1.0 - 1e-6))
    cos_knee = (distance**2 - thigh**2 - shank**2) / (2.0 * thigh * shank)
    knee = np.arccos(np.clip(cos_knee, -1.0, 1.0))
    # The hip in the shank's frame depends on the knee angle only: up the shank, then the thigh.
    x, z = -thigh * np.sin(knee), shank + thigh * np.cos(knee)
    # Side bend brings the hip into the shank's plane, the ankle's pitch turns it there.
    ankle_x = np.arctan2(to_hip[:, 1], to_hip[:, 2])
    depth = np.hypot(to_hip[:, 1], to_hip[:, 2])
    ankle_y = np.arctan2(x, z) - np.arctan2(to_hip[:, 0], depth)
    shin = attitude * rot.from_euler("X", -ankle_x[:, None]) * _about_y(-ankle_y)
    hip_angles = (pelvis.inv() * shin * _about_y(-knee)).as_euler("YXZ")
    return np.column_stack([hip_angles, knee, ankle_y, ankle_x])


def _about_y(angle: np.ndarray) -> Rotation:
    return rot.from_euler("Y", angle[:, None])


def shoulder_angles(upper: np.ndarray, side: int) -> np.ndarray:
    """Hinge angles ``(T, 3)`` of a shoulder for orientations ``(T, 4)`` in the chest's frame."""
    turn = rot.from_euler("z", _SHOULDER_TURN[side])
    euler = (turn.inv() * rot.as_rotation(upper) * turn).as_euler("XYZ")
    return np.unwrap(euler, axis=0)


def upper_arm(angles: np.ndarray, side: int) -> np.ndarray:
    """Orientations ``(T, 4)`` in the chest's frame for a shoulder's hinge angles ``(T, 3)``."""
    turn = rot.from_euler("z", _SHOULDER_TURN[side])
    return rot.as_quat(turn * rot.from_euler("XYZ", angles) * turn.inv())


def highest_root(
    feet: Feet, root: np.ndarray, pelvis: Rotation, stretch: float = FULL_STRETCH
) -> np.ndarray:
    """Maximum root height ``(T,)`` at which both legs reach their feet.

    A leg may be stretched to the share ``stretch`` of its length.
    """
    thigh, shank, _ = leg_lengths()
    gap = feet.ankle - hips(root, pelvis)
    flat = np.sum(gap[..., :2] ** 2, axis=-1)
    reach = (stretch * (thigh + shank)) ** 2
    rise = np.sqrt(np.maximum(reach - flat, 1e-4))
    return root[:, 2] + np.min(gap[..., 2] + rise, axis=0)


def link_centers(qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres of mass ``(T, 16, 3)`` and mass shares ``(16,)`` of the default body's links."""
    model = build_body().model
    position, quat = link_poses(qpos, DEFAULT_HEIGHT_M)
    mass = model.body_mass[1:]
    return position + rot.quat_rotate(quat, model.body_ipos[1:]), mass / mass.sum()
