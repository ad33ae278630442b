"""Forward kinematics of the avatar over whole clips, and derived quantities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M, build_body
from questsim.body_proportions import Proportions
from questsim.motion.clip import FPS, Clip
from questsim.sensors import device_poses
from questsim.skeleton import DOFS, FEET, LINK_PARENTS, LINKS, NUM_LINKS

CONTACT_HEIGHT_M = 0.03
"""A foot is in contact if a point of its sole is lower than this ..."""
CONTACT_SPEED_M_S = 0.8
"""... and slower than this; both for the default body, scaled with height."""


def link_offsets(proportions: Proportions | None = None) -> np.ndarray:
    """``(16, 3)`` each link's origin in its parent's frame, of the 1.75 m body, in metres."""
    return _default_offsets() if proportions is None else proportions.array()


@lru_cache(maxsize=1)
def _default_offsets() -> np.ndarray:
    offsets = build_body().model.body_pos[1:].copy()
    offsets[0] = 0.0
    return offsets


@lru_cache(maxsize=1)
def hinge_axes() -> tuple[tuple[tuple[int, np.ndarray], ...], ...]:
    """For each link its hinges in order, as (index among the 33, axis ``(3,)``)."""
    model = build_body().model
    hinges: list[list[tuple[int, np.ndarray]]] = [[] for _ in LINKS]
    for dof in range(len(DOFS)):
        joint = model.joint(DOFS[dof])
        hinges[int(joint.bodyid[0]) - 1].append((dof, joint.axis.copy()))
    return tuple(tuple(h) for h in hinges)


@lru_cache(maxsize=1)
def dof_axes() -> np.ndarray:
    """``(33, 3)`` the axis of each hinge."""
    return np.array([axis for _, axis in sorted(sum(hinge_axes(), ()), key=lambda hinge: hinge[0])])


@lru_cache(maxsize=1)
def sole_points() -> np.ndarray:
    """``(2, 4, 3)`` the four sole points of each foot, in the foot's frame, in metres."""
    model = build_body().model
    points = []
    for foot in FEET:
        side = foot.split("_")[0]
        for name in ("heel_ball_outer", "heel_ball_inner"):
            geom = model.geom(f"{side}_{name}")
            radius, half_length = geom.size[0], geom.size[1]
            axis = rot.quat_rotate(geom.quat, np.array([0.0, 0.0, 1.0]))
            for end in (-1.0, 1.0):
                points.append(geom.pos + end * half_length * axis - [0.0, 0.0, radius])
    return np.array(points).reshape(2, 4, 3)


