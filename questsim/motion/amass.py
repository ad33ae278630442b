"""AMASS files: SMPL poses (``poses``, ``trans``, ``betas``, ``mocap_framerate``) as .npz.

The poses need a skeleton. A SMPL model file gives the subject's own. Without one, a skeleton of
published body proportions is scaled to the subject's stature.

Source: Mahmood et al., "AMASS: Archive of Motion Capture as Surface Shapes", ICCV 2019; Loper et
al., "SMPL: A Skinned Multi-Person Linear Model", SIGGRAPH Asia 2015 (joints and pose vector).
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from questsim import rotations as rot
from questsim.errors import InputError
from questsim.motion.convert import global_pose
from questsim.motion.npz import open_npz
from questsim.motion.recording import AGAIN, MAX_LENGTH, Recording, check_rate, read_bytes

NUM_BODY_JOINTS = 22
SMPL_NAMES: tuple[str, ...] = (
    "Pelvis", "L_Hip", "R_Hip", "Spine1", "L_Knee", "R_Knee", "Spine2", "L_Ankle", "R_Ankle",
    "Spine3", "L_Foot", "R_Foot", "Neck", "L_Collar", "R_Collar", "Head", "L_Shoulder",
    "R_Shoulder", "L_Elbow", "R_Elbow", "L_Wrist", "R_Wrist",
)  # fmt: skip
"""The first 22 joints of SMPL, SMPL-H and SMPL-X, in the order of the pose vector."""

SMPL_PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)

# Left, up, forward of each joint from its parent as fractions of stature, for the left side
# and the trunk. Heights and lengths of thigh, shin, arm, forearm, foot, shoulders and head base
# are those of Drillis and Contini 1966 (Winter 2009, figure 4.1): hip 0.530, knee 0.285, ankle
# 0.039, shoulder 0.818, head base 0.870, half shoulder breadth 0.129, upper arm 0.186, forearm
# 0.146, foot 0.152 of which the ball lies half in front of the ankle; hip centres half of the
# hip breadth 0.191 apart. How the spine's 0.288 is shared out among its joints is our choice.
_MEAN = {
    "Pelvis": (0.0, 0.0, 0.0),
    "L_Hip": (0.048, -0.025, 0.0),
    "L_Knee": (0.0, -0.245, 0.0),
    "L_Ankle": (0.0, -0.246, 0.0),
    "L_Foot": (0.0, -0.030, 0.076),
    "Spine1": (0.0, 0.062, 0.0),
    "Spine2": (0.0, 0.076, 0.0),
    "Spine3": (0.0, 0.035, 0.0),
    "Neck": (0.0, 0.090, 0.0),
    "Head": (0.0, 0.052, 0.0),
    "L_Collar": (0.040, 0.060, 0.0),
    "L_Shoulder": (0.089, 0.030, 0.0),
    "L_Elbow": (0.186, 0.0, 0.0),
    "L_Wrist": (0.146, 0.0, 0.0),
}
SOLE_BELOW_FOOT_JOINT = 0.009
DEFAULT_STATURE_M = 1.70
FRAME_RATE_KEYS = (
    "mocap_framerate", "mocap_frame_rate", "framerate", "frame_rate", "mocap_fps", "fps"
)  # fmt: skip
SMPL_KEYS = ("J_regressor", "v_template", "shapedirs")
"""The arrays that are read from a SMPL model."""
MAX_ARRAY_BYTES = 256 << 20
"""Larger arrays are rejected; AMASS's longest files need a third of 256 MiB."""
MAX_REACH_M = 10.0
"""A SMPL model with joints further from its origin is damaged, or the betas are."""
PLAUSIBLE_STATURE_M = (1.40, 2.10)


def read_amass(
    path: str | Path,
    *,
    height_m: float | None = None,
    smpl_file: str | Path | None = None,
    fps: float | None = None,
) -> Recording:
    """Reads one AMASS file (SMPL, SMPL-H or SMPL-X; hands and face are left out).

    The poses are ``poses``, or ``root_orient`` and ``pose_body``.

    Args:
        path: the .npz file.
        height_m: the subject's stature, which scales the mean skeleton; by default the one that
            puts the soles on the floor at z = 0, or 1.70 m where that is implausible.
        smpl_file: a SMPL model as .npz (``J_regressor``, ``v_template``, ``shapedirs``): its
            joints with the file's ``betas`` are used instead of the mean skeleton.
        fps: the true frame rate; by default that of the file.

    Returns:
        The recording on SMPL's joints, in metres, z up; ``families.SMPL`` knows it.

    Raises:
        InputError: the file is missing, not an .npz, lacks a key, or has a wrong shape or NaN.
    """
    path = Path(path)
    data = read_bytes(path)
    arrays = _load_arrays(path)
    poses, trans = _poses(arrays, path), arrays["trans"]
    _check_frames(poses, trans, path)
    rotvec = poses[:, : 3 * NUM_BODY_JOINTS].reshape(-1, 3)
    rotations = rot.as_quat(Rotation.from_rotvec(rotvec), (len(poses), NUM_BODY_JOINTS))
    offsets = mean_offsets() if smpl_file is None else _smpl_offsets(smpl_file, arrays)
    positions = np.tile(offsets, (len(poses), 1, 1))
    positions[:, 0] = trans
    recording = Recording(
        path=path,
        names=SMPL_NAMES,
        parents=np.array(SMPL_PARENTS),
        positions=positions,
        rotations=rotations,
        fps=fps or _frame_rate(arrays, path),
        sha256=hashlib.sha256(data).hexdigest(),
    )
    if smpl_file is None:
        positions[:, 1:] *= height_m or estimate_stature(recording)
    return recording


