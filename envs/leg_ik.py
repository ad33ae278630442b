"""Inverse kinematics of a leg of the avatar, compiled: hip, knee and ankle for a given foot.

The leg bends or stretches in its own plane (law of cosines), then turns towards the foot.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from envs.lookups import product
from questsim.body import build_body
from questsim.compiled import jit
from questsim.motion.kinematics import link_offsets, sole_points
from questsim.skeleton import DOFS, LINKS

_LIMIT = 0.9999
"""Share of the leg's length beyond which the distance from hip to ankle no longer determines the
angle of the knee."""


class Legs(NamedTuple):
    """Geometry of the legs of the 1.75 m body.

    Attributes:
        hip: ``(2, 3)`` origin of the thighs in the pelvis.
        length: ``(2,)`` metres of thigh and shin, both along -z.
        soles: ``(2, 4, 3)`` points of the soles in the feet.
        range: ``(33, 2)`` of the hinges in rad.
    """

    hip: np.ndarray
    length: np.ndarray
    soles: np.ndarray
    range: np.ndarray


class Pose(NamedTuple):
    """A pose of the avatar.

    Attributes:
        angles: ``(33,)`` rad; position: ``(16, 3)``, quat: ``(16, 4)`` of the links.
    """

    angles: np.ndarray
    position: np.ndarray
    quat: np.ndarray


class FootGoal(NamedTuple):
    """Where a foot has to be.

    Attributes:
        hip, ankle: target positions.
        before: distance from hip to ankle in the clip.
        turn: rotation of the foot by the ground.
        foot: quaternion of the foot in the clip.
    """

    hip: tuple[float, float, float]
    ankle: tuple[float, float, float]
    before: float
    turn: tuple[float, float, float, float]
    foot: tuple[float, float, float, float]


@lru_cache(maxsize=1)
def legs() -> Legs:
    """The legs of ``assets/mjcf/humanoid.xml``.

    Raises:
        AssertionError: the MJCF's legs have a geometry that the kernel below cannot solve.
    """
    offset = link_offsets()
    for side, first in (("left", 0), ("right", 6)):
        names = tuple(f"{side}_{d}" for d in ("hip_y", "hip_x", "hip_z", "knee_y", "ankle_y"))
        assert DOFS[first : first + 5] == names and DOFS[first + 5] == f"{side}_ankle_x"
    assert LINKS[1:7] == tuple(
        f"{side}_{part}" for side in ("left", "right") for part in ("thigh", "shin", "foot")
    )
    assert not offset[[2, 3, 5, 6], :2].any() and np.allclose(offset[[2, 3]], offset[[5, 6]])
    model = build_body().model
    return Legs(
        hip=offset[[1, 4]],
        length=-offset[[2, 3], 2],
        soles=sole_points(),
        range=np.array([model.joint(name).range for name in DOFS]),
    )


@jit
def rotated(q, x, y, z):
    """A vector turned by a quaternion."""
    tx = 2.0 * (q[2] * z - q[3] * y)
    ty = 2.0 * (q[3] * x - q[1] * z)
    tz = 2.0 * (q[1] * y - q[2] * x)
    return (
        x + q[0] * tx + q[2] * tz - q[3] * ty,
        y + q[0] * ty + q[3] * tx - q[1] * tz,
        z + q[0] * tz + q[1] * ty - q[2] * tx,
    )


@jit
def _about(axis, angle):
    """Quaternion of a rotation about axis 0, 1 or 2."""
    s = math.sin(0.5 * angle)
    return (
        math.cos(0.5 * angle),
        s if axis == 0 else 0.0,
        s if axis == 1 else 0.0,
        s if axis == 2 else 0.0,
    )


@jit
def _between(ax, ay, az, bx, by, bz):
    """Quaternion of the shortest rotation between two directions that are not opposite."""
    norm = math.sqrt((ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz))
    w = norm + ax * bx + ay * by + az * bz
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if length < 1e-12:
        return 1.0, 0.0, 0.0, 0.0
    return w / length, x / length, y / length, z / length


@jit
def _angles_yxz(q):
    """Angles about y, x and z, in this order, of a quaternion."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    about_x = math.asin(min(max(2.0 * (w * x - y * z), -1.0), 1.0))
    about_y = math.atan2(2.0 * (x * z + w * y), 1.0 - 2.0 * (x * x + y * y))
    about_z = math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z))
    return about_y, about_x, about_z


