"""Errors of estimated poses on the 22 joints, as defined in the papers that report them.

``F`` frames; positions ``(F, 22, 3)`` in metres in the world, rotations ``(F, 22, 4)`` quaternions
wxyz in the parent, as in ``Motion``. A function returns its samples, one a frame or fewer; means
are ``compare_poses``'s. The avatar's own metrics are ``metrics_terms``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from questsim import rotations as rot
from questsim.skeleton import JOINT_PARENTS, JOINTS

_CM = 100.0
ROOT, HEAD = JOINTS.index("root"), JOINTS.index("head")
HANDS: tuple[int, ...] = (JOINTS.index("left_wrist"), JOINTS.index("right_wrist"))
LOWER: tuple[int, ...] = tuple(
    i
    for i, name in enumerate(JOINTS)
    if name == "root" or name.endswith(("hip", "knee", "ankle", "toe"))
)
UPPER: tuple[int, ...] = tuple(i for i in range(len(JOINTS)) if i not in LOWER)
ENDS: tuple[int, ...] = (HEAD, *HANDS, JOINTS.index("left_toe"), JOINTS.index("right_toe"))
FEET: tuple[int, ...] = tuple(
    JOINTS.index(f"{side}_{part}") for side in ("left", "right") for part in ("ankle", "toe")
)

PLANTED_M_S = 0.1
"""A low foot joint slower than this is in stance."""
CONTACT_M = 0.02
"""A foot joint within this distance of its standing height is in contact with the floor."""
STANDING_PERCENTILE = 10.0


def aligned(position: np.ndarray, reference: np.ndarray, joint: int) -> np.ndarray:
    """Positions translated so that one joint coincides with the reference's in every frame."""
    return position + (reference[:, joint] - position[:, joint])[:, None]


