"""The reference on uneven ground: each foot is adapted to the ground below it.

A clip is recorded on a level floor. In the world the clip is lifted by the height of the ground
under the pelvis. A stance foot is lifted and turned with the ground under it. A swing foot moves
from one stance to the next (``footsteps.py``) and clears the ground in between. The legs follow
their feet (``leg_ik.py``). If a stance foot could not reach the ground, the pelvis is lowered. On
level ground nothing changes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from envs.kernel_arguments import Episodes, Ground, ReferencePoses, Target
from envs.leg_ik import FootGoal, Legs, Pose, bend_leg, distance, hip_position, rotated
from envs.lookups import ground_at, height_at, placed
from questsim.compiled import jit
from questsim.motion.clip import FPS

CLEARANCE_M = 0.01
"""Clearance of a swing foot above the ground."""
_LOOKS = 5
"""Number of moments of a swing at which the clearance is checked."""
STEEPEST_RAD = 0.4
"""Greatest turn of a foot: the range of an ankle."""
STRAIGHT = 0.99
"""Legs are stretched up to this share of their length, or as far as the clip stretches them."""


class Site(NamedTuple):
    """Where an avatar plays its clip, and how.

    Attributes:
        place: ``(4,)`` of the clip, see ``Episodes``.
        surface, grid: the terrain, see ``Ground``.
        scale: of body and clip.
        walking: as of ``fill``.
    """

    place: np.ndarray
    surface: np.ndarray
    grid: np.ndarray
    scale: float
    walking: float


class Lift(NamedTuple):
    """How the ground under the pelvis moves a clip.

    Attributes:
        height: metres.
        rise: its rate in m/s.
    """

    height: float
    rise: float


class _Between(NamedTuple):
    """The rows between which a foot swings, and the height of the ground at both stances."""

    first: int
    last: int
    from_m: float
    to_m: float


@jit
def _under(site, position, quat, point):
    """A sole point above the level floor (x, y, z), and the height of the ground there."""
    scale = site.scale
    x, y, z = rotated(quat, point[0] * scale, point[1] * scale, point[2] * scale)
    x, y, z = x + position[0], y + position[1], z + position[2]
    world_x, world_y = placed(site.place, x, y)
    return x, y, z, height_at(site.surface, site.grid, world_x, world_y)


@jit
def _middle(position, quat, soles, scale):
    """Centre of a sole on the level floor, x and y."""
    middle_x, middle_y = position[0] * scale, position[1] * scale
    for k in range(soles.shape[0]):
        x, y, _ = rotated(quat, soles[k, 0] * scale, soles[k, 1] * scale, soles[k, 2] * scale)
        middle_x += x / soles.shape[0]
        middle_y += y / soles.shape[0]
    return middle_x, middle_y


@jit
def _stance(site, position, quat, soles):
    """Height and slope of the ground under a stance foot.

    Args:
        site: where the avatar is.
        position, quat: ``(3,)`` metres and ``(4,)`` of the foot on the level floor, of the 1.75 m
            body.
        soles: ``(4, 3)`` points of its sole.

    Returns:
        Height of the ground, and its slopes along x and y of the clip.
    """
    scale = site.scale
    q = (quat[0], quat[1], quat[2], quat[3])
    ahead_x, ahead_y, _ = rotated(q, 1.0, 0.0, 0.0)
    length = math.sqrt(ahead_x * ahead_x + ahead_y * ahead_y)
    if length < 1e-6:
        ahead_x, ahead_y, length = 1.0, 0.0, 1.0
    ahead_x, ahead_y = ahead_x / length, ahead_y / length
    at = (position[0] * scale, position[1] * scale, position[2] * scale)
    points = (
        _under(site, at, q, soles[0]),
        _under(site, at, q, soles[1]),
        _under(site, at, q, soles[2]),
        _under(site, at, q, soles[3]),
    )
    middle_x, middle_y, mean = 0.0, 0.0, 0.0
    for x, y, _, height in points:
        middle_x += 0.25 * x
        middle_y += 0.25 * y
        mean += 0.25 * height
    # A plane through the ground under the four points, by least squares along and aside.
    along_height, along_square, aside_height, aside_square = 0.0, 0.0, 0.0, 0.0
    for x, y, _, height in points:
        along = (x - middle_x) * ahead_x + (y - middle_y) * ahead_y
        aside = (y - middle_y) * ahead_x - (x - middle_x) * ahead_y
        along_height += along * height
        along_square += along * along
        aside_height += aside * height
        aside_square += aside * aside
    least = 1e-4 * scale * scale
    slope_along = along_height / max(along_square, least)
    slope_aside = aside_height / max(aside_square, least)
    over = 0.0
    for x, y, _, height in points:
        along = (x - middle_x) * ahead_x + (y - middle_y) * ahead_y
        aside = (y - middle_y) * ahead_x - (x - middle_x) * ahead_y
        over = max(over, height - (mean + slope_along * along + slope_aside * aside))
    lean_x = slope_along * ahead_x - slope_aside * ahead_y
    lean_y = slope_along * ahead_y + slope_aside * ahead_x
    return mean + over, lean_x, lean_y


@jit
def _smooth(phase):
    """Smooth step from 0 to 1, and its derivative."""
    p = min(max(phase, 0.0), 1.0)
    return p * p * (3.0 - 2.0 * p), 6.0 * p * (1.0 - p)


@jit
def _obstacle(foot, between, site, soles, reference):
    """Greatest penetration of a swing foot that is lifted from one stance height to the next.

    Args:
        foot: link of the foot.
        between: rows and heights of the stances.
        site, soles: as of ``_stance``.
        reference: poses of all rows.
    """
    position, quat, scale = reference.position, reference.quat, site.scale
    first, last, from_m, to_m = between
    most = 0.0
    for k in range(1, _LOOKS + 1):
        row = first + k * (last - first) // (_LOOKS + 1)
        share, _ = _smooth((row - first) / (last - first))
        q = (quat[row, foot, 0], quat[row, foot, 1], quat[row, foot, 2], quat[row, foot, 3])
        at = (
            position[row, foot, 0] * scale, position[row, foot, 1] * scale,
            position[row, foot, 2] * scale,
        )  # fmt: skip
        for point in range(soles.shape[0]):
            _, _, z, height = _under(site, at, q, soles[point])
            most = max(most, height - z - from_m - share * (to_m - from_m) + CLEARANCE_M * scale)
    return most


@jit
def _swing(leg, row, site, soles, reference, from_m, to_m):
    """A foot between two stances.

    Args:
        leg, row, site, soles, reference: as of ``foot_bearing``.
        from_m, to_m: height of the ground at the stances before and after.

    Returns:
        Share of stance, 0 to 1; the vertical velocity in m/s; the share of the way to the next
        stance; the height in metres by which obstacles raise the foot.
    """
    steps = reference.steps
    first, last = steps.first[row, leg], steps.last[row, leg]
    phase = (row - first) / (last - first)
    gone, faster = _smooth(phase)
    share, raised, more = 1.0, 0.0, 0.0
    if steps.swings[row, leg]:
        between = _Between(first, last, from_m, to_m)
        top = _obstacle(3 + 3 * leg, between, site, soles, reference)
        # Rise early and sink late: an obstacle may be at either end of the swing.
        aside = 2.0 * phase - 1.0
        raised = top * (1.0 - aside**4)
        more = -8.0 * top * aside**3
        share = aside**4
    return share, FPS * (faster * (to_m - from_m) + more) / (last - first), gone, raised


@jit
def foot_bearing(leg, row, site, soles, reference, lift):
    """Adapt a foot to the ground.

    Args:
        leg: 0 or 1.
        row: of the reference.
        site, soles: as of ``_stance``.
        reference: poses of all rows.
        lift: of the clip.

    Returns:
        Share of stance, 0 to 1; the ankle's new x, y and z before the clip is lifted; the turn as a
        quaternion; the vertical velocity in m/s that is added to the clip's own.
    """
    position, quat, steps = reference.position, reference.quat, reference.steps
    scale, walking, foot = site.scale, site.walking, 3 + 3 * leg
    before, after = steps.before[row, leg], steps.after[row, leg]
    if max(walking, steps.stays[before, leg], steps.stays[after, leg]) == 0.0:
        x, y, z = position[row, foot, 0], position[row, foot, 1], position[row, foot, 2]
        return 0.0, x * scale, y * scale, z * scale, (1.0, 0.0, 0.0, 0.0), lift.rise
    height, lean_x, lean_y = _stance(site, position[before, foot], quat[before, foot], soles)
    share, rise, firm = 1.0, 0.0, max(walking, steps.stays[before, leg])
    if before != after:
        to = _stance(site, position[after, foot], quat[after, foot], soles)
        share, rise, gone, raised = _swing(leg, row, site, soles, reference, height, to[0])
        height += gone * (to[0] - height) + raised
        lean_x += gone * (to[1] - lean_x)
        lean_y += gone * (to[2] - lean_y)
        firm += gone * (max(walking, steps.stays[after, leg]) - firm)
    share *= firm
    height = lift.height + firm * (height - lift.height)
    lean_x, lean_y = firm * lean_x, firm * lean_y
    rise = lift.rise + firm * (rise - lift.rise)
    q = (quat[row, foot, 0], quat[row, foot, 1], quat[row, foot, 2], quat[row, foot, 3])
    middle_x, middle_y = _middle(position[row, foot], q, soles, scale)
    # The ground's normal leans against the slope; the foot turns with it.
    steepness = math.sqrt(lean_x * lean_x + lean_y * lean_y)
    turn = (1.0, 0.0, 0.0, 0.0)
    if steepness > 1e-9:
        angle = min(math.atan(steepness), STEEPEST_RAD)
        s = math.sin(0.5 * angle) / steepness
        turn = (math.cos(0.5 * angle), s * lean_y, -s * lean_x, 0.0)
    x, y, z = rotated(
        turn, position[row, foot, 0] * scale - middle_x, position[row, foot, 1] * scale - middle_y,
        position[row, foot, 2] * scale,
    )  # fmt: skip
    return share, middle_x + x, middle_y + y, height + z - lift.height, turn, rise


@jit
def _on_feet(row, site, legs, reference, lift, pose, rises):
    """Put the feet of a pose on the ground. The pose is in the clip's own coordinates.

    Args:
        row, site, reference, lift: as of ``foot_bearing``.
        legs: of the 1.75 m body.
        pose: to change.
        rises: ``(16,)`` vertical velocities of the links in m/s, to fill.
    """
    scale, position, quat = site.scale, pose.position, pose.quat
    pelvis = (quat[0, 0], quat[0, 1], quat[0, 2], quat[0, 3])
    left = foot_bearing(0, row, site, legs.soles[0], reference, lift)
    right = foot_bearing(1, row, site, legs.soles[1], reference, lift)
    straight = STRAIGHT * scale * (legs.length[0] + legs.length[1])
    drop = 0.0
    for leg in range(2):
        bearing = left if leg == 0 else right
        x, y, z = hip_position(leg, legs, scale, pelvis, position[0])
        reach = max(distance(position[3 + 3 * leg], (x, y, z)), straight)
        across = (bearing[1] - x) ** 2 + (bearing[2] - y) ** 2
        down = math.sqrt(max(reach * reach - across, 0.0))
        drop = max(drop, bearing[0] * (z - bearing[3] - down))
    for link in range(position.shape[0]):
        position[link, 2] -= drop
        rises[link] = lift.rise
    for leg in range(2):
        _, ankle_x, ankle_y, ankle_z, turn, own = left if leg == 0 else right
        hip, link = hip_position(leg, legs, scale, pelvis, position[0]), 3 + 3 * leg
        before = distance(position[link], hip)
        foot = (quat[link, 0], quat[link, 1], quat[link, 2], quat[link, 3])
        goal = FootGoal(hip, (ankle_x, ankle_y, ankle_z), before, turn, foot)
        bend_leg(leg, legs, scale, pelvis, goal, pose)
        # The velocity of a foot is its own, not the pelvis's.
        rises[link] = own
        rises[link - 1] = 0.5 * (own + lift.rise)


@jit
def lift_at(qpos, row, before, site, ground):
    """How the ground under the pelvis moves a clip in a row; ``before`` is the row before it."""
    place, scale = site.place, site.scale
    x, y = placed(place, qpos[row, 0] * scale, qpos[row, 1] * scale)
    lift = ground_at(ground.height, ground.grid, x, y)
    x, y = placed(place, qpos[before, 0] * scale, qpos[before, 1] * scale)
    return Lift(lift, FPS * (lift - ground_at(ground.height, ground.grid, x, y)))


@jit
def place_links(position, place, lift):
    """Move link positions ``(L, 3)`` of a clip to its place in the world, and raise them."""
    for b in range(position.shape[0]):
        x, y = placed(place, position[b, 0], position[b, 1])
        position[b, 0], position[b, 1] = x, y
        position[b, 2] += lift


@jit
def copy_pose(reference, row, scale, pose):
    """Copy a row of the reference, scaled, to a pose."""
    angles, position, quat = pose
    for j in range(angles.shape[0]):
        angles[j] = reference.qpos[row, 7 + j]
    for b in range(position.shape[0]):
        for axis in range(3):
            position[b, axis] = reference.position[row, b, axis] * scale
        for axis in range(4):
            quat[b, axis] = reference.quat[row, b, axis]


@jit
def fill(
    first: int,
    last: int,
    ids: np.ndarray,
    episodes: Episodes,
    offsets: np.ndarray,
    reference: ReferencePoses,
    ground: Ground,
    legs: Legs,
    walking: float,
    target: Target,
) -> None:
    """Fill a ``Target`` of ``ids[first:last]``.

    Args:
        first, last, ids, episodes, ground: as of ``observation_kernel.observe``.
        offsets: ``(k,)`` frames ahead.
        reference: poses of all rows.
        legs: of the 1.75 m body.
        walking: 0 adapts only the feet of a standing user, 1 those of a walking user as well.
        target: to fill.
    """
    level = ground.height.size == 1
    frame, begin, end, place = episodes.frame, episodes.begin, episodes.end, episodes.place
    angles, position, quat, rises = target.angles, target.position, target.quat, target.rise
    qpos = reference.qpos
    for index in range(first, last):
        i = ids[index]
        scale = episodes.ratio[i]
        site = Site(place[i], ground.surface, ground.grid, scale, walking)  # type: ignore[arg-type]
        for k in range(offsets.shape[0]):
            row = min(frame[i] + offsets[k], end[i] - 1)
            before = max(row - 1, begin[i])
            pose = Pose(angles[i, k], position[i, k], quat[i, k])
            copy_pose(reference, row, scale, pose)
            rises[i, k] = 0.0
            lift = 0.0
            if not level:
                lifted = lift_at(qpos, row, before, site, ground)
                lift = lifted.height
                _on_feet(row, site, legs, reference, lifted, pose, rises[i, k])
            place_links(position[i, k], place[i], lift)
