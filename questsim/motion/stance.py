"""Stance feet: estimate a motion's soles while they are still, and put them on the floor.

A skeleton has ankles but no soles, and the floor of a capture is a few centimetres off. So a file's
feet may float, lean or differ from each other, and a simulated avatar cannot follow them.
``measure_soles`` estimates each foot's pitch, roll and height over the floor from its stances;
``plant`` subtracts these and puts stance feet on the floor. A foot that rolls keeps its pitch.
Between stances the corrections are interpolated linearly, which leaves the acceleration of flight
as it is. Ground that is not flat (stairs, ramps) and files whose feet stand already are left alone.

All of it is in the avatar's space: ankle targets ``(T, 2, 3)`` and foot orientations ``(T, 2, 4)``,
left before right, 36 Hz, z up.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import binary_closing, binary_opening, gaussian_filter1d, maximum_filter1d

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M
from questsim.motion.clip import FPS
from questsim.motion.kinematics import central_difference, sole_positions

STILL_M_S = 0.25
"""A foot whose sole's centre is slower is still."""
SLOW_M_S, MIN_STILL_SHARE = 0.8, 0.2
"""A slow foot may bear while it rolls; it counts as still in files with fewer still frames."""
TOUCH_M = 0.03
"""A slow foot this near the floor bears where no foot is still."""
MIN_STILL_FRAMES = 3
"""A stance lasts as long at least; the top of a jump is below ``STILL_M_S`` for two frames."""
STAND_MEAN_M, STAND_P90_M, STAND_TILT_M = 0.006, 0.015, 0.02
"""Feet stand already if still soles are this near the floor (mean and 90th percentile) and their
highest point is no further above the lowest (median); of the default body."""
ON_FLOOR_M = 0.06
"""Still soles this near a foot's usual level are on the floor; others are in the air, on things."""
MIN_ON_FLOOR, MAX_BELOW = 0.6, 0.05
"""The ground is flat if at least this share of still frames is on the floor, and no more below it
with a foot that does not stand on tiptoe."""
MAX_SLOPE, MIN_RISE_M, MIN_WAY_M = np.tan(np.radians(3.5)), 0.04, 1.5
"""A floor that is steeper is a ramp, not an error of the capture's floor; one that rises by less
in all, or whose stances lie closer together, is taken to be flat."""
MAX_PITCH, MAX_ROLL = np.radians(20.0), np.radians(25.0)
"""Feet that lean more do so on purpose (tiptoes): then nothing is known of the sole."""
FLAT_PITCH, FLAT_ROLL = np.radians([5.0, 12.0]), np.radians([8.0, 20.0])
"""A still foot is turned flat up to the first angle, left alone from the second on."""
STEEP_PITCH, MAX_FLAT_PITCH, LOW_ANKLE_M = np.radians(12.0), np.radians(40.0), (0.035, 0.05)
"""A still sole leans by more than the first angle, less than the second, but its ankle is as low as
that of a flat foot: then the sole is flat, and the file's foot is turned. The ankle is low up to
the first height over that of a flat foot, and not from the second on; of the default body."""
LONGEST_GLIDE_S = 0.3
"""No flight lasts as long with a sole within ``ON_FLOOR_M``: the lower foot bears, however fast."""
SMOOTH_FRAMES, ROOT_SMOOTH_FRAMES = 1.0, 4.0
"""Standard deviations in frames of the filters over corrections of feet and root."""
MAX_REACH = 0.998
"""A stance leg is stretched to this share of its length at most; the root sinks for the rest."""


@dataclass(frozen=True)
class Soles:
    """How the feet of one file lie when they stand.

    Attributes:
        turn: ``(2, 4)`` from each foot's own axes to those of its flat sole.
        level_m: ``(2,)`` height of each sole's lowest point while it stands.
        slope: ``(2,)`` the file's floor rises by as much per metre along x and y.
        flat: whether feet are to be planted: the ground is flat, and they do not stand already.
        low_ankle_m: height of a flat foot's ankle, where that and not the foot's angle shows which
            still feet are flat; else -inf.
    """

    turn: np.ndarray = field(default_factory=lambda: np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)))
    level_m: np.ndarray = field(default_factory=lambda: np.zeros(2))
    slope: np.ndarray = field(default_factory=lambda: np.zeros(2))
    flat: bool = False
    low_ankle_m: float = -np.inf


