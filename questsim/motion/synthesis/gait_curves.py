"""Published data on walking and jogging, as curves and relations.

Joint angles over a stride are control points in degrees at percent of the stride (0 at the
foot's own touch-down), joined by a periodic cubic spline. They are means of healthy adults,
rounded to whole degrees:

* walking at natural cadence: Winter, "The Biomechanics and Motor Control of Human Gait", 2nd ed.
  1991, and Perry & Burnfield, "Gait Analysis", 2nd ed. 2010 (thigh against the vertical);
* running at about 3.2 m/s: Novacheck, "The biomechanics of running", Gait & Posture 7, 1998.

Their dependence on speed uses the dimensionless speed ``v / sqrt(g leg)`` (the root of the
Froude number; Alexander 1989), so that people of all heights share one relation:

* step length grows with speed to the power 0.42: Grieve, "Gait patterns and the speed of
  walking", Biomedical Engineering 3, 1968 (earlier Grieve & Gear, Ergonomics 9, 1966);
* stance takes 62 % of a stride at natural speed and less when faster: Murray 1967; Perry &
  Burnfield; in running 45 to 33 %: Novacheck 1998; Minetti, J. Exp. Biol. 201, 1998;
* rise and fall of the body: Orendurff et al., J. Rehabil. Res. Dev. 41, 2004;
* turn and list of the pelvis, counter-turn of the chest: Perry & Burnfield; Novacheck 1998;
* arm swing: Murray, Sepic & Barnard, Physical Therapy 47, 1967; bent elbows when running:
  Yegian et al., J. Exp. Biol. 222, 2019.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy  # it imports its parts on first use

GRAVITY = 9.81
"""m/s^2, MuJoCo's default."""

_WALK = {
    "thigh": {0: 22, 10: 18, 20: 9, 30: 0, 40: -9, 50: -17, 62: -9, 70: 6, 80: 20, 87: 25, 95: 24},
    "knee": {0: 4, 7: 12, 14: 18, 25: 11, 40: 5, 50: 12, 62: 38, 72: 60, 80: 49, 88: 22, 95: 5},
    "ankle": {0: 0, 7: -6, 13: -3, 30: 6, 45: 10, 52: 4, 62: -18, 68: -14, 78: -2, 88: 1, 95: 1},
}
_JOG = {
    "thigh": {0: 32, 10: 23, 20: 7, 30: -10, 39: -20, 48: -13, 60: 12, 75: 42, 82: 45, 92: 38},
    "knee": {0: 15, 8: 34, 15: 43, 25: 37, 39: 20, 50: 56, 63: 91, 75: 77, 88: 28, 95: 12},
    "ankle": {0: 6, 8: 14, 18: 24, 28: 14, 39: -20, 47: -12, 60: 3, 80: 6, 95: 6},
}


def _periodic(points: dict[int, int]) -> scipy.interpolate.CubicSpline:
    percent = np.array([*points, 100.0]) / 100.0
    degrees = np.array([*points.values(), points[0]], float)
    return scipy.interpolate.CubicSpline(percent, np.deg2rad(degrees), bc_type="periodic")


@dataclass(frozen=True)
class SwingShape:
    """How the foot moves between toe-off and touch-down, over the swing 0 to 1.

    Attributes:
        height: ankle below the hip's level, as a share of the leg's length.
        pitch: of the foot in radians, heel up is positive.
    """

    height: scipy.interpolate.CubicSpline
    pitch: scipy.interpolate.CubicSpline


@lru_cache(maxsize=2)
def swing_shape(jog: bool) -> SwingShape:
    """The swing that the normative thigh, knee and ankle angles describe."""
    curves = _JOG if jog else _WALK
    toe_off = 0.39 if jog else 0.62
    share = np.linspace(0.0, 1.0, 41)
    stride = toe_off + (1.0 - toe_off) * share
    thigh, knee, ankle = (_periodic(curves[name])(stride) for name in ("thigh", "knee", "ankle"))
    # Thigh and shank of the avatar have the same length within 0.2 %.
    height = -0.5 * (np.cos(thigh) + np.cos(thigh - knee))
    return SwingShape(
        scipy.interpolate.CubicSpline(share, height),
        scipy.interpolate.CubicSpline(share, knee - thigh - ankle),
    )


