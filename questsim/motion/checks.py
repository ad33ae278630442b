"""Checks the units, the up axis, the front and the speed of a recording."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from questsim import rotations as rot
from questsim.errors import InputError
from questsim.motion.motion import Motion, rest_height
from questsim.motion.strides import path_problem
from questsim.skeleton import JOINTS

MIN_STATURE_M, MAX_STATURE_M = 1.2, 2.2
MIN_CHILD_M = 1.0
"""Performers between this and ``MIN_STATURE_M`` are scaled to the smallest avatar."""
LEG_FRACTION = 0.530 - 0.039
ANKLE_TO_HEAD_FRACTION = 0.870 - 0.039
"""Segment lengths as fractions of stature: hip 0.530, ankle 0.039, base of the head 0.870.

Source: Drillis and Contini 1966, as drawn in Winter, "Biomechanics and Motor Control of Human
Movement", 4th ed. 2009, figure 4.1.
"""

SEGMENTS: tuple[tuple[str, str, float, float], ...] = (
    ("neck", "head", 0.081, 1.0),
    ("root", "neck", 0.497, 0.5),
    *(
        (f"{side}_{near}", f"{side}_{far}", mass, centre)
        for side in ("left", "right")
        for near, far, mass, centre in (
            ("shoulder", "elbow", 0.028, 0.436),
            ("elbow", "wrist", 0.022, 0.682),
            ("hip", "knee", 0.100, 0.433),
            ("knee", "ankle", 0.0465, 0.433),
            ("ankle", "toe", 0.0145, 0.5),
        )
    ),
)
"""From joint, to joint, share of the body's mass, centre of mass along the way.

Source: Winter 2009, table 4.1 (after Dempster 1955); forearm and hand are one segment.
"""

FLOOR_TOLERANCE_M = 0.5
FEET_OFF_FLOOR = "the feet are"
"""How the problem of a motion far from the floor begins."""
CLEAR_M = 0.04
MIN_FLIGHT_FRAMES, MAX_FLIGHT_S = 4, 1.5
STANDING_SPEED = 0.4
"""m/s; a foot slower than this for half of a flight is standing on something."""
MIN_FLIGHTS = 3
MIN_RISE_M, MAX_MISFIT, MAX_DISAGREEMENT = 0.01, 0.1, 1.0
"""Of a flight: rise of the centre of mass, its distance from a parabola as a share of the rise,
and how far flights may differ as a share of their median."""
GRAVITY_RANGE = (5.0, 18.0)
"""Accepted range of measured free fall in m/s^2.

