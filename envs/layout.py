"""Layout of an observation: slices of QuestSim's 475 numbers by name."""

from __future__ import annotations

import numpy as np

from envs.avatar import avatar_of
from envs.config import EnvConfig, offsets_of
from questsim.body_proportions import PARTS
from questsim.sensors import sensor_set
from questsim.skeleton import FEET

POSE_SIZE = 9
"""A device's position and the first two columns of its rotation matrix."""
_SCAN_FORWARD_M = np.linspace(-0.5, 1.0, 11)
_SCAN_LEFT_M = np.linspace(-0.45, 0.45, 7)
SCAN_POINTS = np.stack(np.meshgrid(_SCAN_FORWARD_M, _SCAN_LEFT_M, indexing="ij"), -1).reshape(-1, 2)
"""Points of the height scan, ``(77, 2)`` in S in metres: 15 cm apart, row by row from behind."""


def observation_layout(config: EnvConfig) -> dict[str, slice]:
    """Slices of an observation by name; ``"o_sim"``, ``"o_user"``, ``"o_scale"`` hold the rest.

    Everything is in the frame S: on the floor below the root, turned with its heading (QuestSim
    section 3). ``o_sim`` has 312 numbers, ``o_user`` frames x devices x (position 3, orientation
    6), ``o_scale`` is the height; with ``observe_proportions``, five multiples follow it: the
    ``PARTS`` of ``questsim.body_proportions``.

    ``"privileged"`` follows if the config asks for it. Its first block contains
    ``"reference_joint_angles"``, the 33 angles of the next frame. It ends with three parts:
    ``"midway_joint_angles"``, 33 angles halfway between this frame and the next;
    ``"reference_torques"``, the inverse-dynamics torques between the two, as actions; and
    ``"tracking_errors"``, for each link the present reference minus avatar: position, orientation
    (2 sin(angle / 2) times the axis), velocity and angular velocity.

    ``"height_scan"``, if the config asks for it, is the height of the ground at ``SCAN_POINTS``.

    ``"o_teacher"``, with ``teacher_devices``, is ``o_user`` of those devices without errors.

    The numbers are those of our avatar; another body has its own hinges and links.
    """
    avatar = avatar_of(config.body)
    dofs, links = len(avatar.dofs), len(avatar.links)
    layout: dict[str, slice] = {}
    at = 0
    for name, size in (
        ("joint_angles", dofs),
        ("joint_velocities", dofs),
        ("link_positions", 3 * links),
        ("link_orientations", 6 * links),
        ("link_linear_velocities", 3 * links),
        ("link_angular_velocities", 3 * links),
        ("contact_forces", 3 * len(FEET)),
    ):
        layout[name] = slice(at, at + size)
        at += size
    layout["o_sim"] = slice(0, at)
    user = _user_size(config.sensors, config.future_frames)
    layout["o_user"] = slice(at, at + user)
    at += user
    scale = 1 + (len(PARTS) if config.observe_proportions else 0)
    layout["o_scale"] = slice(at, at + scale)
    at += scale
    if config.privileged:
        frames = len(config.privileged_frames) * (2 * dofs + 9 * links)
        layout["privileged"] = slice(at, at + frames + 2 * dofs + 12 * links)
        layout["reference_joint_angles"] = slice(at, at + dofs)
        at += frames
        layout["midway_joint_angles"] = slice(at, at + dofs)
        layout["reference_torques"] = slice(at + dofs, at + 2 * dofs)
        at += 2 * dofs
        layout["tracking_errors"] = slice(at, at + 12 * links)
        at += 12 * links
    if config.height_scan:
        layout["height_scan"] = slice(at, at + len(SCAN_POINTS))
        at += len(SCAN_POINTS)
    if config.teacher_devices is not None:
        layout["o_teacher"] = slice(at, at + _user_size(*config.teacher_devices))
    return layout


def _user_size(sensors: str, future_frames: int) -> int:
    return len(offsets_of(future_frames)) * len(sensor_set(sensors)) * POSE_SIZE


def observation_size(layout: dict[str, slice]) -> int:
    """Length of an observation of that layout."""
    return max(part.stop for part in layout.values())
