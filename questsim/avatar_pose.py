"""One frame of the avatar: output of a live follower, input of the exports."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class AvatarPose:
    """One frame of the avatar, in our convention and in the space of the user's devices.

    Attributes:
        time_s: time of the pose on the devices' clock; the follower's ``latency_s`` before the
            newest device frame.
        height_m: the avatar's stature.
        root_position: ``(3,)`` position of the pelvis in metres.
        root_quat: ``(4,)`` wxyz.
        joint_angles: ``(33,)`` rad, in the order of ``skeleton.DOFS``.
        link_position: ``(16, 3)`` link origins in metres, in the order of ``skeleton.LINKS``.
        link_quat: ``(16, 4)`` link orientations wxyz.
        contact_force: ``(2, 3)`` force in N of the ground on the left and the right foot; zero
            without physics.
        assist_force: ``(3,)`` force in N on the root from the assist; zero while it is not used.
        assist_torque: ``(3,)`` torque in N m on the root from the assist, likewise.
        object_position: ``(K, 3)`` positions of the session's objects in metres.
        object_quat: ``(K, 4)`` their orientations.
        events: texts of events since the previous pose; usually empty.
    """

    time_s: float
    height_m: float
    root_position: np.ndarray
    root_quat: np.ndarray
    joint_angles: np.ndarray
    link_position: np.ndarray
    link_quat: np.ndarray
    contact_force: np.ndarray
    assist_force: np.ndarray
    assist_torque: np.ndarray
    events: tuple[str, ...] = ()
    object_position: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    object_quat: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))

    @property
    def qpos(self) -> np.ndarray:
        """``(40,)`` root position, root quaternion and joint angles: MuJoCo's pose."""
        return np.concatenate([self.root_position, self.root_quat, self.joint_angles])
