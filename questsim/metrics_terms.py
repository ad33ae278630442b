"""Errors of an evaluation as pure functions of arrays: one number per frame.

``F`` frames, 16 links in the order of ``skeleton.LINKS``; positions in metres in the world,
orientations as quaternions wxyz. A function returns its samples in the unit of its name, and
``metrics`` takes the mean of the samples of all clips. docs/metrics.md compares the definitions
with the literature's.
"""

from __future__ import annotations

import numpy as np

from questsim import rotations as rot
from questsim import sensors
from questsim.skeleton import LINK_PARENTS, LINKS

DEVICES: tuple[str, ...] = ("headset", "left_controller", "right_controller")
"""Devices that the device errors compare, whichever of them the policy observes."""

SIP_LINKS: tuple[int, ...] = tuple(
    LINKS.index(name) for name in ("left_thigh", "right_thigh", "left_upper_arm", "right_upper_arm")
)

_CM = 100.0


def link_error_m(position: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Mean distance in metres ``(F,)`` of the link origins from the reference's.

    Args:
        position: ``(F, 16, 3)`` simulated link origins.
        reference: ``(F, 16, 3)`` those of the clip.
    """
    return np.linalg.norm(position - reference, axis=-1).mean(axis=-1)


def mpjpe_cm(position: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Mean per-joint position error in cm ``(F,)``: 16 link origins, in the world, unaligned.

    Source: MPJPE of Ionescu et al., "Human3.6M", TPAMI 2014, without its alignment of the root;
    E_g-mpjpe of Luo et al., "Perpetual Humanoid Control", ICCV 2023; QuestSim section 5.
    """
    return link_error_m(position, reference) * _CM


def mpjpe_root_aligned_cm(position: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """The same in cm ``(F,)`` after both pelvis origins are moved onto each other; no turning.

    Source: MPJPE as in Ionescu et al., TPAMI 2014; E_mpjpe of Luo et al., ICCV 2023.
    """
    return mpjpe_cm(position - position[:, :1], reference - reference[:, :1])


def mpjre_deg(quat: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Mean per-joint rotation error in degrees ``(F,)``: 15 joints, each in its parent's frame.

    The geodesic angle between simulated and reference rotation of a link in its parent, averaged
    over all links but the pelvis, whose orientation ``root_deg`` gives.

    Source: the angle is TransPose's local joint angle error (Yi et al., SIGGRAPH 2021); leaving
    the root out is AvatarPoser's MPJRE (Jiang et al., ECCV 2022). Released code of the AvatarPoser
    family averages the three axis-angle components instead, which is smaller.

    Args:
        quat: ``(F, 16, 4)`` simulated link orientations.
        reference: ``(F, 16, 4)`` those of the clip.
    """
    parents = list(LINK_PARENTS[1:])

    def local(q: np.ndarray) -> np.ndarray:
        return rot.quat_multiply(rot.quat_conjugate(q[:, parents]), q[:, 1:])

    return np.degrees(rot.angle_between(local(quat), local(reference))).mean(axis=-1)


def root_cm(position: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Distance in cm ``(F,)`` of the pelvis origin from the reference's, in the world.

    Source: "root error" of QuestSim table 1.
    """
    return np.linalg.norm(position[:, 0] - reference[:, 0], axis=-1) * _CM


def root_deg(quat: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Geodesic angle in degrees ``(F,)`` between the pelvis orientations in the world."""
    return np.degrees(rot.angle_between(quat[:, 0], reference[:, 0]))


def sip_deg(quat: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """SIP error in degrees ``(F,)``: global orientation of thighs and upper arms, unaligned.

    Source: von Marcard et al., "Sparse Inertial Poser", Eurographics 2017, as TransPose (Yi et
    al., SIGGRAPH 2021) and PIP (Yi et al., CVPR 2022) report it; QuestSim table 1.

    Args:
        quat: ``(F, 16, 4)`` simulated link orientations.
        reference: ``(F, 16, 4)`` those of the clip.
    """
    links = list(SIP_LINKS)
    return np.degrees(rot.angle_between(quat[:, links], reference[:, links])).mean(axis=-1)


def jitter_km_s3(position: np.ndarray, fps: float) -> np.ndarray:
    """Jerk in km/s^3 ``(F - 3,)``: length of the third difference, mean over the 16 link origins.

    It measures one motion, not an error: compare it with the reference's own. Fewer than four
    frames give no sample.

    Source: Flash & Hogan 1985 for jerk as smoothness; "jitter" of TransPose (Yi et al., SIGGRAPH
    2021, in 10^2 m/s^3) and PIP (Yi et al., CVPR 2022, in km/s^3); QuestSim table 1. Jerk by
    differences grows with the frame rate where motion is noise: compare at one rate only.
    """
    jerk = np.diff(position, n=3, axis=0) * fps**3
    return np.linalg.norm(jerk, axis=-1).mean(axis=-1) / 1000.0


def mpjve_cm_s(position: np.ndarray, reference: np.ndarray, fps: float) -> np.ndarray:
    """Mean per-joint velocity error in cm/s ``(F - 1,)``, by differences of adjacent frames.

    Source: AvatarPoser (Jiang et al., ECCV 2022).
    """
    error = np.diff(position - reference, axis=0) * fps
    return np.linalg.norm(error, axis=-1).mean(axis=-1) * _CM


def device_errors(
    position: np.ndarray,
    quat: np.ndarray,
    reference: np.ndarray,
    reference_quat: np.ndarray,
    height_m: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Position error in cm ``(F,)`` and rotation error in degrees ``(F,)`` of the devices.

    ``mhpe_cm`` and ``mhre_deg``: poses of headset and both controllers on the simulated head and
    hands, compared with the user's; mean over the three, in the world, geodesic angles.

    Source: MHPE and MHRE of QuestSim table 1 and 2. With ``H`` alone all three are still
    compared, so that sensor sets are comparable.

    Args:
        position: ``(F, 16, 3)`` simulated link origins.
        quat: ``(F, 16, 4)`` simulated link orientations.
        reference: ``(F, 16, 3)`` link origins of the clip.
        reference_quat: ``(F, 16, 4)`` link orientations of the clip.
        height_m: stature in metres, which scales the devices' offsets.
    """
    at, turned = sensors.device_poses(position, quat, DEVICES, height_m)
    want_at, want_turned = sensors.device_poses(reference, reference_quat, DEVICES, height_m)
    apart = np.linalg.norm(at - want_at, axis=-1).mean(axis=-1) * _CM
    angle = np.degrees(rot.angle_between(turned, want_turned)).mean(axis=-1)
    return apart, angle


def foot_skate_cm_s(
    position: np.ndarray,
    quat: np.ndarray,
    contact: np.ndarray,
    soles: tuple[np.ndarray, float],
    fps: float,
) -> np.ndarray:
    """Slip in cm/s ``(K,)``: one sample for each foot and pair of frames in contact.

    The horizontal speed of the sole point that stays nearest to the floor from one frame to the
    next. A heel that rises over a planted ball is therefore not counted, though the ankle moves.

    Source: "skate" of SimPoE (Yuan et al., CVPR 2021) and PhysDiff (Yuan et al., ICCV 2023), the
    displacement of feet in contact with the ground in two adjacent frames, as a speed.

    Args:
        position: ``(F, 2, 3)`` origins of the feet.
        quat: ``(F, 2, 4)`` orientations of the feet.
        contact: ``(F, 2)`` bool, whether the foot is in contact with the floor.
        soles: centres ``(2, P, 3)`` in the feet's frames and radius of the sole spheres, in
            metres.
        fps: frames a second.
    """
    centres, radius = soles
    lowest = position[:, :, None] + rot.quat_rotate(quat[:, :, None], centres)
    lowest[..., 2] -= radius
    before = lowest[:-1]
    turn = rot.quat_multiply(quat[1:], rot.quat_conjugate(quat[:-1]))
    arm = before - position[:-1, :, None]
    after = position[1:, :, None] + rot.quat_rotate(turn[:, :, None], arm)
    height = np.maximum(before[..., 2], after[..., 2])
    nearest = height.argmin(axis=-1)[..., None, None]
    moved = np.take_along_axis(after - before, nearest, axis=2)[:, :, 0, :2]
    bearing = contact[1:] & contact[:-1]
    return np.linalg.norm(moved, axis=-1)[bearing] * fps * _CM


def penetration_cm(clearance: np.ndarray) -> np.ndarray:
    """Penetration of the deeper foot into the floor in cm ``(F,)``; zero above it.

    Source: "penetrate" of PhysDiff (Yuan et al., ICCV 2023), here of the feet alone and without
    its tolerance. A simulated stance foot penetrates slightly, because contacts are soft.

    Args:
        clearance: ``(F, 2)`` height in metres of the lowest point of each foot.
    """
    return np.maximum(0.0, -clearance.min(axis=-1)) * _CM