def _check_frames(poses: np.ndarray, trans: np.ndarray, path: Path) -> None:
    if trans.shape != (len(poses), 3):
        raise InputError(f"trans has shape {trans.shape}, not {(len(poses), 3)}", path)
    if not len(poses):
        raise InputError("motion has no frames", path)
    for name, array in (("poses", poses), ("trans", trans)):
        bad = np.flatnonzero(~(abs(array) <= MAX_LENGTH).all(axis=1))
        if len(bad):
            raise InputError(f"{name} is not finite in frame {bad[0]}", path, AGAIN)


def _poses(arrays: dict[str, np.ndarray], path: Path) -> np.ndarray:
    """Rotation vectors of the root and the body's joints ``(T, 66 or more)``."""
    if "poses" in arrays:
        poses, name = arrays["poses"], "poses"
    else:
        root, body = arrays["root_orient"], arrays["pose_body"]
        if root.ndim != 2 or body.ndim != 2 or root.shape[1] != 3 or len(root) != len(body):
            shapes = f"root_orient has shape {root.shape}, pose_body {body.shape}"
            raise InputError(f"{shapes}, not (T, 3) and (T, 63)", path)
        poses, name = np.concatenate([root, body], axis=1), "root_orient and pose_body"
    if poses.ndim != 2 or poses.shape[1] < 3 * NUM_BODY_JOINTS or poses.shape[1] % 3:
        raise InputError(f"{name} has shape {poses.shape}, not (T, 72), (T, 156), (T, 165)", path)
    return poses


def mean_offsets() -> np.ndarray:
    """Offsets ``(22, 3)`` of the mean skeleton 1 m tall, SMPL's axes: x left, y up, z forward."""
    rows = []
    for name in SMPL_NAMES:
        x, y, z = _MEAN[name.replace("R_", "L_")]
        rows.append((-x if name.startswith("R_") else x, y, z))
    return np.array(rows)


def estimate_stature(recording: Recording) -> float:
    """Metres: the scale at which the lower foot of a skeleton 1 m tall reaches the floor."""
    position, _ = global_pose(recording)
    lowest = position[..., 2].min(axis=1) - SOLE_BELOW_FOOT_JOINT
    root = position[:, 0, 2]
    height = float(np.median(root / np.maximum(root - lowest, 1e-6)))
    low, high = PLAUSIBLE_STATURE_M
    return height if low <= height <= high else DEFAULT_STATURE_M


def _load_arrays(path: Path) -> dict[str, np.ndarray]:
    """The required arrays of the file, as floats."""
    with open_npz(path, MAX_ARRAY_BYTES) as archive:
        if "poses" not in archive.files:
            lacking = [key for key in ("root_orient", "pose_body") if key not in archive.files]
            if lacking:
                what = "has neither an array 'poses' nor 'root_orient' and 'pose_body'"
                raise InputError(what, path, "give an AMASS file")
        if "trans" not in archive.files:
            raise InputError("has no array 'trans'", path, "give an AMASS file")
        wanted = ("poses", "root_orient", "pose_body", "trans", "betas", *FRAME_RATE_KEYS)
        arrays = {key: archive[key] for key in wanted if key in archive.files}
    for key, array in arrays.items():
        if array.dtype.kind not in "biuf":
            raise InputError(f"{key} holds {array.dtype}, not numbers", path, "give an AMASS file")
    return {key: np.asarray(array, float) for key, array in arrays.items()}


def _frame_rate(arrays: dict[str, np.ndarray], path: Path) -> float:
    for key in FRAME_RATE_KEYS:
        if key in arrays and arrays[key].size:
            fps = float(arrays[key].reshape(-1)[0])
            return check_rate(fps, f"{key} = {fps:g}", path)
    raise InputError(
        f"does not say its frame rate (none of {', '.join(FRAME_RATE_KEYS)})",
        path,
        "declare it with --fps",
    )


def _smpl_offsets(smpl_file: str | Path, arrays: dict[str, np.ndarray]) -> np.ndarray:
    """Joint offsets ``(22, 3)`` in metres of the SMPL model with the file's betas."""
    path = Path(smpl_file)
    with open_npz(path, MAX_ARRAY_BYTES, "a SMPL model") as model:
        regressor, vertices, directions = (model[key] for key in SMPL_KEYS)
    shapes = (regressor.shape, vertices.shape, directions.shape)
    count = vertices.shape[0] if vertices.ndim == 2 else -1
    if (
        vertices.shape != (count, 3)
        or regressor.shape[1:] != (count,)
        or len(regressor) < NUM_BODY_JOINTS
        or directions.ndim != 3
        or directions.shape[:2] != (count, 3)
        or any(array.dtype.kind not in "iuf" for array in (regressor, vertices, directions))
    ):
        raise InputError(f"arrays of shapes {shapes} are not those of a SMPL model", path)
    for key, array in zip(SMPL_KEYS, (regressor, vertices, directions), strict=True):
        if not (abs(np.asarray(array, float)) <= MAX_LENGTH).all():
            raise InputError(f"{key} is not finite", path, AGAIN)
    betas = arrays.get("betas", np.zeros(0)).reshape(-1)[: directions.shape[-1]]
    with np.errstate(all="ignore"):
        shaped = vertices + directions[..., : len(betas)] @ betas
        joints = (regressor @ shaped)[:NUM_BODY_JOINTS]
    parents = np.array(SMPL_PARENTS)
    if not (abs(joints) <= MAX_REACH_M).all():
        what = f"joints are further than {MAX_REACH_M:g} m from the origin"
        raise InputError(what, path, "give a SMPL model, and a file with its betas")
    return np.where(parents[:, None] < 0, 0.0, joints - joints[parents])
