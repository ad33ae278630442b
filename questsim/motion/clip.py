"""A motion of the avatar: the reference that the simulation follows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from questsim.body_proportions import Proportions

FPS = 36.0
"""Frames a second of every clip and of the policy (QuestSim section 4)."""


def source_kind(kind: str) -> str:
    """The kind of motion that a variation varies: ``walk`` of ``walk+crouch+reach``.

    Samplers that draw by kind count variations with it. With a kind for every combination of
    changes, a quarter of variations among the clips would be more than half of the samples.
    """
    return kind.partition("+")[0]


@dataclass(frozen=True)
class Clip:
    """The avatar's reference motion at 36 Hz, z up, feet on the floor at z = 0.

    Link velocities are those of the link origins, in the world. ``T`` frames, 16 links in the
    order of ``skeleton.LINKS``, 33 hinges in the order of ``skeleton.DOFS``.

    Attributes:
        name: the clip's name; unique in a library.
        height_m: the stature in metres of the body the numbers below are for.
        qpos: ``(T, 40)`` root position (m), root quaternion wxyz, joint angles (rad).
        qvel: ``(T, 39)`` root linear velocity in the world (m/s), root angular velocity in the
            root's frame (rad/s), joint velocities (rad/s): MuJoCo's convention.
        link_position: ``(T, 16, 3)`` in metres.
        link_quat: ``(T, 16, 4)`` orientations, quaternions wxyz.
        link_velocity: ``(T, 16, 3)`` in m/s.
        link_angular_velocity: ``(T, 16, 3)`` in rad/s.
        contacts: ``(T, 2)`` bool, whether the left and the right foot bear on the floor.
        source, source_sha256, licence, kind, style, weight: as in ``Motion``.
        proportions: of the body that the numbers are for; None for the default body's.
    """

    name: str
    height_m: float
    qpos: np.ndarray
    qvel: np.ndarray
    link_position: np.ndarray
    link_quat: np.ndarray
    link_velocity: np.ndarray
    link_angular_velocity: np.ndarray
    contacts: np.ndarray
    source: str = ""
    source_sha256: str = ""
    licence: str = ""
    kind: str = ""
    style: str = ""
    proportions: Proportions | None = None
    weight: float = 1.0

    def __len__(self) -> int:
        return len(self.qpos)

    @property
    def duration(self) -> float:
        """Seconds from the first to the last frame."""
        return (len(self) - 1) / FPS

    def first(self, frames: int) -> Clip:
        """The first frames of the clip; itself if it has no more."""
        return self if frames >= len(self) else self._part(slice(frames))

    def after(self, frames: int) -> Clip:
        """The clip without its first frames; at least one is left."""
        return self._part(slice(min(frames, len(self) - 1), None))

    def _part(self, part: slice) -> Clip:
        return replace(
            self,
            qpos=self.qpos[part],
            qvel=self.qvel[part],
            link_position=self.link_position[part],
            link_quat=self.link_quat[part],
            link_velocity=self.link_velocity[part],
            link_angular_velocity=self.link_angular_velocity[part],
            contacts=self.contacts[part],
        )

    def scaled(self, height_m: float) -> Clip:
        """The same joint angles on a body of another height; paths scale with the body."""
        ratio = height_m / self.height_m
        qpos, qvel = self.qpos.copy(), self.qvel.copy()
        qpos[:, :3] *= ratio
        qvel[:, :3] *= ratio
        return replace(
            self,
            height_m=height_m,
            qpos=qpos,
            qvel=qvel,
            link_position=self.link_position * ratio,
            link_velocity=self.link_velocity * ratio,
        )
