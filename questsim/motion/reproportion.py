"""Moves a clip to a body of other proportions."""

from __future__ import annotations

import numpy as np

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M
from questsim.body_proportions import Proportions
from questsim.motion.clip import Clip
from questsim.motion.kinematics import clip_from_qpos, sole_points
from questsim.motion.library import ABOUT
from questsim.motion.limbs import leg_m
from questsim.motion.retarget import solve_legs
from questsim.motion.retarget_back import joint_orientations
from questsim.motion.stance import lowest_point
from questsim.skeleton import FOOT_LINKS


def with_proportions(clip: Clip, proportions: Proportions | None) -> Clip:
    """The same motion on a body of the same nominal height and other proportions.

    Trunk, head and arms keep their joint angles. The path of the root and those of the soles
    scale with the legs, which reach them by inverse kinematics, so that feet on the floor stay
    there and resting feet rest.

    Args:
        clip: on a body of any proportions.
        proportions: of the other body; None for the default body's.
    """
    if proportions == clip.proportions:
        return clip
    height = clip.height_m
    ratio = leg_m(height, proportions) / leg_m(height, clip.proportions)
    sole_m = -float(sole_points()[..., 2].mean()) * height / DEFAULT_HEIGHT_M
    quat = joint_orientations(clip)
    root = clip.qpos[:, :3] * ratio
    root[:, 2] += (1.0 - ratio) * sole_m
    feet = clip.link_quat[:, list(FOOT_LINKS)]
    up = rot.quat_rotate(feet, np.array([0.0, 0.0, 1.0]))
    ankles = (clip.link_position[:, list(FOOT_LINKS)] - sole_m * up) * ratio + sole_m * up
    lowest = lowest_point(ankles, feet, height)
    ankles[..., 2] += np.maximum(0.0, -lowest)
    qpos = solve_legs(
        root, quat, ankles, feet, np.minimum(lowest, 0.0), clip.contacts.astype(float), height,
        clip.qpos[:, 7:].copy(), proportions,
    )  # fmt: skip
    about = {name: getattr(clip, name) for name in (*ABOUT, "weight")}
    return clip_from_qpos(clip.name, qpos, height, proportions, **about)