def mpjre_components_deg(rotations: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """MPJRE of HMD-Poser and LGSIK-Poser in degrees ``(F,)``: mean absolute axis-angle component.

    The three components of 21 joints' rotation vectors are compared one by one, the root left out;
    a difference of more than half a turn is taken the other way round. It is smaller than the
    geodesic angle of ``rot_deg``.
    """
    shape = (*rotations.shape[:2], 3)
    got = rot.as_rotation(rotations).as_rotvec().reshape(shape)
    want = rot.as_rotation(reference).as_rotvec().reshape(shape)
    apart = (got - want + np.pi) % (2 * np.pi) - np.pi
    return np.degrees(np.abs(apart[:, 1:])).mean(axis=(1, 2))


def joints_cm(
    position: np.ndarray, reference: np.ndarray, joints: Sequence[int] | None = None
) -> np.ndarray:
    """Mean distance in cm ``(F,)`` of some joints, or all."""
    chosen = list(joints) if joints is not None else list(range(position.shape[1]))
    return np.linalg.norm((position - reference)[:, chosen], axis=-1).mean(axis=-1) * _CM


def velocity_cm_s(position: np.ndarray, reference: np.ndarray, fps: float) -> np.ndarray:
    """Mean distance in cm/s ``(F - 1,)`` of the joints' velocities, of adjacent frames."""
    error = np.diff(position - reference, axis=0) * fps
    return np.linalg.norm(error, axis=-1).mean(axis=-1) * _CM


def jitter_100_m_s3(position: np.ndarray, fps: float) -> np.ndarray:
    """Jitter in 10^2 m/s^3 ``(F - 3,)``: length of the third difference, mean over the joints.

    Source: TransPose (Yi et al., SIGGRAPH 2021), as all four papers report it.
    """
    jerk = np.diff(position, n=3, axis=0) * fps**3
    return np.linalg.norm(jerk, axis=-1).mean(axis=-1) / 100.0


def rot_deg(orientations: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Rot of SparsePoser and DragPoser in degrees ``(F,)``: the angle of ``R0 R1^T``.

    Args:
        orientations, reference: ``(F, 22, 4)`` of the joints in the world, see ``orientations_of``.

    Returns:
        mean over the 22 joints, the root included.
    """
    return np.degrees(rot.angle_between(orientations, reference)).mean(axis=-1)


def rot_local_deg(rotations: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Mean geodesic angle in degrees ``(F,)`` of 22 joints, each in its parent, with the root's.

    No paper reports it. An error of the spine counts once, not again for all joints above it.
    """
    return np.degrees(rot.angle_between(rotations, reference)).mean(axis=-1)


def orientations_of(rotations: np.ndarray) -> np.ndarray:
    """Orientations ``(F, 22, 4)`` in the world from rotations in the parent."""
    world = np.array(rotations, float)
    for joint, parent in enumerate(JOINT_PARENTS):
        if joint != parent:
            world[:, joint] = rot.quat_multiply(world[:, parent], world[:, joint])
    return world


def planted(reference: np.ndarray, fps: float) -> np.ndarray:
    """Whether the user's ankles and toes are planted between two frames, bool ``(F - 1, 4)``.

    A joint is planted while it is slower than 10 cm/s and within 2 cm of its standing height, the
    10th percentile of its heights.
    """
    feet = reference[:, FEET]
    moved = np.linalg.norm(np.diff(feet[..., :2], axis=0), axis=-1) * fps
    return _low(feet, reference) & (moved < PLANTED_M_S)


def foot_skate_cm_s(position: np.ndarray, reference: np.ndarray, fps: float) -> np.ndarray:
    """Horizontal speed in cm/s ``(K,)`` of ankles and toes that should be planted.

    Counted where the user's joint is ``planted`` and the estimate's is within 2 cm of its standing
    height. Height alone is not enough: a swinging toe comes as near to the floor, and the
    recordings themselves would skate by 10 cm/s. One sample per joint and pair of frames; see
    ``metrics_terms`` for the sources of the measure.
    """
    feet = position[:, FEET]
    moved = np.linalg.norm(np.diff(feet[..., :2], axis=0), axis=-1) * fps * _CM
    return moved[planted(reference, fps) & _low(feet, reference)]


def floating_cm(position: np.ndarray, reference: np.ndarray, fps: float) -> np.ndarray:
    """Height in cm ``(K,)`` of ankles and toes above standing where the user's are ``planted``."""
    raised = position[1:, FEET, 2] - standing_heights(reference)
    return np.maximum(raised, 0.0)[planted(reference, fps)] * _CM


def _low(feet: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Which feet ``(F, 4, 3)`` are near standing height, in both of two frames ``(F - 1, 4)``."""
    low = feet[..., 2] - standing_heights(reference) < CONTACT_M
    return low[1:] & low[:-1]


def floor_penetration_cm(position: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Depth of the deepest ankle or toe below its standing height, in cm ``(F,)``."""
    depth = standing_heights(reference) - position[:, FEET, 2]
    return np.maximum(depth.max(axis=-1), 0.0) * _CM


def standing_heights(reference: np.ndarray) -> np.ndarray:
    """Standing height in metres ``(4,)`` of ankles and toes, estimated from a recording."""
    return np.percentile(reference[:, FEET, 2], STANDING_PERCENTILE, axis=0)


def pose_samples(
    position: np.ndarray,
    rotations: np.ndarray,
    reference: np.ndarray,
    reference_rotations: np.ndarray,
    fps: float,
    ends: Sequence[int] = ENDS,
) -> dict[str, np.ndarray]:
    """All errors of one clip by name: samples as the functions above give them.

    ``joint_cm`` is ``mpjpe`` by joint, ``(F, 22)``.

    ``mpjre``, ``mpjpe``, ``mpjve``, ``h_pe``, ``u_pe``, ``l_pe``, ``r_pe``: heads moved onto each
    other (HMD-Poser and LGSIK-Poser; Jiang et al., AvatarPoser, ECCV 2022). ``pos``, ``vel``,
    ``ee``: roots moved onto each other, ``rot``: of orientations, ``root``: the root alone, nothing
    moved (SparsePoser and DragPoser). ``rot_local`` and ``world`` (nothing moved): of none of them.

    Args:
        position, rotations: estimated.
        reference, reference_rotations: of the user.
        fps: frames a second of both.
        ends: joints of ``ee``: those that carry a device. DragPoser apparently uses the same: with
            four trackers, none on the feet, it reports the same error as with six.
    """
    by_head = aligned(position, reference, HEAD)
    by_root = aligned(position, reference, ROOT)
    return {
        "mpjre_deg": mpjre_components_deg(rotations, reference_rotations),
        "mpjpe_cm": joints_cm(by_head, reference),
        "mpjve_cm_s": velocity_cm_s(by_head, reference, fps),
        "jitter_100_m_s3": jitter_100_m_s3(position, fps),
        "h_pe_cm": joints_cm(by_head, reference, HANDS),
        "u_pe_cm": joints_cm(by_head, reference, UPPER),
        "l_pe_cm": joints_cm(by_head, reference, LOWER),
        "r_pe_cm": joints_cm(by_head, reference, (ROOT,)),
        "pos_cm": joints_cm(by_root, reference),
        "rot_deg": rot_deg(orientations_of(rotations), orientations_of(reference_rotations)),
        "rot_local_deg": rot_local_deg(rotations, reference_rotations),
        "root_cm": joints_cm(position, reference, (ROOT,)),
        "vel_cm_s": velocity_cm_s(by_root, reference, fps),
        "ee_cm": joints_cm(by_root, reference, ends),
        "joint_cm": 100.0 * np.linalg.norm(by_head - reference, axis=-1),
        "world_cm": joints_cm(position, reference),
        "foot_skate_cm_s": foot_skate_cm_s(position, reference, fps),
        "floating_cm": floating_cm(position, reference, fps),
        "penetration_cm": floor_penetration_cm(position, reference),
    }
