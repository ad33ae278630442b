"""Splits a clip into the parts that a variation changes, and rebuilds it by leg IK.

All lengths are those of the default body; time is the clip's own.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M, build_body
from questsim.errors import InputError
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import foot_contacts, link_offsets, link_poses
from questsim.motion.limbs import FULL_STRETCH, SIDES, fill_legs, joint_index
from questsim.motion.synthesis.balance import lowering
from questsim.skeleton import FOOT_LINKS, LINKS, NUM_JOINTS

_ROUNDS = 3
"""Iterations after which the centre of mass is within 2 mm of its target."""
_THIGHS = [LINKS.index("left_thigh"), LINKS.index("right_thigh")]
_FEET = list(FOOT_LINKS)
_UPPER = [0, *range(LINKS.index("spine"), len(LINKS))]
"""Pelvis, trunk, head and arms."""


@dataclass
class Figure:
    """The parts of a motion of the default body; ingredients change them in place.

    Attributes:
        root: ``(T, 3)`` place of the pelvis in metres; its x and y follow from ``center``.
        pelvis: ``(T, 4)`` its orientation, as all quaternions wxyz.
        angles: ``(T, 33)`` hinge angles in radians; those of the legs follow from the feet.
        thigh: ``(T, 2, 4)`` orientations, of which the y axis is the knee's.
        ankle: ``(T, 2, 3)`` places of the feet in metres.
        foot: ``(T, 2, 4)`` orientations of the feet.
        contacts: ``(T, 2)`` bool, whether each foot bears on the floor.
        center: ``(T, 2)`` horizontal position of the body's centre of mass in metres.
    """

    root: np.ndarray
    pelvis: np.ndarray
    angles: np.ndarray
    thigh: np.ndarray
    ankle: np.ndarray
    foot: np.ndarray
    contacts: np.ndarray
    center: np.ndarray

    def __len__(self) -> int:
        return len(self.root)

    @property
    def time(self) -> np.ndarray:
        """``(T,)`` seconds."""
        return np.arange(len(self)) / FPS

    @property
    def heading(self) -> np.ndarray:
        """``(T,)`` yaw of the pelvis in radians, without jumps."""
        return np.unwrap(rot.heading(self.pelvis))


def check_bodies(clips: Iterable[Clip], what: str) -> None:
    """Check that clips have the default body's proportions, as ``what`` is to have.

    Raises:
        InputError: one has not; it is named.
    """
    for clip in clips:
        if clip.proportions is not None:
            told = f"{what} are of the default body's proportions"
            raise InputError(told, clip.name, "leave the proportions out")


def default_poses(clip: Clip, first: int = 0, last: int | None = None) -> np.ndarray:
    """Poses ``(T, 40)`` of some frames of a clip, on the default body."""
    qpos = clip.qpos[first:last].copy()
    qpos[:, :3] *= DEFAULT_HEIGHT_M / clip.height_m
    return qpos


def in_other_time(qpos: np.ndarray, speed: float, reverse: bool) -> np.ndarray:
    """Poses ``(T, 40)`` played ``speed`` times as fast, backwards if asked for."""
    frames = int(np.floor((len(qpos) - 1) / speed)) + 1
    at = np.minimum(np.arange(frames) * speed, len(qpos) - 1)
    warped = CubicSpline(np.arange(len(qpos)), qpos)(at)
    warped[:, 3:7] /= np.linalg.norm(warped[:, 3:7], axis=-1, keepdims=True)
    return warped[::-1].copy() if reverse else warped


def figure_of(qpos: np.ndarray) -> Figure:
    """The parts of the default body's poses ``(T, 40)``."""
    position, quat = link_poses(qpos, DEFAULT_HEIGHT_M)
    centers, share = _link_centers(position, quat)
    return Figure(
        root=qpos[:, :3].copy(),
        pelvis=rot.continuous(qpos[:, 3:7]),
        angles=qpos[:, 7:].copy(),
        thigh=quat[:, _THIGHS],
        ankle=position[:, _FEET],
        foot=quat[:, _FEET],
        contacts=foot_contacts(position, quat, DEFAULT_HEIGHT_M),
        center=np.einsum("l,tlk->tk", share, centers[..., :2]),
    )


