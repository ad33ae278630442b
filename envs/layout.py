"""Where each part of an observation lies: QuestSim's 475 numbers by name."""

from __future__ import annotations

import numpy as np

from envs.config import EnvConfig
from questsim.sensors import sensor_set
from questsim.skeleton import FEET, NUM_DOFS, NUM_LINKS

POSE_SIZE = 9
"""A device's position and the first two columns of its rotation matrix."""
_SCAN_FORWARD_M = np.linspace(-0.5, 1.0, 11)
_SCAN_LEFT_M = np.linspace(-0.45, 0.45, 7)
SCAN_POINTS = np.stack(np.meshgrid(_SCAN_FORWARD_M, _SCAN_LEFT_M, indexing="ij"), -1).reshape(-1, 2)
"""Where the height scan looks, ``(77, 2)`` in S in metres: 15 cm apart, row by row from behind."""


def observation_layout(config: EnvConfig) -> dict[str, slice]:
    """Slices of an observation by name; ``"o_sim"``, ``"o_user"``, ``"o_scale"`` hold the rest.

    All in the frame S: on the floor below the root, turned with its heading (QuestSim section
    3). ``o_sim`` is 312 numbers, ``o_user`` frames x devices x (position 3, orientation 6),
    ``o_scale`` the height. ``"privileged"``, if the config asks for it, follows; of its first
    block ``"reference_joint_angles"`` is the next frame's 33 angles. ``"height_scan"``, likewise,
    is the height of the ground at ``SCAN_POINTS``.
    """
    layout: dict[str, slice] = {}
    at = 0
    for name, size in (
        ("joint_angles", NUM_DOFS),
        ("joint_velocities", NUM_DOFS),
        ("link_positions", 3 * NUM_LINKS),
        ("link_orientations", 6 * NUM_LINKS),
        ("link_linear_velocities", 3 * NUM_LINKS),
        ("link_angular_velocities", 3 * NUM_LINKS),
        ("contact_forces", 3 * len(FEET)),
    ):
        layout[name] = slice(at, at + size)
        at += size
    layout["o_sim"] = slice(0, at)
    user = len(config.frame_offsets) * len(sensor_set(config.sensors)) * POSE_SIZE
    layout["o_user"] = slice(at, at + user)
    at += user
    layout["o_scale"] = slice(at, at + 1)
    at += 1
    if config.privileged:
        size = len(config.privileged_frames) * (2 * NUM_DOFS + 9 * NUM_LINKS)
        layout["privileged"] = slice(at, at + size)
        layout["reference_joint_angles"] = slice(at, at + NUM_DOFS)
        at += size
    if config.height_scan:
        layout["height_scan"] = slice(at, at + len(SCAN_POINTS))
    return layout


def observation_size(layout: dict[str, slice]) -> int:
    """Length of an observation of that layout."""
    return max(part.stop for part in layout.values())