In the Bandai-Namco running clips, flights of 4 to 5 frames measure 8.5 to 12.9. A frame rate
wrong by a factor of 1.5 or more leaves this range, since it counts squared.
"""
MIN_UPRIGHT = 0.5
"""Cosine between the vertical and the direction from the feet to the head."""
MAX_ROOT_SPEED = 13.0
"""m/s; no one has run faster."""
START_S, START_SHARE = 0.25, 0.1

MAX_ROOT_TURN = 40.0
"""rad/s of the pelvis; a figure skater's fastest spins are at 36 (340 turns a minute). Of 290 clips
measured, those of Bandai-Namco, DeepMimic and intact ones of CMU stay below 16."""


UNKNOWN_UNITS = "unknown"
WRONG_ANGLES = "the rotations are not as the file declares them"
"""How a problem ends that ``orders.order_problem`` finds."""


@dataclass(frozen=True)
class Report:
    """How a recording was interpreted, and which checks it fails.

    Attributes:
        units, up: of the file, e.g. ``"cm"`` and ``"y"``, each with how it was known.
        fps: frames a second.
        stature_m: the performer's height.
        facing_deg: the mean heading in our axes, 0 along +x, 90 along +y.
        foot_height_m: height of the lowest foot joint.
        gravity: measured free fall in m/s^2; None where no flight was seen.
        problems: one clause for each failed check; empty if all pass.
        notes: what was assumed or changed in reading, one clause each.
        skeleton: the family of the file's skeleton.
        explanation: one line for each joint: its mapping and the reason.
        foot_pitch: the skeleton family's declared pitch of the feet in radians; 0 if unknown.
        lifted_m: how far the motion was raised onto the floor; 0 if it was near it.
    """

    units: str
    up: str
    fps: float
    stature_m: float
    facing_deg: float
    foot_height_m: float
    gravity: float | None
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    skeleton: str = ""
    explanation: tuple[str, ...] = ()
    foot_pitch: float = 0.0
    lifted_m: float = 0.0

    def __str__(self) -> str:
        fall = "no flight" if self.gravity is None else f"free fall {self.gravity:.1f} m/s2"
        skeleton = f"{self.skeleton} skeleton, " if self.skeleton else ""
        return (
            f"{skeleton}units {self.units}, up {self.up}, {self.fps:g} fps ({fall}), "
            f"{self.stature_m:.2f} m tall, faces {self.facing_deg:+.0f} deg, "
            f"feet at {100 * self.foot_height_m:.0f} cm" + "".join(f"; {n}" for n in self.notes)
        )


def stature(motion: Motion) -> float:
    """The performer's height in metres, from bone lengths alone.

    The mean of two estimates, from the legs and from the chain between ankles and head joint.
    Skeletons place head and neck joints too differently to trust the chain alone.
    """
    return stature_of(motion.offsets)


def stature_of(offsets: np.ndarray) -> float:
    """Stature in metres of a skeleton with these offsets ``(22, 3)``."""
    bones = [JOINTS.index(f"{side}_{j}") for side in ("left", "right") for j in ("knee", "ankle")]
    leg = np.linalg.norm(offsets[bones], axis=-1).sum() / 2.0
    return float(leg / LEG_FRACTION + rest_height(offsets) / ANKLE_TO_HEAD_FRACTION) / 2.0


def check(motion: Motion, units: str = "m", up: str = "z") -> Report:
    """Checks a motion against physics and anatomy; ``units`` and ``up`` are only reported."""
    position, quat = motion.forward_kinematics()
    height, gravity = stature(motion), free_fall(motion, position)
    low = float(np.percentile(_feet(position)[..., 2].min(axis=(1, 2)), 2))
    facing = np.exp(1j * rot.heading(quat[:, 0])).mean()
    facing_deg = round(float(np.degrees(np.angle(facing))), 2) + 0.0  # no "-0" in the report
    report = Report(units, up, motion.fps, height, facing_deg, low, gravity)
    return replace(report, problems=tuple(_problems(motion, position, report)))


def refuse(report: Report, where: str) -> None:
    """Raises an InputError that lists all failed checks."""
    if report.problems:
        fix = "declare --units, --up or --fps, or --accept the file as it is"
        if report.problems[0].endswith(WRONG_ANGLES):
            fix = "correct the CHANNELS lines or the angles, or --accept the file as it is"
        raise InputError("; ".join(report.problems), where, fix)


def _problems(motion: Motion, position: np.ndarray, report: Report) -> list[str]:
    out = []
    if not MIN_STATURE_M <= round(report.stature_m, 6) <= MAX_STATURE_M:
        out.append(
            f"the skeleton would be {report.stature_m:.3g} m tall in {report.units}, not "
            f"{MIN_STATURE_M}-{MAX_STATURE_M} m: wrong units"
        )
        return out  # every other length is wrong as well
    if upright_share(position, np.array([0.0, 0.0, 1.0])) < MIN_UPRIGHT:
        out.append(
            f"the performer never stands upright: up is not {report.up}, or the motion only lies "
            "or kneels"
        )
    if abs(report.foot_height_m) > FLOOR_TOLERANCE_M:
        out.append(f"{FEET_OFF_FLOOR} {report.foot_height_m:+.2f} m from the floor at 0")
    if toes_ahead(position) < 0:
        out.append("the toes point backwards: left and right are swapped or an axis is mirrored")
    low, high = GRAVITY_RANGE
    if report.gravity is not None and not low <= report.gravity <= high:
        true = motion.fps * np.sqrt(9.81 / max(report.gravity, 0.1))
        out.append(
            f"free fall measures {report.gravity:.1f} m/s2, not 9.81, at {motion.fps:g} frames a "
            f"second: the true frame rate may be about {true:.0f}"
        )
    if len(motion) > 1:
        speed, _ = _root_speed(motion)
        if speed.max() > MAX_ROOT_SPEED:
            out.append(
                f"the root moves at {speed.max():.0f} m/s at frame {int(speed.argmax())}, "
                f"faster than anyone runs"
            )
    if problem := path_problem(motion, position):
        out.append(problem)
    return out


def jump_at_start(motion: Motion) -> int:
    """How many frames come before the root's last jump, if all jumps are at the very beginning.

    Some programs let the root come from the origin to its place. A later jump is no such start.
    """
    if len(motion) < 2:
        return 0
    speed, over = _root_speed(motion)
    fast = np.flatnonzero(speed > MAX_ROOT_SPEED)
    last = int(fast[-1]) + over if len(fast) else 0
    return last if last <= min(START_S * motion.fps, START_SHARE * len(motion)) else 0


def _root_speed(motion: Motion) -> tuple[np.ndarray, int]:
    """The root's speed in m/s from each frame over a number of frames, and that number.

    Over 0.05 s, so that one noisy frame at a high rate is no reason to refuse a file.
    """
    over = min(max(1, int(0.05 * motion.fps)), len(motion) - 1)
    moved = motion.root_position[over:] - motion.root_position[:-over]
    return np.linalg.norm(moved, axis=-1) * motion.fps / over, over


def jumps(motion: Motion) -> str:
    """Where the pelvis turns faster than anyone can, as in a file with a bad frame; or empty."""
    if len(motion) < 2:
        return ""
    turn = rot.angle_between(motion.rotations[1:, 0], motion.rotations[:-1, 0])
    frames = np.flatnonzero(turn * motion.fps > MAX_ROOT_TURN)
    if not len(frames):
        return ""
    worst = int(turn.argmax())
    what = f"the pelvis turns by {np.degrees(turn[worst]):.0f} deg from frame {worst} to the next"
    return f"{what}: the file jumps" + (f" in {len(frames)} places" if len(frames) > 1 else "")


def upright_share(position: np.ndarray, up: np.ndarray) -> float:
    """Cosine between ``up`` and ankles-to-head in the most upright frames.

    Args:
        position: joints ``(T, 22, 3)``.
        up: a unit vector ``(3,)``.
    """
    ankles = position[:, [JOINTS.index("left_ankle"), JOINTS.index("right_ankle")]].mean(axis=1)
    body = position[:, JOINTS.index("head")] - ankles
    cosine = body @ up / (np.linalg.norm(body, axis=-1) + 1e-12)
    return float(np.percentile(cosine, 95))


def toes_ahead(position: np.ndarray) -> float:
    """Median cosine between ankle-to-toe and the front given by both hips and the head.

    The body's upward direction is that from the ankles to the head, since a runner's trunk may be
    bent far forward. Each foot counts where it is in the lower half of its heights: a foot that
    swings may point down and backwards.
    """

    def at(name: str) -> np.ndarray:
        return position[:, JOINTS.index(name)]

    left = at("left_hip") - at("right_hip")
    up = at("head") - 0.5 * (at("left_ankle") + at("right_ankle"))
    front = np.cross(left, up)
    cosines = []
    for side in ("left", "right"):
        ankle = at(f"{side}_ankle")
        toes = at(f"{side}_toe") - ankle
        norm = np.linalg.norm(front, axis=-1) * np.linalg.norm(toes, axis=-1) + 1e-12
        low = ankle[:, 2] <= np.median(ankle[:, 2])
        cosines.append((np.sum(front * toes, axis=-1) / norm)[low])
    return float(np.median(np.concatenate(cosines)))


def centre_of_mass(position: np.ndarray) -> np.ndarray:
    """The body's centre of mass ``(T, 3)`` of joint positions ``(T, 22, 3)``; see ``SEGMENTS``."""
    total = np.zeros((len(position), 3))
    for near, far, mass, centre in SEGMENTS:
        a, b = position[:, JOINTS.index(near)], position[:, JOINTS.index(far)]
        total += mass * (a + centre * (b - a))
    return total


