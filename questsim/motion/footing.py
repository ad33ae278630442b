"""Target positions of the avatar's ankles; floor and soles estimated from a recording.

``retarget`` measures the footing of each motion from that motion; ``retarget_stream`` takes it
from a recording of the same person, as a calibration would.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M
from questsim.body_proportions import Proportions
from questsim.motion.clip import FPS
from questsim.motion.kinematics import sole_points
from questsim.motion.limbs import FLOOR_PERCENTILE, SIDES, ankle_rise, leg_ratio, root_path
from questsim.motion.motion import Motion
from questsim.motion.stance import Soles, lowest_point, measure_soles
from questsim.skeleton import JOINTS

ANKLES = [JOINTS.index(f"{side}_ankle") for side in SIDES]


@dataclass(frozen=True)
class Footing:
    """Heights of floor, ankles and soles in a person's recording, in metres.

    Attributes:
        rise_m: height of the ankle above the sole of the motion's flat foot.
        floor_m: floor height estimated from the lower sole, in the avatar's space.
        soles: tilt and height of each sole over that floor.
    """

    rise_m: float
    floor_m: float
    soles: Soles


def measure_footing(motion: Motion, height: float) -> Footing:
    """The footing of a recording on an avatar of that height.

    Args:
        motion: at any frame rate.
        height: the avatar's stature in metres.
    """
    motion = motion.resampled(FPS)
    position, quat = motion.forward_kinematics()
    rise = ankle_rise(motion, position)
    _, ankles = leg_targets(motion, position, quat, height, rise)
    return footing_of(ankles, quat[:, ANKLES], height, rise)


def footing_of(ankles: np.ndarray, feet: np.ndarray, height: float, rise: float) -> Footing:
    """The footing of ankle targets ``(T, 2, 3)`` and foot orientations ``(T, 2, 4)``."""
    lowest = lowest_point(ankles, feet, height).min(axis=1)
    floor = float(np.percentile(lowest, FLOOR_PERCENTILE))
    flat_ankle = _avatar_rise(height) - floor
    soles = measure_soles(ankles - [0.0, 0.0, floor], feet, height, flat_ankle)
    return Footing(rise, floor, soles)


def _avatar_rise(height: float) -> float:
    """Height of the avatar's ankle above its flat sole."""
    return -float(sole_points()[..., 2].mean()) * height / DEFAULT_HEIGHT_M


def leg_targets(
    motion: Motion,
    position: np.ndarray,
    quat: np.ndarray,
    height: float,
    rise: float,
    proportions: Proportions | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Path of the pelvis ``(T, 3)`` and ankle targets ``(T, 2, 3)``, over the file's floor.

    A motion's ankle may be higher above its sole than the avatar's. The point of the sole below the
    ankle is preserved, so that flat feet stay flat and lifted feet keep their height. The root is
    lowered by the difference of the ankle heights.
    """
    ratio = leg_ratio(motion, height, proportions)
    avatar_rise = _avatar_rise(height)
    root = root_path(motion, position, height, proportions)
    root[:, 2] += avatar_rise - ratio * rise
    up = rot.quat_rotate(quat[:, ANKLES], np.array([0.0, 0.0, 1.0]))
    soles = position[:, ANKLES] - rise * up
    return root, soles * ratio + avatar_rise * up