def _link_centers(position: np.ndarray, quat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres of mass ``(T, 16, 3)`` of the links in these poses, and mass shares ``(16,)``."""
    model = build_body().model
    mass = model.body_mass[1:]
    return position + rot.quat_rotate(quat, model.body_ipos[1:]), mass / mass.sum()


def solve(figure: Figure) -> np.ndarray:
    """Poses ``(T, 40)`` whose centre of mass and feet are the figure's.

    The root moves horizontally until the centre of mass is on target, and sinks smoothly where a
    leg is too short. Hinge angles are clipped to their ranges: see ``misfit``.
    """
    upper = _upper_center(figure)
    root = figure.root.copy()
    for _ in range(_ROUNDS):
        root[:, 2] = figure.root[:, 2] - lowering(_excess(figure, root), figure.time)
        root[:, :2] += figure.center - _center(figure, root, upper)
    root[:, 2] = figure.root[:, 2] - lowering(_excess(figure, root), figure.time)
    return _with_legs(figure, root)


def misfit(figure: Figure, clip: Clip) -> tuple[np.ndarray, np.ndarray]:
    """Distance and angle of a clip's feet from their targets: ``(T, 2)`` metres and radians."""
    size = DEFAULT_HEIGHT_M / clip.height_m
    place = clip.link_position[:, _FEET] * size
    # A clip begins at the origin, its figure at the recording's position.
    place[..., :2] -= place[:1, :1, :2] - figure.ankle[:1, :1, :2]
    distance = np.linalg.norm(place - figure.ankle, axis=-1)
    return distance, rot.angle_between(clip.link_quat[:, _FEET], figure.foot)


def _upper_center(figure: Figure) -> np.ndarray:
    """``(T, 2)`` offset of the centre of mass from the root due to pelvis, trunk, head and arms."""
    poses = np.concatenate([np.zeros_like(figure.root), figure.pelvis, figure.angles], axis=-1)
    centers, share = _link_centers(*link_poses(poses, DEFAULT_HEIGHT_M))
    return np.einsum("l,tlk->tk", share[_UPPER], centers[:, _UPPER, :2])


def _center(figure: Figure, root: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """``(T, 2)`` centre of mass with the root at ``(T, 3)`` and the legs reaching their feet."""
    model, offsets = build_body().model, link_offsets()
    share = model.body_mass[1:] / model.body_mass.sum()
    total = upper + share[_UPPER].sum() * root[:, :2]
    hips = _hips(figure, root)
    for foot in range(2):
        thigh, shin, toe = (_THIGHS[foot] + part for part in range(3))
        lengths = [-float(offsets[link, 2]) for link in (shin, toe)]
        hip, ankle = hips[:, foot], figure.ankle[:, foot]
        knee = _knee(hip, ankle, figure.thigh[:, foot], *lengths)
        for link, start, end, length in (
            (thigh, hip, knee, lengths[0]),
            (shin, knee, ankle, lengths[1]),
        ):
            along = -float(model.body_ipos[link + 1, 2]) / length
            total = total + share[link] * (start + along * (end - start))[:, :2]
        own = rot.quat_rotate(figure.foot[:, foot], model.body_ipos[toe + 1])
        total = total + share[toe] * (ankle + own)[:, :2]
    return total


def _knee(
    hip: np.ndarray, ankle: np.ndarray, thigh: np.ndarray, upper: float, lower: float
) -> np.ndarray:
    """``(T, 3)`` the knee between hip and ankle, bent about the thigh's y axis."""
    reach = ankle - hip
    distance = np.linalg.norm(reach, axis=-1, keepdims=True)
    along = reach / np.maximum(distance, 1e-6)
    axis = rot.quat_rotate(thigh, np.array([0.0, 1.0, 0.0]))
    forward = np.cross(along, axis)
    forward /= np.maximum(np.linalg.norm(forward, axis=-1, keepdims=True), 1e-6)
    distance = np.clip(distance, abs(upper - lower) + 1e-3, FULL_STRETCH * (upper + lower))
    cos = (upper**2 + distance**2 - lower**2) / (2.0 * upper * distance)
    return hip + upper * (cos * along + np.sqrt(np.maximum(1.0 - cos**2, 0.0)) * forward)


def _hips(figure: Figure, root: np.ndarray) -> np.ndarray:
    """``(T, 2, 3)`` the hip joints, in metres."""
    offsets = link_offsets()[_THIGHS]
    return root[:, None] + rot.quat_rotate(figure.pelvis[:, None], offsets)


def _excess(figure: Figure, root: np.ndarray) -> np.ndarray:
    """``(T,)`` excess height of the root for the shorter leg, in metres."""
    offsets = link_offsets()
    leg = -(offsets[LINKS.index("left_shin"), 2] + offsets[LINKS.index("left_foot"), 2])
    gap = figure.ankle - _hips(figure, root)
    flat = np.sum(gap[..., :2] ** 2, axis=-1)
    # A foot out of the leg's reach cannot be fixed here; ``misfit`` reports it.
    rise = np.sqrt(np.maximum((FULL_STRETCH * leg) ** 2 - flat, 0.01))
    return np.maximum(-(gap[..., 2] + rise).min(axis=1), 0.0)


def _with_legs(figure: Figure, root: np.ndarray) -> np.ndarray:
    limits = build_body().model.jnt_range[1:]
    quat = np.zeros((len(figure), NUM_JOINTS, 4))
    quat[:, joint_index("root")] = figure.pelvis
    angles = figure.angles.copy()
    quat[:, [joint_index(f"{side}_hip") for side in SIDES]] = figure.thigh
    fill_legs(root, quat, figure.ankle, figure.foot, DEFAULT_HEIGHT_M, angles)
    angles = np.clip(angles, limits[:, 0], limits[:, 1])
    return np.concatenate([root, figure.pelvis, angles], axis=-1)
