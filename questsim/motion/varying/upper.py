"""Ingredients above the legs: bows, crouches, reaching, the upper body of another clip, lean."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from questsim import rotations as rot
from questsim.body import build_body
from questsim.motion.clip import FPS
from questsim.motion.synthesis import gestures
from questsim.motion.synthesis.plan import smoothstep
from questsim.motion.synthesis.pose import Arm, dof, shoulder_angles, upper_arm
from questsim.motion.synthesis.posture import blend, drift
from questsim.motion.varying.figure import Figure

UPPER = slice(dof("spine_y"), None)
"""Hinges of the trunk, the neck and the arms."""
LEG_M = 0.86
"""Hip to ankle of the default body."""
_OVERHEAD = np.array([0.3, 1.0, -0.3])
"""Direction of the elbow when the hand is above the head."""


@dataclass(frozen=True)
class Timing:
    """When an ingredient acts: from 0 to 1 within ``ease``, held, and back; in seconds."""

    begin: float
    ease: float
    hold: float

    def share(self, time: np.ndarray) -> np.ndarray:
        """``(T,)`` 0 to 1."""
        end = self.begin + 2.0 * self.ease + self.hold
        return smoothstep((time - self.begin) / self.ease) * smoothstep((end - time) / self.ease)


def shares(moments: tuple[Timing, ...], time: np.ndarray) -> np.ndarray:
    """The largest share ``(T,)`` of several moments; 1 throughout if there are none."""
    if not moments:
        return np.ones(len(time))
    return np.max([moment.share(time) for moment in moments], axis=0)


def tilt(figure: Figure, pitch: np.ndarray, roll: np.ndarray) -> None:
    """Turn the pelvis about its heading's axes by ``(T,)`` radians: forward, to the right."""
    turn = Rotation.from_euler("ZYX", np.column_stack([figure.heading, pitch, roll]))
    back = Rotation.from_euler("Z", -figure.heading[:, None])
    figure.pelvis = rot.quat_multiply(rot.as_quat(turn * back), figure.pelvis)


def bow(
    figure: Figure, pitch: np.ndarray, at_hips: float, looking_up: float, arms_hang: float
) -> None:
    """Bend the trunk forward.

    ``solve`` moves the pelvis back to keep the centre of mass in place.

    Args:
        figure: changed in place.
        pitch: ``(T,)`` radians of the chest.
        at_hips: share of it done by the pelvis.
        looking_up: share of it that the neck compensates.
        arms_hang: share of it that the shoulders compensate, so that the arms hang down.
    """
    tilt(figure, at_hips * pitch, np.zeros_like(pitch))
    for hinge in ("spine_y", "chest_y"):
        figure.angles[:, dof(hinge)] += 0.5 * (1.0 - at_hips) * pitch
    figure.angles[:, dof("neck_y")] -= looking_up * pitch
    for side in range(2):
        arm = arm_of(figure, side)
        back = rot.as_quat(Rotation.from_euler("Y", -arms_hang * pitch[:, None]))
        set_arm(figure, side, Arm(rot.quat_multiply(back, arm.upper), arm.elbow, arm.wrist))


def crouch(figure: Figure, depth: np.ndarray, pitch: float) -> None:
    """Lower the root by ``(T,)`` metres; the trunk bows by up to ``pitch`` radians meanwhile."""
    figure.root[:, 2] -= depth
    most = max(float(depth.max()), 1e-6)
    bow(figure, pitch * depth / most, 0.6, 0.6, 0.8)


def arm_of(figure: Figure, side: int) -> Arm:
    """One of the figure's arms."""
    first = dof("left_shoulder_x") + 6 * side
    angles = figure.angles[:, first : first + 6]
    upper = rot.continuous(upper_arm(angles[:, :3], side))
    return Arm(upper, -angles[:, 3], angles[:, 4:])


