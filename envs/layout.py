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
    layout = _consecutive(
        0,
        joint_angles=dofs,
        joint_velocities=dofs,
        link_positions=3 * links,
        link_orientations=6 * links,
        link_linear_velocities=3 * links,
        link_angular_velocities=3 * links,
        contact_forces=3 * len(FEET),
    )
    layout["o_sim"] = slice(0, observation_size(layout))
    layout |= _consecutive(
        observation_size(layout),
        o_user=_user_size(config.sensors, config.future_frames),
        o_scale=1 + (len(PARTS) if config.observe_proportions else 0),
    )
    if config.privileged:
        layout |= _privileged(observation_size(layout), len(config.privileged_frames), dofs, links)
    if config.height_scan:
        layout |= _consecutive(observation_size(layout), height_scan=len(SCAN_POINTS))
    if config.teacher_devices is not None:
        user = _user_size(*config.teacher_devices)
        layout |= _consecutive(observation_size(layout), o_teacher=user)
    return layout


def _consecutive(at: int, **sizes: int) -> dict[str, slice]:
    """Blocks of these sizes, one after another from ``at``."""
    ends = at + np.cumsum(list(sizes.values()))
    return {
        name: slice(int(end) - size, int(end))
        for (name, size), end in zip(sizes.items(), ends, strict=True)
    }


def _privileged(at: int, frames: int, dofs: int, links: int) -> dict[str, slice]:
    """The block ``"privileged"`` from ``at``, and its parts."""
    reference = frames * (2 * dofs + 9 * links)
    parts = _consecutive(
        at + reference,
        midway_joint_angles=dofs,
        reference_torques=dofs,
        tracking_errors=12 * links,
    )
    whole = slice(at, observation_size(parts))
    return {"privileged": whole, "reference_joint_angles": slice(at, at + dofs)} | parts


def _user_size(sensors: str, future_frames: int) -> int:
    return len(offsets_of(future_frames)) * len(sensor_set(sensors)) * POSE_SIZE


def observation_size(layout: dict[str, slice]) -> int:
    """Length of an observation of that layout."""
    return max(part.stop for part in layout.values())
