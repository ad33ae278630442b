"""Checks that rotations are in the order that a file declares, also of people who stay in place.

With the right order the lower foot stays at one height, that of the floor, and feet that bear the
body stand still. With another order the turns of hips, knees and ankles do not match, and the feet
drift, float and sink. Where the legs show nothing, the shoulders may: in poses in which the angles
of the right order jump (gimbal lock), only the right order turns smoothly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from questsim import rotations as rot
from questsim.motion.checks import WRONG_ANGLES
from questsim.motion.convert import axis_vector, global_pose
from questsim.motion.families import Family
from questsim.motion.recording import Recording
from questsim.motion.strides import FEET, MIN_S, OVER_S

MAX_FRAMES = 600
SHOULDERS = ("left_shoulder", "right_shoulder")
BODY = ("root", "left_hip", "left_knee", "head")
UPRIGHT = 1.1
"""Leg lengths of the head above the feet."""
SLIDE, STEP, SPREAD = 0.02, 0.02, 0.01
"""What even a perfect file has: leg lengths a second of the slower foot and of both feet, and leg
lengths of the lower foot's height. Without them, noise would decide between two good orders."""
MUCH_BETTER = 0.6
"""Another order is right if it has less than this share of the declared order's product of slide,
step and spread. In 271 true files, the best of the five wrong orders comes to 0.92 at the least."""
MAX_SLIDE = 3.0
"""Leg lengths a second with the right order; in the true files, runs included, at most 2.3."""
SMOOTHER = 0.85
"""Another order is right if the shoulders' mean angular acceleration is below this share of the
declared one; in those true files no other order comes below 0.99."""
AT_POLE = 2.0
"""In poses of gimbal lock, angles of the right order change faster by more than this factor."""
RESTS = 1e-3
"""Radians from frame to frame, added to that acceleration: noise of shoulders that hardly move."""
SLIDES, TRAVELS = 0.2, 0.25
"""Leg lengths a second of the slower foot, and of the root, from which other scales are tried: in
someone who stays in place half the angles always look steadier."""
MUCH_SLOWER = 0.4
"""Another scale is right if the feet slide by less than this share."""


@dataclass(frozen=True)
class _Feet:
    """How the feet move, in leg lengths and leg lengths a second.

    Attributes:
        slide: median speed of the slowest point of both feet.
        step: median of the mean speed of both feet, each that of its slowest point.
        spread: height of the lowest point, from its 10th to its 90th percentile.
        travel: median speed of the root.
        leg: leg length in the file's units.
        upright: whether the head is above the feet.
    """

    slide: float
    step: float
    spread: float
    travel: float
    leg: float
    upright: bool

    @property
    def unsteady(self) -> float:
        """Small if the feet stand on one floor."""
        return (self.slide + SLIDE) * (self.step + STEP) * (self.spread + SPREAD)


def order_problem(recording: Recording, family: Family, ups: Sequence[str], metres: float) -> str:
    """Says that the feet would stand with another order or scale of the rotations; empty if not.

    Args:
        recording: the motion on its own joints.
        family: the mapping of its joints.
        ups: the file's up axis, and others that it may have if wrong angles hid it.
        metres: per file unit.
    """
    few = _some_joints(recording, family)
    declared_order = _order(few)
    if not declared_order or len(recording.positions) < MIN_S * recording.fps:
        return ""
    angles = rot.as_rotation(few.rotations).as_euler(declared_order)  # in gimbal lock any will do
    orders = [o for p in permutations("XYZ") if (o := "".join(p)) != declared_order]
    others = {order: _turned(few, order, angles) for order in orders}
    declared = _feet(few, family, ups[:1])
    problem = _steadier(declared, others, family, ups, metres)
    problem = problem or _smoother(few, others, family, angles)
    if problem or declared.slide < SLIDES or declared.travel < TRAVELS:
        return problem
    for what, scale in (("with angles twice as large", 2.0), ("with half the angles", 0.5)):
        other = _feet(_turned(few, declared_order, angles * scale), family, ups[:1])
        if other.upright and other.slide < MUCH_SLOWER * declared.slide:
            return _said(declared, other, what, metres)
    return ""


def _steadier(
    declared: _Feet,
    others: dict[str, Recording],
    family: Family,
    ups: Sequence[str],
    metres: float,
) -> str:
    """Says that the feet stand much better with another order; empty if not."""
    if declared.unsteady * MUCH_BETTER < SLIDE * STEP * SPREAD:
        return ""  # nothing can be so much better
    found = {order: _feet(other, family, ups) for order, other in others.items()}
    if not any(_clearly_steadier(feet, declared) for feet in found.values()):
        return ""
    stand = [order for order, feet in found.items() if feet.upright and feet.slide < MAX_SLIDE]
    best = min(stand, key=lambda order: found[order].unsteady)
    return _said(declared, found[best], f"with channels in the order {best}", metres)


def _clearly_steadier(found: _Feet, declared: _Feet) -> bool:
    """Whether the feet stand much better, and better in each respect.

    In a walk on the spot, as on a treadmill, orders that hardly move the legs slide less, but the
    lower foot leaves the floor.
    """
    better = found.slide < declared.slide and found.spread < declared.spread
    much = found.unsteady < MUCH_BETTER * declared.unsteady
    return found.upright and found.slide < MAX_SLIDE and better and much