def set_arm(figure: Figure, side: int, arm: Arm) -> None:
    """Give the figure another arm."""
    first = dof("left_shoulder_x") + 6 * side
    angles = shoulder_angles(arm.upper, side)
    limits = build_body().model.jnt_range[1:][first : first + 3]
    angles -= 2 * np.pi * np.round((np.median(angles, axis=0) - limits.mean(axis=1)) / (2 * np.pi))
    figure.angles[:, first : first + 3] = angles
    figure.angles[:, first + 3] = -arm.elbow
    figure.angles[:, first + 4 : first + 6] = arm.wrist


def reach_about(
    figure: Figure, rng: np.random.Generator, hands: tuple[bool, bool], weight: np.ndarray
) -> None:
    """Move the hands between random points with unhurried minimum-jerk movements.

    Args:
        figure: changed in place.
        rng: of the places.
        hands: whether the left and the right hand take part.
        weight: ``(T,)`` blend from the recorded arms (0) to the reaching ones (1).
    """
    for side in range(2):
        if hands[side]:
            arm = _wandering(figure.time, rng, side)
            set_arm(figure, side, blend(arm_of(figure, side), arm, weight))


def _wandering(time: np.ndarray, rng: np.random.Generator, side: int) -> Arm:
    azimuth, elevation, distance = (
        _keyed(time, rng, *bounds) for bounds in ((-0.5, 1.7), (-1.2, 1.3), (0.5, 0.97))
    )
    level = np.cos(elevation)
    target = distance[:, None] * np.column_stack(
        [level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)]
    )
    # One elbow direction per clip: an elbow that changed it on the way would look broken.
    elbow = gestures.DOWN_OUT if elevation.mean() < 0.3 else _OVERHEAD
    elbow = elbow + rng.normal(0.0, 0.15, 3)
    return gestures.reach(target, side, elbow, rng.uniform(-0.5, 1.2))


def _keyed(time: np.ndarray, rng: np.random.Generator, low: float, high: float) -> np.ndarray:
    """A curve ``(T,)`` that moves between random values and rests at each for a while."""
    out, at = np.full(len(time), rng.uniform(low, high)), -rng.uniform(0.0, 1.0)
    while at < time[-1]:
        value = rng.uniform(low, high)
        takes = rng.uniform(0.5, 1.2) + 0.35 * abs(value - out[-1])
        out += (value - out[-1]) * smoothstep((time - at) / takes)
        # From the next movement on this one is over.
        at += takes + rng.exponential(0.5)
    return out


def look_and_twist(
    figure: Figure, rng: np.random.Generator, trunk: float, gaze: float, weight: np.ndarray
) -> None:
    """Smooth random turns of trunk and neck.

    Args:
        figure: changed in place.
        rng: of the curves.
        trunk: radians to which the trunk twists; bends take half of it.
        gaze: radians to which the neck turns; nods take half of it.
        weight: ``(T,)`` 0 to 1.
    """
    for size, parts in ((trunk, ("spine", "chest")), (gaze, ("neck",))):
        for axis, share in (("z", 1.0), ("x", 0.4), ("y", 0.5)):
            curve = size * share * drift(figure.time, rng, 0.1, 0.5) * weight
            for part in parts:
                figure.angles[:, dof(f"{part}_{axis}")] += curve / len(parts)


def take_upper(figure: Figure, donor: np.ndarray, first: int) -> None:
    """Take trunk, neck and arms of another clip's poses ``(N, 40)`` from frame ``first`` on.

    A clip that is too short is played forwards and backwards.
    """
    frames = first + np.arange(len(figure))
    period = max(2 * (len(donor) - 1), 1)
    folded = np.abs((frames + len(donor) - 1) % period - (len(donor) - 1))
    figure.angles[:, UPPER] = donor[folded, 7:][:, UPPER]


def seconds(figure: Figure) -> float:
    """Length of the figure's motion."""
    return (len(figure) - 1) / FPS