def free_fall(motion: Motion, position: np.ndarray) -> float | None:
    """Downward acceleration in m/s^2 of the centre of mass in flight; None without flight.

    Flight is where both feet are clearly above their lowest place and both move (a foot that
    stands on a box is above the floor, but does not), and where the centre of mass rises and
    falls along a parabola. The median over the flights is taken, if they agree.
    """
    feet = _feet(position)
    clear = (feet[..., 2] - np.percentile(feet[..., 2], 2, axis=0) > CLEAR_M).all(axis=(1, 2))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], clear.astype(int), [0]])))
    height = centre_of_mass(position)[:, 2]
    measured = []
    for start, end in edges.reshape(-1, 2):
        frames = end - start
        if frames < MIN_FLIGHT_FRAMES or frames / motion.fps > MAX_FLIGHT_S:
            continue
        if np.ptp(feet[start:end], axis=0).max(axis=(1, 2)).min() < CLEAR_M:
            continue
        speed = np.linalg.norm(np.diff(feet[start:end], axis=0), axis=-1) * motion.fps
        if np.median(speed.max(axis=2), axis=0).min() < STANDING_SPEED:
            continue
        times = np.arange(frames) / motion.fps
        curve = np.polyfit(times, height[start:end], 2)
        summit = -curve[1] / (2.0 * curve[0]) if curve[0] else -1.0
        misfit = np.sqrt(np.mean((np.polyval(curve, times) - height[start:end]) ** 2))
        rise = np.ptp(height[start:end])
        if 0.0 < summit < times[-1] and rise > MIN_RISE_M and misfit < MAX_MISFIT * rise:
            measured.append(-2.0 * curve[0])
    if len(measured) < MIN_FLIGHTS or np.ptp(measured) > MAX_DISAGREEMENT * abs(
        np.median(measured)
    ):
        return None
    return float(np.median(measured))


def _feet(position: np.ndarray) -> np.ndarray:
    """Ankle and toe of each foot ``(T, 2, 2, 3)``."""
    names = ("left_ankle", "left_toe", "right_ankle", "right_toe")
    return position[:, [JOINTS.index(n) for n in names]].reshape(-1, 2, 2, 3)