def _smoother(
    declared: Recording, others: dict[str, Recording], family: Family, angles: np.ndarray
) -> str:
    """Says that the shoulders turn much more smoothly with another order; empty if not.

    Args:
        declared: the motion in the order that the file declares.
        others: in the other orders.
        family: the mapping of its joints.
        angles: ``(T * J, 3)`` of the rotation channels.
    """
    rough = {order: _roughness(other, family) for order, other in others.items()}
    best = min(rough, key=lambda order: rough[order])
    share = rough[best] / _roughness(declared, family)
    if share > SMOOTHER or not _passes_pole(others[best], family, angles):
        return ""
    return (
        f"the shoulders jerk, but with channels in the order {best} they would by only "
        f"{100 * share:.0f} % as much: {WRONG_ANGLES}"
    )


def _passes_pole(recording: Recording, family: Family, angles: np.ndarray) -> bool:
    """Whether angles of the shoulders change much faster than the shoulders turn.

    If they do not, as in keyed animation, another order turns more smoothly by chance.
    """
    joints = _shoulders(recording, family)
    steps = np.diff(angles.reshape(len(recording.rotations), -1, 3)[:, joints], axis=0)
    largest = abs((steps + np.pi) % (2.0 * np.pi) - np.pi).max()
    turns = recording.rotations[:, joints]
    return bool(largest > AT_POLE * rot.angle_between(turns[1:], turns[:-1]).max())


def _shoulders(recording: Recording, family: Family) -> list[int]:
    return [recording.names.index(family.joints[joint]) for joint in SHOULDERS]


def _roughness(recording: Recording, family: Family) -> float:
    """Mean change of the shoulders' turn from frame to frame, in radians."""
    turns = recording.rotations[:, _shoulders(recording, family)]
    steps = rot.quat_multiply(rot.quat_conjugate(turns[:-1]), turns[1:])
    return float(rot.angle_between(steps[1:], steps[:-1]).mean()) + RESTS


def _said(declared: _Feet, other: _Feet, what: str, metres: float) -> str:
    speed, apart = declared.leg * metres, 100.0 * declared.leg * metres
    return (
        f"the feet slide at {declared.slide * speed:.2f} m/s and rise and sink by "
        f"{declared.spread * apart:.1f} cm, but {what} they would slide at "
        f"{other.slide * speed:.2f} m/s and rise and sink by {other.spread * apart:.1f} cm: "
        f"{WRONG_ANGLES}"
    )


def _order(recording: Recording) -> str:
    """The order of all joints with three rotation channels; empty if they differ or there is none.

    Joints that turn about fewer axes, such as knees, have the same angles in any order.
    """
    orders = {
        order for name in recording.names if len(order := recording.orders.get(name, "")) == 3
    }
    return orders.pop() if len(orders) == 1 else ""


def _turned(recording: Recording, order: str, angles: np.ndarray) -> Recording:
    turns = rot.from_euler(order, angles)
    return replace(recording, rotations=rot.as_quat(turns, recording.rotations.shape[:2]))


def _some_joints(recording: Recording, family: Family) -> Recording:
    """The frames in the middle, with the joints from the root to feet, head and shoulders only."""
    start = max(0, (len(recording.positions) - MAX_FRAMES) // 2)
    ends = [family.joints[joint] for joint in (*BODY, *SHOULDERS, *_feet_of(family))]
    kept: set[int] = set()
    for joint in map(recording.names.index, ends):
        while joint >= 0 and joint not in kept:
            kept.add(joint)
            joint = int(recording.parents[joint])
    joints = sorted(kept)
    at = {joint: row for row, joint in enumerate(joints)} | {-1: -1}
    return replace(
        recording,
        names=tuple(recording.names[joint] for joint in joints),
        parents=np.array([at[int(recording.parents[joint])] for joint in joints]),
        positions=recording.positions[start : start + MAX_FRAMES, joints],
        rotations=recording.rotations[start : start + MAX_FRAMES, joints],
        tips={},
    )


def _feet_of(family: Family) -> Sequence[str]:
    return [joint for joint in FEET if joint in family.joints]


def _feet(recording: Recording, family: Family, ups: Sequence[str]) -> _Feet:
    """How the feet move on a floor across that axis of ``ups`` along which the head is highest."""
    position, _ = global_pose(recording)

    def at(joint: str) -> np.ndarray:
        return position[:, recording.names.index(family.joints[joint])]

    names = _feet_of(family)
    feet = np.stack([at(joint) for joint in names], axis=1)
    body = np.median(at("head") - feet.mean(axis=1), axis=0)
    vertical = max((axis_vector(up) for up in ups), key=lambda axis: float(axis @ body))
    leg = max(
        2.0 * float(np.median(np.linalg.norm(at("left_knee") - at("left_hip"), axis=-1))), 1e-9
    )
    over = max(1, round(OVER_S * recording.fps))

    def speed(place: np.ndarray) -> np.ndarray:
        return np.linalg.norm(place[over:] - place[:-over], axis=-1) * (recording.fps / over / leg)

    speeds = speed(feet)
    sides = [[n for n, name in enumerate(names) if name.startswith(s)] for s in ("left", "right")]
    each = np.stack([speeds[:, side].min(axis=1) for side in sides])
    low, high = np.percentile((feet @ vertical).min(axis=1), [10, 90])
    return _Feet(
        slide=float(np.median(each.min(axis=0))),
        step=float(np.median(each.mean(axis=0))),
        spread=float(high - low) / leg,
        travel=float(np.median(speed(at("root")))),
        leg=leg,
        upright=bool(body @ vertical > UPRIGHT * leg),
    )