def still_feet(
    ankles: np.ndarray, feet: np.ndarray, height: float, speed_m_s: float = STILL_M_S
) -> np.ndarray:
    """``(T, 2)`` bool: the centre of the sole is slower than ``speed_m_s`` for long enough."""
    if len(ankles) < MIN_STILL_FRAMES:
        return np.zeros(ankles.shape[:2], bool)
    centre = sole_positions(ankles, feet, height).mean(axis=-2)
    still = np.linalg.norm(central_difference(centre), axis=-1) < speed_m_s
    window = np.ones((MIN_STILL_FRAMES, 1), bool)
    return binary_opening(np.asarray(binary_closing(still, window) | still), window)


def lean(feet: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Yaw, pitch (toes down) and roll ``(...)`` in radians of feet ``(..., 4)``."""
    forward = rot.quat_rotate(feet, np.array([1.0, 0.0, 0.0]))
    left = rot.quat_rotate(feet, np.array([0.0, 1.0, 0.0]))
    up = rot.quat_rotate(feet, np.array([0.0, 0.0, 1.0]))
    yaw = np.arctan2(forward[..., 1], forward[..., 0])
    pitch = -np.arcsin(np.clip(forward[..., 2], -1.0, 1.0))
    return yaw, pitch, np.arctan2(left[..., 2], up[..., 2])


def from_lean(yaw: np.ndarray, pitch: np.ndarray, roll: np.ndarray) -> np.ndarray:
    """Feet ``(..., 4)`` of their yaw, pitch and roll: the inverse of ``lean``."""
    zero = np.zeros_like(pitch)
    about_y = np.stack([np.cos(pitch / 2), zero, np.sin(pitch / 2), zero], axis=-1)
    about_x = np.stack([np.cos(roll / 2), np.sin(roll / 2), zero, zero], axis=-1)
    return rot.quat_multiply(rot.yaw_quat(yaw), rot.quat_multiply(about_y, about_x))


def usual_lean(
    pitch: np.ndarray, roll: np.ndarray, still: np.ndarray, max_pitch: float = MAX_PITCH
) -> np.ndarray:
    """``(2, 2)`` each foot's usual pitch and roll while it stands, 0 where that is not known.

    Of ``lean`` ``(T, 2)`` in the frames ``still`` ``(T, 2)``: the median, and that of the frames
    near it, so that heel strike and toe-off do not count. A foot that is never still is taken to be
    the other one in the mirror.
    """
    out = np.full((2, 2), np.nan)
    for foot in range(2):
        both = np.stack([angle[still[:, foot], foot] for angle in (pitch, roll)])
        if both.shape[1] < 2 * MIN_STILL_FRAMES:
            continue
        middle = np.median(both, axis=1, keepdims=True)
        near = (np.abs(both - middle) < FLAT_ROLL[0]).all(axis=0)
        found = np.median(both[:, near], axis=1) if near.any() else middle[:, 0]
        if (np.abs(found) < [max_pitch, MAX_ROLL]).all():
            out[foot] = found
    for foot in range(2):
        if np.isnan(out[foot]).any():
            out[foot] = out[1 - foot] * [1.0, -1.0]
    return np.nan_to_num(out)


def measure_soles(
    ankles: np.ndarray, feet: np.ndarray, height: float, flat_ankle_m: float = -np.inf
) -> Soles:
    """Estimate each foot's sole from the frames in which it is still.

    Args:
        ankles, feet: targets ``(T, 2, 3 | 4)``.
        height: the avatar's stature in metres.
        flat_ankle_m: height of a flat foot's ankle over the file's own floor, in the same space.
    """
    ratio = height / DEFAULT_HEIGHT_M
    still = still_feet(ankles, feet, height)
    low = still & (ankles[..., 2] < flat_ankle_m + LOW_ANKLE_M[0] * ratio)
    _, pitch, roll = lean(feet)
    leans, low_ankle_m = usual_lean(pitch, roll, low, MAX_FLAT_PITCH), flat_ankle_m
    if np.abs(leans[:, 0]).max() < STEEP_PITCH or 2 * low.sum() < still.sum():
        leans, low_ankle_m = usual_lean(pitch, roll, still), -np.inf
    turn = rot.quat_conjugate(from_lean(np.zeros(2), leans[:, 0], leans[:, 1]))
    # Who runs or slides all the time has hardly a still foot: the heights of slow feet must do.
    if still.any(axis=1).mean() < MIN_STILL_SHARE:
        still = still_feet(ankles, feet, height, SLOW_M_S)
    if not still.any() or _stand_already(ankles, feet, still, ratio):
        return Soles()
    lowest = lowest_point(ankles, rot.quat_multiply(feet, turn), height)
    near = ON_FLOOR_M * ratio
    slope = _slope(ankles, lowest, still, ratio)
    if slope is None:
        return Soles()
    lowest = lowest - ankles[..., :2] @ slope
    level = _levels(lowest, still, near)
    away = lowest - level
    if (np.abs(away[still]) < near).mean() < MIN_ON_FLOOR:
        return Soles()
    # On tiptoe the toes of a stiff sole sink into level ground.
    _, pitch, roll = lean(rot.quat_multiply(feet, turn))
    level_feet = still & (np.abs(pitch) < MAX_PITCH) & (np.abs(roll) < MAX_ROLL)
    if (away[level_feet] < -near).sum() > MAX_BELOW * still.sum():
        return Soles()
    return Soles(turn, level, slope, flat=True, low_ankle_m=low_ankle_m)


def _stand_already(ankles: np.ndarray, feet: np.ndarray, still: np.ndarray, ratio: float) -> bool:
    soles = sole_positions(ankles, feet, ratio * DEFAULT_HEIGHT_M)[still][..., 2] / ratio
    off = np.abs(soles.min(axis=-1))
    return bool(
        off.mean() < STAND_MEAN_M
        and np.percentile(off, 90) < STAND_P90_M
        and np.median(np.ptp(soles, axis=-1)) < STAND_TILT_M
    )


def lowest_point(ankles: np.ndarray, feet: np.ndarray, height: float) -> np.ndarray:
    """Height ``(T, 2)`` of each sole's lowest point."""
    return sole_positions(ankles, feet, height)[..., 2].min(axis=-1)


def _levels(lowest: np.ndarray, still: np.ndarray, near: float) -> np.ndarray:
    """``(2,)`` the height at which each foot stands most of the time.

    Two feet that differ by more than ``near`` stand on different things: then both get the lower.
    """
    level = np.full(2, np.nan)
    for foot in range(2):
        heights = np.sort(lowest[still[:, foot], foot])
        if len(heights):
            # The window of width `near` with most frames in it; the lowest of equals.
            count = np.searchsorted(heights, heights + near, side="right") - np.arange(len(heights))
            first = int(count.argmax())
            level[foot] = np.median(heights[first : first + count[first]])
    level = np.where(np.isnan(level), level[::-1], level)
    return level if np.ptp(level) < near else np.full(2, level.min())


def _slope(
    ankles: np.ndarray, lowest: np.ndarray, still: np.ndarray, ratio: float
) -> np.ndarray | None:
    """Rise of the file's floor ``(2,)`` per metre along x and y; None for a ramp.

    Only where the stances lie on one plane well: steps do not.
    """
    frames, foot = np.nonzero(still)
    place = ankles[frames, foot, :2]
    place = place - place.mean(axis=0)
    _, _, axes = np.linalg.svd(place, full_matrices=False)
    along = place @ axes[0]
    # Each foot has a height of its own.
    table = np.concatenate([along[:, None], np.eye(2)[foot]], axis=1)
    line, *_ = np.linalg.lstsq(table, lowest[still], rcond=None)
    left_over = (lowest[still] - table @ line).std()
    way = np.ptp(along)
    rise = abs(line[0]) * way
    if way < MIN_WAY_M or rise < MIN_RISE_M * ratio or left_over > rise / 5.0:
        return np.zeros(2)
    return line[0] * axes[0] if abs(line[0]) < MAX_SLOPE else None


def plant(
    soles: Soles, ankles: np.ndarray, feet: np.ndarray, height: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Put stance feet on the floor.

    Returns:
        ankle targets ``(T, 2, 3)`` and foot orientations ``(T, 2, 4)``, by how much the root
        rises ``(T,)``, and which feet stand ``(T, 2)``.
    """
    ratio = height / DEFAULT_HEIGHT_M
    still, slow = (still_feet(ankles, feet, height, v) for v in (STILL_M_S, SLOW_M_S))
    feet = rot.quat_multiply(feet, soles.turn)
    floor = soles.level_m + ankles[..., :2] @ soles.slope
    away = lowest_point(ankles, feet, height) - floor
    stands = still & (np.abs(away) < ON_FLOOR_M * ratio)
    low = low_ankles(soles, ankles, ratio)
    feet = _flattened(feet, stands, low)
    away = lowest_point(ankles, feet, height) - floor
    rise = np.stack([_between(-away[:, f], stands[:, f], 0.0) for f in range(2)], axis=1)
    # Heel strike, toe-off and feet that slide: where no foot stands, a slow and low one bears.
    left_over = away + rise
    bears = slow & (left_over < TOUCH_M * ratio) & ~stands.any(axis=1, keepdims=True)
    bears &= left_over <= left_over.min(axis=1, keepdims=True)
    stands |= bears
    stands |= _glides(left_over, stands, ON_FLOOR_M * ratio)
    rise = np.stack([_between(-away[:, f], stands[:, f], SMOOTH_FRAMES) for f in range(2)], axis=1)
    rise -= floor
    count = stands.sum(axis=1)
    mean = (rise * stands).sum(axis=1) / np.maximum(count, 1)
    root = _between(mean, count > 0, ROOT_SMOOTH_FRAMES)
    ankles = ankles.copy()
    ankles[..., 2] += rise
    return ankles, feet, root, stands


def _glides(away: np.ndarray, stands: np.ndarray, near: float) -> np.ndarray:
    """Which lower feet ``(T, 2)`` bear although they glide: none stands, and this is no flight."""
    lowest = away.min(axis=1, keepdims=True)
    glides = (lowest[:, 0] < near) & ~stands.any(axis=1)
    glides = binary_opening(glides, np.ones(int(LONGEST_GLIDE_S * FPS), bool))
    return glides[:, None] & (away <= lowest)


def low_ankles(soles: Soles, ankles: np.ndarray, ratio: float) -> np.ndarray:
    """How surely ``(..., 2)``, 0 to 1, a still foot is flat by the height of its ankle."""
    return _fade(ankles[..., 2] - soles.low_ankle_m, np.array(LOW_ANKLE_M) * ratio)


def _flattened(feet: np.ndarray, stands: np.ndarray, low: np.ndarray) -> np.ndarray:
    """Standing feet turned flat, as far as they do not roll or lean on purpose."""
    yaw, pitch, roll = lean(feet)
    pitch_turn, roll_turn = flat_turn(pitch, roll, stands, low)
    return from_lean(yaw, pitch - smoothed(pitch_turn), roll - smoothed(roll_turn))


def smoothed(values: np.ndarray) -> np.ndarray:
    """A correction ``(T, ...)`` blended in and out."""
    return gaussian_filter1d(values, SMOOTH_FRAMES, axis=0, mode="nearest")


def flat_turn(
    pitch: np.ndarray, roll: np.ndarray, stands: np.ndarray, low: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which part of its pitch and of its roll, in radians, is taken off each foot ``(..., 2)``."""
    return (
        np.where(stands, np.maximum(_fade(np.abs(pitch), FLAT_PITCH), low) * pitch, 0.0),
        np.where(stands, _fade(np.abs(roll), FLAT_ROLL) * roll, 0.0),
    )


def _fade(angle: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """1 up to the first of two ends, 0 from the second on, smooth between."""
    share = np.clip((ends[1] - angle) / (ends[1] - ends[0]), 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


def _between(values: np.ndarray, known: np.ndarray, frames: float) -> np.ndarray:
    """Values ``(T,)`` where known, straight lines between, then smoothed."""
    if not known.any():
        return np.zeros(len(values))
    at = np.flatnonzero(known)
    lines = np.interp(np.arange(len(values)), at, values[at])
    return gaussian_filter1d(lines, frames, mode="nearest") if frames else lines


def sink_for_reach(
    hips: np.ndarray, ankles: np.ndarray, stands: np.ndarray, leg_m: float
) -> np.ndarray:
    """Metres ``(T,)`` by which the root must sink for stance legs to reach their ankles.

    Args:
        hips, ankles: ``(T, 2, 3)``.
        stands: ``(T, 2)``.
        leg_m: length of a stretched leg.
    """
    lacking = lacking_reach(hips, ankles, stands, leg_m)
    # The maximum first, so that the smooth curve stays above nearly all of the missing height.
    width = int(2 * ROOT_SMOOTH_FRAMES) + 1
    return gaussian_filter1d(
        maximum_filter1d(lacking, width, mode="nearest"), ROOT_SMOOTH_FRAMES, mode="nearest"
    )


def lacking_reach(
    hips: np.ndarray, ankles: np.ndarray, stands: np.ndarray, leg_m: float
) -> np.ndarray:
    """Metres ``(...)`` that stretched stance legs lack, as ``sink_for_reach`` has them."""
    across = np.linalg.norm(hips[..., :2] - ankles[..., :2], axis=-1)
    highest = np.sqrt(np.maximum((MAX_REACH * leg_m) ** 2 - across**2, 0.0))
    lacking = np.clip(hips[..., 2] - ankles[..., 2] - highest, 0.0, ON_FLOOR_M)
    return np.where(stands, lacking, 0.0).max(axis=-1)