@dataclass(frozen=True)
class Gait:
    """Everything about a steady gait that depends on its speed; of the 1.75 m body.

    Attributes:
        jog: whether there is a flight phase.
        stride_s: duration of a stride (two steps) in seconds.
        duty: share of the stride for which a foot is on the floor.
        step_width_m: between the paths of the two ankles.
        toe_out: angle of each foot against the heading, radians.
        strike_pitch, push_pitch: of the foot at touch-down and at toe-off, heel up is positive.
        flat_share, rise_share: of the stride, from touch-down until the foot is flat, and from
            heel-rise until toe-off.
        lift: scale of the swing's normative rise of the foot.
        impact: speed in m/s, forward and down, with which the swinging foot meets the floor.
        clearance_m: minimum of the sole in mid-swing (Winter 1992: 1-2 cm walking).
        bob_m: half the rise and fall of the pelvis (walking; jogging is ballistic).
        pelvis_turn, pelvis_list, chest_turn, lean: amplitudes and lean in radians.
        shoulder_mean, shoulder_swing, elbow_mean, elbow_swing, abduction: of the arms, radians.
    """

    jog: bool
    stride_s: float
    duty: float
    step_width_m: float
    toe_out: float
    strike_pitch: float
    push_pitch: float
    flat_share: float
    rise_share: float
    lift: float
    impact: tuple[float, float]
    clearance_m: float
    bob_m: float
    pelvis_turn: float
    pelvis_list: float
    chest_turn: float
    lean: float
    shoulder_mean: float
    shoulder_swing: float
    elbow_mean: float
    elbow_swing: float
    abduction: float


def froude_speed(speed: float, leg_m: float) -> float:
    """Dimensionless speed ``v / sqrt(g leg)``."""
    return speed / float(np.sqrt(GRAVITY * leg_m))


def stride_time(speed: float, leg_m: float, jog: bool) -> float:
    """Seconds for a stride at ``speed`` in m/s, of a leg ``leg_m`` long."""
    v = froude_speed(speed, leg_m)
    scale = float(np.sqrt(leg_m / GRAVITY))
    if jog:
        # Novacheck 1998, Minetti 1998: 2.6 to 2.9 steps a second from 1.6 to 3.5 m/s.
        return 2.0 * scale / (0.75 + 0.10 * v)
    # Grieve 1968: step = 1.02 v^0.42 legs; below 0.4 m/s people take short, not slower steps.
    return 2.0 * scale * 1.02 * max(v, 0.14) ** (0.42 - 1.0)


def gait_at(speed: float, leg_m: float, jog: bool) -> Gait:
    """The steady gait of a person whose leg is ``leg_m`` long, at ``speed`` in m/s."""
    v = froude_speed(speed, leg_m)
    stride = stride_time(speed, leg_m, jog)
    return _jogging(speed, v, stride) if jog else _walking(speed, v, stride)


def _jogging(speed: float, v: float, stride: float) -> Gait:
    """The gait at ``speed`` in m/s.

    Args:
        v: the same speed as ``froude_speed``.
        stride: seconds of a stride.
    """
    return Gait(
        jog=True,
        stride_s=stride,
        duty=float(np.clip(0.50 - 0.15 * v, 0.30, 0.46)),
        step_width_m=0.085,
        toe_out=np.deg2rad(4.0),
        strike_pitch=-np.deg2rad(2.0 + 6.0 * v),
        push_pitch=np.deg2rad(38.0 + 14.0 * v),
        flat_share=0.07,
        rise_share=0.33,
        lift=float(np.clip(0.25 + 0.65 * v, 0.4, 1.1)),
        impact=(0.6 * speed, 0.9),
        clearance_m=0.035,
        bob_m=0.0,
        pelvis_turn=np.deg2rad(6.0),
        pelvis_list=np.deg2rad(3.5),
        chest_turn=np.deg2rad(8.0),
        lean=np.deg2rad(5.0 + 4.0 * v),
        shoulder_mean=-np.deg2rad(6.0),
        shoulder_swing=np.deg2rad(16.0 + 14.0 * v),
        elbow_mean=np.deg2rad(96.0),
        elbow_swing=np.deg2rad(12.0),
        abduction=np.deg2rad(20.0),
    )


def _walking(speed: float, v: float, stride: float) -> Gait:
    """As ``_jogging``, for a walk."""
    return Gait(
        jog=False,
        stride_s=stride,
        duty=float(np.clip(0.70 - 0.19 * v, 0.55, 0.70)),
        step_width_m=0.11,
        toe_out=np.deg2rad(6.0),
        strike_pitch=-np.deg2rad(min(48.0 * v, 24.0)),
        push_pitch=np.deg2rad(min(20.0 + 72.0 * v, 57.0)),
        flat_share=0.10,
        rise_share=0.32,
        lift=float(np.clip(0.55 + v, 0.7, 1.1)),
        impact=(0.6 * speed, 0.35),
        clearance_m=0.02,
        bob_m=0.5 * (0.009 + 0.0235 * speed),
        pelvis_turn=np.deg2rad(9.5) * v,
        pelvis_list=np.deg2rad(1.5 + 5.0 * v),
        chest_turn=np.deg2rad(8.0) * v,
        lean=np.deg2rad(1.0 + 4.0 * v),
        shoulder_mean=-np.deg2rad(6.0) * min(v / 0.4, 1.0),
        shoulder_swing=np.deg2rad(45.0) * v,
        elbow_mean=np.deg2rad(14.0 + 18.0 * v),
        elbow_swing=np.deg2rad(28.0) * v,
        abduction=np.deg2rad(7.0),
    )
