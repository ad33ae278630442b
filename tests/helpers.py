"""Small clips for tests, made in milliseconds, and the six numbers of an orientation."""

from __future__ import annotations

import numpy as np

from questsim import rotations as rot
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import clip_from_qpos
from questsim.skeleton import DOFS, NUM_DOFS


def swaying_clip(
    name: str = "sway", height_m: float = 1.75, frames: int = 72, kind: str = "stand"
) -> Clip:
    """Standing with bent knees, arms and trunk moving a little; nearly in balance."""
    time = np.arange(frames) / FPS
    angles = np.zeros((frames, NUM_DOFS))

    def set_angle(dof: str, values: np.ndarray | float) -> None:
        angles[:, DOFS.index(dof)] = values

    for side, sign in (("left", 1.0), ("right", -1.0)):
        set_angle(f"{side}_hip_y", -0.15)
        set_angle(f"{side}_knee_y", 0.3)
        set_angle(f"{side}_ankle_y", -0.15)
        set_angle(f"{side}_shoulder_x", sign * (0.5 + 0.3 * np.sin(3.0 * time)))
        set_angle(f"{side}_shoulder_z", 0.2 * sign)
        set_angle(f"{side}_elbow_y", -0.6 + 0.3 * np.sin(2.0 * time + sign))
        set_angle(f"{side}_wrist_z", 0.2 * np.sin(time))
    set_angle("neck_z", 0.3 * np.sin(2.0 * time))
    set_angle("chest_z", 0.1 * np.sin(1.5 * time))
    root = np.zeros((frames, 7))
    scale = height_m / 1.75
    knee_drop = 0.42875 * (1 - np.cos(0.15)) + 0.4305 * (1 - np.cos(0.15))
    root[:, 2] = (0.9275 - knee_drop) * scale
    root[:, 3] = 1.0
    return clip_from_qpos(
        name, np.concatenate([root, angles], axis=-1), height_m, kind=kind, licence="MIT"
    )


def two_columns(quat: np.ndarray) -> np.ndarray:
    """First two columns of the rotation matrix, column after column ``(..., 6)``."""
    matrix = rot.quat_to_matrix(quat)
    return np.concatenate([matrix[..., :, 0], matrix[..., :, 1]], axis=-1)
