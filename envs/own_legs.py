"""The reference of a body of the user's own on uneven ground.

Each foot is adapted to the ground as the avatar's is (``footing.py``). The legs of such a body may
have any hinges, so they follow their feet by damped least squares on the hinges' axes: Buss,
"Introduction to inverse kinematics" (2004), section 7. On level ground nothing changes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from envs.footing import (
    STRAIGHT,
    Site,
    copy_pose,
    foot_bearing,
    lift_at,
    place_links,
)
from envs.footsteps import STANDING_M, STANDING_M_S, Footsteps, steps_of_foot
from envs.kernel_arguments import Episodes, Ground, ReferencePoses, Target
from envs.leg_ik import Pose, distance, rotated
from envs.lookups import product
from questsim import rotations as rot
from questsim.bodies import OwnBody, map_of
from questsim.bodies.retarget import poses_of
from questsim.compiled import jit
from questsim.motion.clip import FPS, Clip
from questsim.skeleton import LINKS

_STEPS = 6
"""Steps of the least squares; the last of them change the pose by less than a millimetre."""
_PLACE = 40.0
"""Weight of a foot's place per metre; that of its orientation is 1 per radian."""
_DAMPING = 0.05
_LARGEST_TURN = 0.4
"""Greatest turn of a hinge in one step, rad."""
_SOLE_M = 0.02
"""Points of a foot up to this height above its lowest one are its sole."""
_PELVIS, _THIGHS = LINKS.index("pelvis"), (LINKS.index("left_thigh"), LINKS.index("right_thigh"))
_FEET = (LINKS.index("left_foot"), LINKS.index("right_foot"))


class OwnLegs(NamedTuple):
    """Legs of a body of ``L`` links and ``D`` hinges, of its own size.

    Attributes:
        soles: ``(2, 4, 3)`` corners of the soles in the frames of the roles of the feet.
        straight: ``(2,)`` metres from hip to ankle in the rest pose.
        foot: ``(2,)`` links of the feet; at: ``(2, 3)`` places of their roles in them.
        leg: ``(L,)`` 0 or 1 for links of the left and right leg, -1 for the others.
        below: ``(L,)`` bool, a foot or a link that hangs on one.
        parent: ``(L,)`` link; place: ``(L, 3)``, turn: ``(L, 4)`` of a link in its parent.
        link: ``(D,)`` of a hinge; axis: ``(D, 3)``, anchor: ``(D, 3)`` of a hinge in its link.
        moves: ``(D,)`` bool, hinges between the trunk and a foot.
        range: ``(D, 2)`` rad.
    """

    soles: np.ndarray
    straight: np.ndarray
    foot: np.ndarray
    at: np.ndarray
    leg: np.ndarray
    below: np.ndarray
    parent: np.ndarray
    place: np.ndarray
    turn: np.ndarray
    link: np.ndarray
    axis: np.ndarray
    anchor: np.ndarray
    moves: np.ndarray
    range: np.ndarray


class OwnFeet(NamedTuple):
    """What ``fill_own`` needs of clips besides the poses of their links.

    Attributes:
        legs: of the body.
        roles: poses of the avatar's links on the body in all rows, with the steps of its feet.
    """

    legs: OwnLegs
    roles: ReferencePoses


@lru_cache(maxsize=16)
def own_legs(body: OwnBody) -> OwnLegs:
    """The legs of a body."""
    own = map_of(body)
    model, links = own.body.model, len(own.links)
    parent = model.body_parentid[1:].astype(np.int64) - 1
    foot = own.role_link[list(_FEET)].astype(np.int64)
    ways = [_way(parent, int(link)) for link in foot]
    shared = set(ways[0]) & set(ways[1])
    leg, below, on_way = np.full(links, -1), np.zeros(links, bool), np.zeros(links, bool)
    for side, way in enumerate(ways):
        on_way[[link for link in way if link not in shared]] = True
        first = [link for link in way if link not in shared][-1]
        for link in range(links):
            above = _way(parent, link)
            if first in above:
                leg[link] = side
            below[link] |= int(foot[side]) in above
    position, quat = poses_of(own, own.rest[None])
    roles, _ = own.roles(position[0], quat[0])
    hinge_link = model.jnt_bodyid[1:].astype(np.int64) - 1
    return OwnLegs(
        soles=_soles(body),
        straight=np.linalg.norm(roles[list(_THIGHS)] - roles[list(_FEET)], axis=-1),
        foot=foot,
        at=own.role_at[list(_FEET)].copy(),
        leg=leg,
        below=below,
        parent=parent,
        place=model.body_pos[1:].copy(),
        turn=model.body_quat[1:].copy(),
        link=hinge_link,
        axis=model.jnt_axis[1:].copy(),
        anchor=model.jnt_pos[1:].copy(),
        moves=on_way[hinge_link],
        range=own.joint_range.astype(float),
    )


