"""The reference of a whole clip in the world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from envs.avatar import avatar_of
from envs.footing import fill
from envs.footsteps import footsteps_of
from envs.kernel_arguments import Episodes, Ground, ReferencePoses, Target, ground_of
from envs.leg_ik import legs
from envs.placement import moved, turn_quat, turned
from questsim import rotations as rot
from questsim.bodies import OwnBody
from questsim.heightfield import HeightField
from questsim.motion.clip import Clip

_ARRAYS = (
    "qpos",
    "qvel",
    "link_position",
    "link_quat",
    "link_velocity",
    "link_angular_velocity",
)


def footed_clip(
    clip: Clip, place: np.ndarray, field: HeightField | None, body: OwnBody | None = None
) -> Clip:
    """Move and turn a clip, lift it by the ground, and put its feet on the ground.

    Args:
        clip: a clip of the avatar's height.
        place: ``(4,)`` x and y in metres, cosine and sine of the turn.
        field: the ground, None for a plane.
        body: the user's own body; None for our humanoid.
    """
    if field is None:
        return _turned_clip(clip, place)
    frames, avatar = len(clip), avatar_of(body)
    common = clip.scaled(avatar.base_m)
    target = Target.of(frames, 1, len(avatar.dofs), len(avatar.links))
    rows = np.arange(frames)
    many = np.broadcast_to(place, (frames, 4)).copy()
    episodes = Episodes(
        frame=rows,
        begin=np.zeros(frames, np.int64),
        end=np.full(frames, frames),
        place=many,
        ratio=np.full(frames, clip.height_m / avatar.base_m),
        scale=np.full((frames, 1), clip.height_m),
    )
    _fill_all(common, episodes, ground_of(field), body, target)
    turn = turn_quat(many)
    position, rise = target.position[:, 0], target.rise[:, 0].copy()
    rise[0] = rise[1] if frames > 1 else 0.0
    velocity = turned(many, clip.link_velocity)
    velocity[..., 2] += rise
    qpos, qvel = clip.qpos.copy(), clip.qvel.copy()
    qpos[:, :3], qvel[:, :3] = position[:, 0], velocity[:, 0]
    qpos[:, 3:7] = rot.quat_multiply(turn, clip.qpos[:, 3:7])
    qpos[:, 7:] = target.angles[:, 0]
    return replace(
        clip,
        qpos=qpos,
        qvel=qvel,
        link_position=position,
        link_quat=rot.quat_multiply(turn[:, None], target.quat[:, 0]),
        link_velocity=velocity,
        link_angular_velocity=turned(many, clip.link_angular_velocity),
    )


def _fill_all(
    clip: Clip, episodes: Episodes, ground: Ground, body: OwnBody | None, target: Target
) -> None:
    """Fill the target of every frame of a clip of the size that reference lengths are of."""
    frames, now = len(clip), np.zeros(1, np.int64)
    steps = footsteps_of([clip] if body is None else [])
    rows, links = episodes.frame, (clip.qpos, clip.link_position, clip.link_quat)
    if body is None:
        poses = ReferencePoses(*links, steps)
        fill(0, frames, rows, episodes, now, poses, ground, legs(), 1.0, target)
        return
    from envs.own_legs import fill_own, own_feet  # late: few tasks have such a body

    own = own_feet(body, [clip])
    qpos, position, quat = (np.ascontiguousarray(part, np.float32) for part in links)
    poses = ReferencePoses(qpos, position, quat, steps)
    fill_own(0, frames, rows, episodes, now, poses, own.roles, ground, own.legs, 1.0, target)


def _turned_clip(clip: Clip, place: np.ndarray) -> Clip:
    """Move and turn a clip on a plane."""
    if tuple(place) == (0.0, 0.0, 1.0, 0.0):
        return clip
    many = np.broadcast_to(place, (len(clip), 4))
    turn = turn_quat(many)
    qpos, qvel = clip.qpos.copy(), clip.qvel.copy()
    qpos[:, :3], qvel[:, :3] = moved(many, clip.qpos[:, :3]), turned(many, clip.qvel[:, :3])
    qpos[:, 3:7] = rot.quat_multiply(turn, clip.qpos[:, 3:7])
    return replace(
        clip,
        qpos=qpos,
        qvel=qvel,
        link_position=moved(many, clip.link_position),
        link_quat=rot.quat_multiply(turn[:, None], clip.link_quat),
        link_velocity=turned(many, clip.link_velocity),
        link_angular_velocity=turned(many, clip.link_angular_velocity),
    )


def joined(before: Clip, after: Clip, first: int) -> Clip:
    """A clip whose frames are those of ``before``, and from frame ``first`` on of ``after``."""
    frames = np.arange(len(before)) < first
    arrays = {
        name: np.where(
            frames.reshape(-1, *[1] * (getattr(before, name).ndim - 1)),
            getattr(before, name),
            getattr(after, name),
        )
        for name in _ARRAYS
    }
    return replace(before, **arrays)
