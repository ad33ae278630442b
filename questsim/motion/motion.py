"""A recorded motion on the 22-joint skeleton, before it is retargeted to the avatar."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from questsim import rotations as rot
from questsim.errors import InputError
from questsim.skeleton import JOINT_PARENTS, JOINTS, MIRROR_JOINTS, NUM_JOINTS, generations


@dataclass(frozen=True)
class Motion:
    """Joint rotations and a root path of one person, in metres, z up.

    With every rotation the identity, the person stands in a T-pose: facing +x, left arm
    along +y, palms down, toes forward.

    Attributes:
        name: the clip's name, e.g. ``"dataset-2_walk_normal_001"``.
        fps: frames a second of the recording.
        root_position: ``(T, 3)`` world position of the root joint in metres.
        rotations: ``(T, 22, 4)`` unit quaternions wxyz; of the root in the world, of every
            other joint in its parent.
        offsets: ``(22, 3)`` each joint's position in its parent's frame in metres; the root's
            is zero.
        source: the file the motion came from, or how it was made.
        source_sha256: hexadecimal SHA-256 of that file; empty where there is none.
        licence: SPDX identifier or name of the data's licence; empty if unknown.
        kind: the kind of motion (``"walk"``, ``"run"``, ...); empty if unknown.
        style: the performer's style (``"normal"``, ``"elderly"``, ...); empty if unknown.
        weight: how often a training draws it, as a multiple; from a mixture file, and not stored
            in libraries.
    """

    name: str
    fps: float
    root_position: np.ndarray
    rotations: np.ndarray
    offsets: np.ndarray
    source: str = ""
    source_sha256: str = ""
    licence: str = ""
    kind: str = ""
    style: str = ""
    weight: float = 1.0

    def __post_init__(self) -> None:
        frames = len(self.root_position)
        for field, shape in (
            ("root_position", (frames, 3)),
            ("rotations", (frames, NUM_JOINTS, 4)),
            ("offsets", (NUM_JOINTS, 3)),
        ):
            array = getattr(self, field)
            if array.shape != shape:
                raise InputError(f"{field} has shape {array.shape}, not {shape}", self.name)
            if not np.isfinite(array).all():
                frame = np.argwhere(~np.isfinite(array))[0][0]
                raise InputError(f"{field} is not finite at index {frame}", self.name)
        if frames == 0:
            raise InputError("motion has no frames", self.name)
        if not self.fps > 0:
            raise InputError(f"frame rate is {self.fps}, not above zero", self.name)

    def __len__(self) -> int:
        return len(self.root_position)

    @property
    def duration(self) -> float:
        """Seconds from the first to the last frame."""
        return (len(self) - 1) / self.fps

    def forward_kinematics(self) -> tuple[np.ndarray, np.ndarray]:
        """World positions ``(T, 22, 3)`` in metres and orientations ``(T, 22, 4)``."""
        return joint_kinematics(self.root_position, self.rotations, self.offsets)

    def resampled(self, fps: float) -> Motion:
        """The same motion at another frame rate: linear positions, slerped rotations."""
        if fps == self.fps or len(self) < 2:
            return replace(self, fps=fps)
        times = np.arange(len(self)) / self.fps
        frames = int(np.floor(times[-1] * fps + 1e-9)) + 1
        new_times = np.minimum(np.arange(frames) / fps, times[-1])
        root = rot.resample_points(self.root_position, times, new_times)
        rotations = rot.resample_quat(self.rotations, times, new_times)
        return replace(self, fps=fps, root_position=root, rotations=rotations)

    def mirrored(self) -> Motion:
        """The motion seen in a mirror at the x-z plane; the name gains ``"-mirrored"``."""
        reflect_vector = np.array([1.0, -1.0, 1.0])
        reflect_quat = np.array([1.0, -1.0, 1.0, -1.0])
        return replace(
            self,
            name=f"{self.name}-mirrored",
            root_position=self.root_position * reflect_vector,
            rotations=self.rotations[:, MIRROR_JOINTS] * reflect_quat,
            offsets=self.offsets[MIRROR_JOINTS] * reflect_vector,
        )


def rest_height(offsets: np.ndarray) -> float:
    """Metres from the ankles up to the head joint in the T-pose, of offsets ``(22, 3)``."""

    def z(name: str) -> float:
        joint, height = JOINTS.index(name), 0.0
        while joint:
            height += offsets[joint, 2]
            joint = JOINT_PARENTS[joint]
        return height

    return z("head") - (z("left_ankle") + z("right_ankle")) / 2.0


def joint_kinematics(
    root_position: np.ndarray, rotations: np.ndarray, offsets: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """World positions ``(T, 22, 3)`` in metres and orientations ``(T, 22, 4)`` of joints.

    Args:
        root_position: ``(T, 3)`` metres.
        rotations: ``(T, 22, 4)`` unit quaternions wxyz, each in its parent's frame.
        offsets: ``(22, 3)``, or ``(T, 22, 3)`` of a body that changes.
    """
    frames = len(root_position)
    positions = np.empty((frames, NUM_JOINTS, 3))
    orientations = np.empty((frames, NUM_JOINTS, 4))
    positions[:, 0], orientations[:, 0] = root_position, rotations[:, 0]
    for joints, parents in generations(JOINT_PARENTS):
        turn = orientations[:, parents]
        bones = rot.quat_rotate(turn, offsets[..., joints, :])
        positions[:, joints] = positions[:, parents] + bones
        orientations[:, joints] = rot.quat_multiply(turn, rotations[:, joints])
    return positions, orientations