def own_feet(body: OwnBody, clips: Sequence[Clip]) -> OwnFeet:
    """Legs of the body, and the avatar's links on it in its clips, one after the other."""
    own, legs = map_of(body), own_legs(body)
    many = [own.roles(clip.link_position, clip.link_quat) for clip in clips]
    parts, begin = [], 0
    for position, quat in many:
        feet = list(_FEET)
        points = position[:, feet, None] + rot.quat_rotate(quat[:, feet, None], legs.soles)
        columns = [steps_of_foot(*_in_stance(points[:, side])) for side in range(2)]
        parts.append(np.stack(columns, axis=-1))
        parts[-1][:4] += begin
        begin += len(points)
    rows = np.concatenate(parts, axis=1)
    before, after, first, last = rows[:4].astype(np.int64)
    roles = ReferencePoses(
        qpos=_rows([clip.qpos for clip in clips]),
        position=_rows([position for position, _ in many]),
        quat=_rows([quat for _, quat in many]),
        steps=Footsteps(before, after, first, last, rows[4].astype(bool), rows[5]),
    )
    return OwnFeet(legs, roles)


def _way(parent: np.ndarray, link: int) -> list[int]:
    """A link and all above it, up to the root."""
    way = [link]
    while parent[way[-1]] >= 0:
        way.append(int(parent[way[-1]]))
    return way


def _soles(body: OwnBody) -> np.ndarray:
    """Corners ``(2, 4, 3)`` of the lowest part of each foot in the rest pose."""
    own = map_of(body)
    position, quat = poses_of(own, own.rest[None])
    places, turns = own.roles(position[0], quat[0])
    bottoms = own.support.bottoms(position, quat)[0]
    corners = np.empty((2, 4, 3))
    for side, role in enumerate(_FEET):
        points = bottoms[own.support.foot == side]
        points = points[points[:, 2] < points[:, 2].min() + _SOLE_M]
        points = rot.quat_rotate(rot.quat_conjugate(turns[role]), points - places[role])
        (back, right, low), (front, left, _) = points.min(axis=0), points.max(axis=0)
        corners[side] = [(x, y, low) for x in (front, back) for y in (left, right)]
    return corners


def _rows(arrays: Sequence[np.ndarray]) -> np.ndarray:
    # One memory layout, so that the loops are compiled only once.
    return np.ascontiguousarray(np.concatenate(arrays), np.float32)