@jit
def _knee_turn(before, after, thigh, shin):
    """Change of the knee's angle for a change of the distance from hip to ankle."""
    most = _LIMIT * (thigh + shin)
    least = abs(thigh - shin) + 1e-3
    turn = 0.0
    for distance, sign in ((before, 1.0), (after, -1.0)):
        d = min(max(distance, least), most)
        turn += sign * math.acos((thigh * thigh + shin * shin - d * d) / (2.0 * thigh * shin))
    return turn


@jit
def _thigh(pelvis, angles, first):
    """A thigh's orientation by the three hinges from ``first`` on."""
    turn = product(_about(1, angles[first]), _about(0, angles[first + 1]))
    return product(pelvis, product(turn, _about(2, angles[first + 2])))


@jit
def _within(legs, hinge, angle):
    """An angle kept within a hinge's range."""
    return min(max(angle, legs.range[hinge, 0]), legs.range[hinge, 1])


@jit
def _seen_by(p, q):
    """The quaternion q relative to p."""
    return product((p[0], -p[1], -p[2], -p[3]), q)


@jit
def hip_position(leg, legs, scale, pelvis, place):
    """Position of a hip for a pelvis at ``place``."""
    x, y, z = rotated(pelvis, legs.hip[leg, 0], legs.hip[leg, 1], legs.hip[leg, 2])
    return place[0] + scale * x, place[1] + scale * y, place[2] + scale * z


@jit
def distance(a, b):
    """Distance of two points."""
    return math.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@jit
def bend_leg(leg, legs, scale, pelvis, goal, pose):
    """Solve a leg and write its hinges, places and orientations.

    Args:
        leg: 0 or 1.
        legs: of the 1.75 m body.
        scale: of the body.
        pelvis: quaternion.
        goal: ``FootGoal``.
        pose: ``Pose`` of the clip, to change.
    """
    hip, ankle, before, turn, foot = goal
    angles, position, quat = pose
    first, link = 6 * leg, 1 + 3 * leg
    thigh, shin = legs.length[0] * scale, legs.length[1] * scale
    knee = angles[first + 3] + _knee_turn(before, distance(ankle, hip), thigh, shin)
    knee = _within(legs, first + 3, knee)
    upper = _thigh(pelvis, angles, first)
    x, y, z = rotated(_about(1, knee), 0.0, 0.0, -shin)
    x, y, z = rotated(upper, x, y, z - thigh)
    turned = _between(x, y, z, ankle[0] - hip[0], ankle[1] - hip[1], ankle[2] - hip[2])
    hip_y, hip_x, hip_z = _angles_yxz(_seen_by(pelvis, product(turned, upper)))
    angles[first] = _within(legs, first, hip_y)
    angles[first + 1] = _within(legs, first + 1, hip_x)
    angles[first + 2] = _within(legs, first + 2, hip_z)
    angles[first + 3] = knee
    upper = _thigh(pelvis, angles, first)
    lower = product(upper, _about(1, knee))
    ankle_y, ankle_x, _ = _angles_yxz(_seen_by(lower, product(turn, foot)))
    angles[first + 4] = _within(legs, first + 4, ankle_y)
    angles[first + 5] = _within(legs, first + 5, ankle_x)
    sole = product(product(lower, _about(1, angles[first + 4])), _about(0, angles[first + 5]))
    x, y, z = rotated(upper, 0.0, 0.0, -thigh)
    knee_at = (hip[0] + x, hip[1] + y, hip[2] + z)
    x, y, z = rotated(lower, 0.0, 0.0, -shin)
    for k in range(3):
        position[link, k], position[link + 1, k] = hip[k], knee_at[k]
    position[link + 2, 0] = knee_at[0] + x
    position[link + 2, 1] = knee_at[1] + y
    position[link + 2, 2] = knee_at[2] + z
    for k in range(4):
        quat[link, k], quat[link + 1, k], quat[link + 2, k] = upper[k], lower[k], sole[k]