def link_poses(
    qpos: np.ndarray,
    height_m: float,
    links: Sequence[int] = range(NUM_LINKS),
    proportions: Proportions | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Positions ``(T, n, 3)`` in metres and orientations ``(T, n, 4)`` of ``(T, 40)`` poses.

    Args:
        qpos: root position and quaternion, joint angles.
        height_m: the body's stature.
        links: indices of the links; by default all 16.
        proportions: of the body.
    """
    needed = {0}
    for link in links:
        while link not in needed:
            needed.add(link)
            link = LINK_PARENTS[link]
    frames = len(qpos)
    offsets = link_offsets(proportions) * (height_m / DEFAULT_HEIGHT_M)
    position = np.empty((frames, NUM_LINKS, 3))
    quat = np.empty((frames, NUM_LINKS, 4))
    position[:, 0], quat[:, 0] = qpos[:, :3], qpos[:, 3:7]
    half = qpos[:, 7:] / 2.0
    hinges = np.empty((frames, len(DOFS), 4))
    hinges[..., 0] = np.cos(half)
    hinges[..., 1:] = np.sin(half)[..., None] * dof_axes()
    for link in sorted(needed - {0}):
        parent = LINK_PARENTS[link]
        position[:, link] = position[:, parent] + rot.quat_rotate(quat[:, parent], offsets[link])
        orientation = quat[:, parent]
        for dof, _ in hinge_axes()[link]:
            orientation = rot.quat_multiply(orientation, hinges[:, dof])
        quat[:, link] = orientation
    if len(links) < NUM_LINKS:
        return position[:, list(links)], quat[:, list(links)]
    return position, quat


def sole_positions(foot_position: np.ndarray, foot_quat: np.ndarray, height_m: float) -> np.ndarray:
    """World positions ``(..., 2, 4, 3)`` of the soles' points of two feet ``(..., 2, 3 | 4)``."""
    points = sole_points() * (height_m / DEFAULT_HEIGHT_M)
    return foot_position[..., None, :] + rot.quat_rotate(foot_quat[..., None, :], points)


def central_difference(values: np.ndarray, fps: float = FPS) -> np.ndarray:
    """Rate of change along axis 0, one-sided at both ends; a single frame is at rest."""
    return np.gradient(values, 1.0 / fps, axis=0) if len(values) > 1 else np.zeros_like(values)


def clip_from_qpos(
    name: str,
    qpos: np.ndarray,
    height_m: float,
    proportions: Proportions | None = None,
    **about: Any,
) -> Clip:
    """A clip from ``(T, 40)`` poses at 36 Hz of the body of height ``height_m``.

    Args:
        name: the clip's name.
        qpos: root position (m), root quaternion wxyz, 33 joint angles (rad), in each row.
        height_m: the body's stature.
        proportions: of the body.
        about: ``source``, ``source_sha256``, ``licence``, ``kind``, ``style``, ``weight``.
    """
    return clips_from_qpos([name], [qpos], [height_m], [about], [proportions])[0]


def clips_from_qpos(
    names: Sequence[str],
    qpos: Sequence[np.ndarray],
    heights_m: Sequence[float],
    about: Sequence[dict[str, Any]],
    proportions: Sequence[Proportions | None] | None = None,
) -> list[Clip]:
    """``clip_from_qpos`` for many clips at once; much faster for short clips."""
    clips = []
    bodies = list(zip(heights_m, proportions or [None] * len(heights_m), strict=True))
    for height, parts in dict.fromkeys(bodies):
        chosen = [i for i, body in enumerate(bodies) if body == (height, parts)]
        rows = np.concatenate([np.asarray(qpos[i], float) for i in chosen])
        rows[:, 3:7] /= np.linalg.norm(rows[:, 3:7], axis=-1, keepdims=True)
        position, quat = link_poses(rows, height, proportions=parts)
        ends = np.cumsum([len(qpos[i]) for i in chosen])
        starts = ends - [len(qpos[i]) for i in chosen]
        for i, start, end in zip(chosen, starts, ends, strict=True):
            part = slice(int(start), int(end))
            clip = clip_of_links(names[i], rows[part], height, position[part], quat[part])
            found = foot_contacts(clip.link_position, clip.link_quat, height)
            clips.append((i, replace(clip, contacts=found, proportions=parts, **about[i])))
    return [clip for _, clip in sorted(clips, key=lambda pair: pair[0])]


def standing_clip(height_m: float, frames: int = 1, proportions: Proportions | None = None) -> Clip:
    """A clip of the avatar standing upright at the origin, arms hanging, facing +x."""
    qpos = np.zeros((frames, 7 + len(DOFS)))
    qpos[:, 3] = 1.0
    position, quat = link_poses(qpos[:1], height_m, proportions=proportions)
    feet = [LINKS.index(foot) for foot in FEET]
    qpos[:, 2] = -sole_positions(position[:, feet], quat[:, feet], height_m)[..., 2].min()
    return clip_from_qpos("standing", qpos, height_m, proportions)


def standing_devices(names: Sequence[str], height_m: float) -> np.ndarray:
    """Places ``(D, 3)`` of devices on the avatar of ``standing_clip``, in metres."""
    standing = standing_clip(height_m)
    links = standing.link_position[0], standing.link_quat[0]
    return device_poses(*links, names, height_m)[0]


def clip_of_links(
    name: str, qpos: np.ndarray, height_m: float, position: np.ndarray, quat: np.ndarray
) -> Clip:
    """A clip of any body from its poses and its links' at 36 Hz: velocities, no contacts.

    Args:
        name: the clip's name.
        qpos: ``(T, 7 + D)`` root position (m), root quaternion wxyz, joint angles (rad).
        height_m: the body's stature.
        position, quat: ``(T, L, 3)``, ``(T, L, 4)`` of its links, the root first.
    """
    qpos = qpos.copy()
    qpos[:, 3:7] = rot.continuous(qpos[:, 3:7])
    quat = rot.continuous(quat)
    velocity = central_difference(position)
    angular = rot.angular_velocity(quat, FPS)
    qvel = np.concatenate(
        [
            velocity[:, 0],
            rot.quat_rotate(rot.quat_conjugate(quat[:, 0]), angular[:, 0]),
            central_difference(qpos[:, 7:]),
        ],
        axis=-1,
    )
    return Clip(
        name=name,
        height_m=height_m,
        qpos=qpos,
        qvel=qvel,
        link_position=position,
        link_quat=quat,
        link_velocity=velocity,
        link_angular_velocity=angular,
        contacts=np.zeros((len(qpos), 2), bool),
    )


def foot_contacts(position: np.ndarray, quat: np.ndarray, height_m: float) -> np.ndarray:
    """``(T, 2)`` bool: a point of the sole is near the floor and nearly at rest."""
    feet = [LINKS.index(foot) for foot in FEET]
    soles = sole_positions(position[:, feet], quat[:, feet], height_m)
    ratio = height_m / DEFAULT_HEIGHT_M
    low = soles[..., 2] < CONTACT_HEIGHT_M * ratio
    slow = np.linalg.norm(central_difference(soles), axis=-1) < CONTACT_SPEED_M_S * ratio
    return (low & slow).any(axis=-1)