def _in_stance(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stances ``(T,)`` bool of a foot with sole points ``(T, 4, 3)``; its centre ``(T, 2)``."""
    frames = np.arange(len(points))
    speed = np.linalg.norm(np.gradient(points, axis=0), axis=-1) * FPS
    lowest = points[..., 2].argmin(axis=-1)
    low = points[frames, lowest, 2] < STANDING_M
    return low & (speed[frames, lowest] < STANDING_M_S), points[..., :2].mean(axis=1)


@jit
def _leg_pose(leg, legs, scale, angles, position, quat, axes, anchors):
    """Poses of a leg's links from its angles, and its hinges' axes and places in the clip."""
    for link in range(legs.leg.shape[0]):
        if legs.leg[link] != leg:
            continue
        up = legs.parent[link]
        at, turn = legs.place[link], legs.turn[link]
        q = (quat[up, 0], quat[up, 1], quat[up, 2], quat[up, 3])
        x, y, z = rotated(q, at[0] * scale, at[1] * scale, at[2] * scale)
        x, y, z = x + position[up, 0], y + position[up, 1], z + position[up, 2]
        q = product(q, (turn[0], turn[1], turn[2], turn[3]))
        for hinge in range(legs.link.shape[0]):
            if legs.link[hinge] != link:
                continue
            anchor, axis = legs.anchor[hinge], legs.axis[hinge]
            a, b, c = anchor[0] * scale, anchor[1] * scale, anchor[2] * scale
            to_x, to_y, to_z = rotated(q, a, b, c)
            x, y, z = x + to_x, y + to_y, z + to_z
            axes[hinge, 0], axes[hinge, 1], axes[hinge, 2] = rotated(q, axis[0], axis[1], axis[2])
            anchors[hinge, 0], anchors[hinge, 1], anchors[hinge, 2] = x, y, z
            s = math.sin(0.5 * angles[hinge])
            half = math.cos(0.5 * angles[hinge])
            q = product(q, (half, s * axis[0], s * axis[1], s * axis[2]))
            to_x, to_y, to_z = rotated(q, a, b, c)
            x, y, z = x - to_x, y - to_y, z - to_z
        position[link, 0], position[link, 1], position[link, 2] = x, y, z
        quat[link, 0], quat[link, 1], quat[link, 2], quat[link, 3] = q


@jit
def _apart(leg, legs, scale, goal, turn, position, quat, error):
    """Weighted difference ``error`` ``(6,)`` between the wanted pose of a foot and its own."""
    foot = legs.foot[leg]
    at = legs.at[leg]
    q = (quat[foot, 0], quat[foot, 1], quat[foot, 2], quat[foot, 3])
    x, y, z = rotated(q, at[0] * scale, at[1] * scale, at[2] * scale)
    x, y, z = x + position[foot, 0], y + position[foot, 1], z + position[foot, 2]
    error[0] = _PLACE * (goal[0] - x)
    error[1] = _PLACE * (goal[1] - y)
    error[2] = _PLACE * (goal[2] - z)
    w, i, j, k = product(turn, (q[0], -q[1], -q[2], -q[3]))
    sign = 2.0 if w >= 0.0 else -2.0
    error[3], error[4], error[5] = sign * i, sign * j, sign * k
    return x, y, z


@jit
def _solve(matrix, right):
    """Solve a symmetric positive system ``(6, 6)`` in place by Cholesky's decomposition."""
    for i in range(6):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = math.sqrt(total) if i == j else total / matrix[j, j]
    for i in range(6):
        for k in range(i):
            right[i] -= matrix[i, k] * right[k]
        right[i] /= matrix[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            right[i] -= matrix[k, i] * right[k]
        right[i] /= matrix[i, i]


@jit
def _reach(leg, legs, scale, goal, turn, pose, work):
    """Bend a leg until its foot has its wanted place and orientation, as far as hinges go."""
    angles, position, quat = pose
    axes, anchors, rows, normal, error = work
    _leg_pose(leg, legs, scale, angles, position, quat, axes, anchors)
    for _ in range(_STEPS):
        x, y, z = _apart(leg, legs, scale, goal, turn, position, quat, error)
        for i in range(6):
            for j in range(6):
                normal[i, j] = _DAMPING if i == j else 0.0
        for hinge in range(legs.link.shape[0]):
            if not legs.moves[hinge] or legs.leg[legs.link[hinge]] != leg:
                continue
            axis, row = axes[hinge], rows[hinge]
            a, b, c = x - anchors[hinge, 0], y - anchors[hinge, 1], z - anchors[hinge, 2]
            row[0] = _PLACE * (axis[1] * c - axis[2] * b)
            row[1] = _PLACE * (axis[2] * a - axis[0] * c)
            row[2] = _PLACE * (axis[0] * b - axis[1] * a)
            row[3], row[4], row[5] = axis[0], axis[1], axis[2]
            for i in range(6):
                for j in range(6):
                    normal[i, j] += row[i] * row[j]
        _solve(normal, error)
        for hinge in range(legs.link.shape[0]):
            if not legs.moves[hinge] or legs.leg[legs.link[hinge]] != leg:
                continue
            change = 0.0
            for i in range(6):
                change += rows[hinge, i] * error[i]
            change = min(max(change, -_LARGEST_TURN), _LARGEST_TURN)
            angle = angles[hinge] + change
            # A clip may be beyond a range by a rounding.
            low, high = min(legs.range[hinge, 0], angles[hinge]), legs.range[hinge, 1]
            angles[hinge] = min(max(angle, low), max(high, angles[hinge]))
        _leg_pose(leg, legs, scale, angles, position, quat, axes, anchors)


@jit
def _on_feet(row, site, legs, links, roles, lift, pose, rises, work):
    """Put the feet of a pose on the ground. The pose is in the clip's own coordinates.

    Args:
        row, site, lift: as of ``footing.foot_bearing``.
        legs: of the body's own size.
        links: ``ReferencePoses`` of the body's links.
        roles: those of the avatar's links on it.
        pose: to change.
        rises: ``(L,)`` vertical velocities of the links in m/s, to fill.
        work: arrays to write to.
    """
    scale, position = site.scale, pose.position
    left = foot_bearing(0, row, site, legs.soles[0], roles, lift)
    right = foot_bearing(1, row, site, legs.soles[1], roles, lift)
    drop = 0.0
    for leg in range(2):
        held = left if leg == 0 else right
        thigh, foot = roles.position[row, 1 + 3 * leg], roles.position[row, 3 + 3 * leg]
        hip = (thigh[0] * scale, thigh[1] * scale, thigh[2] * scale)
        ankle = (foot[0] * scale, foot[1] * scale, foot[2] * scale)
        reach = max(distance(ankle, hip), STRAIGHT * scale * legs.straight[leg])
        across = (held[1] - hip[0]) ** 2 + (held[2] - hip[1]) ** 2
        down = math.sqrt(max(reach * reach - across, 0.0))
        drop = max(drop, held[0] * (hip[2] - held[3] - down))
    for link in range(position.shape[0]):
        position[link, 2] -= drop
        rises[link] = lift.rise
    for leg in range(2):
        _, x, y, z, turn, own = left if leg == 0 else right
        foot = legs.foot[leg]
        q = links.quat[row, foot]
        wanted = product(turn, (q[0], q[1], q[2], q[3]))
        _reach(leg, legs, scale, (x, y, z), wanted, pose, work)
        # The velocity of a foot is its own, not the pelvis's.
        for link in range(position.shape[0]):
            if legs.leg[link] == leg:
                rises[link] = own if legs.below[link] else 0.5 * (own + lift.rise)


@jit
def fill_own(
    first: int,
    last: int,
    ids: np.ndarray,
    episodes: Episodes,
    offsets: np.ndarray,
    links: ReferencePoses,
    roles: ReferencePoses,
    ground: Ground,
    legs: OwnLegs,
    walking: float,
    target: Target,
) -> None:
    """``footing.fill`` for a body of the user's own on a terrain.

    Args:
        first, last, ids, episodes, offsets, ground, walking, target: as of ``footing.fill``.
        links: poses of the body's links in all rows.
        roles: poses of the avatar's links on the body in all rows, with the steps of its feet.
        legs: of the body's own size.
    """
    frame, begin, end, place = episodes.frame, episodes.begin, episodes.end, episodes.place
    hinges = legs.link.shape[0]
    work = (
        np.zeros((hinges, 3)), np.zeros((hinges, 3)), np.zeros((hinges, 6)), np.zeros((6, 6)),
        np.zeros(6),
    )  # fmt: skip
    for index in range(first, last):
        i = ids[index]
        scale = episodes.ratio[i]
        site = Site(place[i], ground.surface, ground.grid, scale, walking)  # type: ignore[arg-type]
        for k in range(offsets.shape[0]):
            row = min(frame[i] + offsets[k], end[i] - 1)
            before = max(row - 1, begin[i])
            pose = Pose(target.angles[i, k], target.position[i, k], target.quat[i, k])
            copy_pose(links, row, scale, pose)
            lift = lift_at(links.qpos, row, before, site, ground)
            _on_feet(row, site, legs, links, roles, lift, pose, target.rise[i, k], work)
            place_links(target.position[i, k], place[i], lift.height)
