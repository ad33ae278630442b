"""Assist: a bounded force and torque on the pelvis of an avatar that is about to lose its user.

QuestSim (section 5.3) asks when physics should be violated. The assist acts while the avatar's
head is more than 25 cm from the user's head, or will be in 0.3 s at the present velocities, about
the time constant of a body that topples. It reads the headset alone, so it also works live.

The force on the pelvis is the sum of three parts. A spring and a damper pull the body, half towards
the place below the user's head and half by the error of the avatar's head: users lean, and their
pelvis is not seen. A part against toppling pulls the centre of mass back over the loaded feet. A
vertical part carries a body that sinks; it never pushes down, which would make the legs buckle. The
torque turns the trunk upright and towards the user's heading. While the user bends or squats, the
trunk keeps its forward lean, but may not lean back or to the side. A part of the torque turns the
whole body upright over its feet: force and torque on the trunk alone can hold a body for seconds
whose feet drag half a metre behind it, and that then sinks. The trunk turns back, and the hips
bring the legs forward. Both are renewed in every substep of the physics: the pelvis is light, and
gains of this size would shake it at 36 Hz.
"""

from __future__ import annotations

import numpy as np

from envs.core import BatchSim
from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M
from questsim.errors import InputError
from questsim.motion.clip import FPS
from questsim.motion.kinematics import standing_devices
from questsim.sensors import device_poses
from questsim.skeleton import FOOT_LINKS, LINKS

ENGAGE_M, RELEASE_M = 0.25, 0.12
"""Distance between the heads above which the assist fades in, and below which it fades out."""
FORESIGHT_S = 0.3
"""How far ahead the distance is extrapolated."""
FADE_S = 0.1
"""Duration of a full fade in or out."""
ARM_M = 1.0
"""Bound of the torque over bound of the force, about a pelvis' height: 300 N m for 300 N."""
MAX_ASSIST_N = 2000.0
_STIFFNESS, _DAMPING = 8.0, 3.5
"""Gains of the force on the pelvis, 1/s^2 and 1/s per kg of the body."""
_LIFT_STIFFNESS, _LIFT_DAMPING = 20.0, 8.0
"""The same of its vertical part."""
_HEAD_SHARE = 0.5
"""Share of the head's horizontal error in that of the pelvis' place."""
_UPRIGHTING, _UPRIGHT_DAMPING = 8.0, 1.5
"""Gains of the torque on the sine of the tilt and its rate, N m and N m s per kg of the body."""
_TURNING = 2.0
"""Gain of the torque about the vertical on the sine of the angle between the headings."""
_LEANING = 10.0
"""Gain of the torque on the distance of the centre of mass from the feet, N m per kg and metre."""
_STRIDE_M = 0.1
"""The centre of mass may be this far from the line between the feet, as in a step."""
_BALANCE = 0.5
"""Share of the moment of gravity about the feet that the part against toppling takes away."""
_LEAST_LOAD_N = 20.0
"""Added to the load of each foot, so that a body in the air has feet, too."""
_SINK_WEIGHT = 2.0
"""Weight of the height by which the avatar's head is lower, in the distance between the heads."""
_LEAST_LEAN = 0.3
"""Least forward lean of the trunk, as a sine, of an avatar whose user bends or squats."""
_LOW, _UPRIGHT = 0.75, 0.90
"""Heights of the user's headset, as shares of its standing height: below the first the user bends
or squats, above the second the trunk is taken to be upright."""
_GRAVITY = 9.81
_LEAST_HEIGHT_M = 0.3
"""Least height of the centre of mass in the part against toppling."""
_PELVIS, _HEAD = 1, LINKS.index("head")
"""The pelvis' body in the physics, and the head's link."""
_UP = np.array([0.0, 0.0, 1.0])


class Assist:
    """The assist of every avatar of a batch.

    Args:
        sim: the simulation of the avatars.
        bound_n: largest magnitude of the force in newtons; 0 turns the assist off.

    Attributes:
        force: ``(n, 3)`` N on the pelvis, mean of the last step.
        torque: ``(n, 3)`` N m, mean of the last step; its bound is ``ARM_M`` times the force's.
        share: ``(n,)`` fade of the assist, 0 (off) to 1 (full).

    Raises:
        InputError: the bound is not within 0 and 2000 N.
    """

    def __init__(self, sim: BatchSim, bound_n: float) -> None:
        n = sim.num_envs
        self._sim, self.bound_n = sim, checked_bound(bound_n)
        self._wrench = sim.batch.bind("xfrc_applied")
        self._centres = sim.batch.bind("subtree_com")
        self._eyes = standing_headsets(sim.user_heights)
        self.force, self.torque = np.zeros((n, 3)), np.zeros((n, 3))
        self.share = np.zeros(n)
        self._engaged = np.zeros(n, bool)
        self.reset()

    def reset(self) -> None:
        """Turn the assist off; call when all episodes begin."""
        self.share[:], self._engaged[:] = 0.0, False
        self._users: tuple[np.ndarray, np.ndarray] | None = None
        self._body: tuple[np.ndarray, ...] | None = None
        self._release()

    def _release(self) -> None:
        self.force[:], self.torque[:] = 0.0, 0.0
        self._wrench[:, _PELVIS] = 0.0
        self._sim.renew_forces = None

    def apply(self, user: np.ndarray, user_quat: np.ndarray) -> None:
        """Decide whether the coming step is assisted; call once before each step.

        Args:
            user: ``(n, 3)`` positions of the users' headsets in the world in metres.
            user_quat: ``(n, 4)`` orientations of the headsets.
        """
        if self.bound_n == 0.0 and not self.share.any():
            return
        own = headsets(self._sim)
        before = self._users or (user, own)
        self._users = user.copy(), own
        self._velocity, own_velocity = (
            (now - then) * FPS for now, then in zip(self._users, before, strict=True)
        )
        self._user, self._heading, self._passed_s = user.copy(), rot.heading(user_quat), 0.0
        error, rate = user - own, self._velocity - own_velocity
        worst = np.maximum(_distance(error), _distance(error + FORESIGHT_S * rate))
        self._engaged |= worst > ENGAGE_M
        self._engaged &= worst > RELEASE_M
        step = 1.0 / (FADE_S * FPS)
        self.share += np.clip(self._engaged - self.share, -step, step)
        self._release()
        if self.share.any():
            self._sim.renew_forces = self._renew
        else:
            self._body = None

    def _renew(self) -> None:
        """Set the wrench of the coming substep."""
        sim = self._sim
        step_s = 1.0 / (FPS * sim.substeps)
        user = self._user + self._passed_s * self._velocity
        self._passed_s += step_s
        own, pelvis = headsets(sim), sim.link_positions[:, 0].copy()
        centre = self._centres[:, _PELVIS].copy()
        trunk = own - pelvis
        length = np.maximum(np.linalg.norm(trunk, axis=-1, keepdims=True), 1e-6)
        lean = trunk / length
        before = self._body or (centre, lean)
        self._body = centre, lean
        velocity, lean_rate = (
            (now - then) / step_s for now, then in zip(self._body, before, strict=True)
        )
        tall = (user[:, 2] - sim.floor) / self._eyes
        upright = np.clip((tall - _LOW) / (_UPRIGHT - _LOW), 0.0, 1.0)[:, None]
        error = user - upright * length * _UP - (1.0 - upright) * trunk - pelvis
        error[:, :2] += _HEAD_SHARE * ((user - own) - error)[:, :2]
        slip = self._velocity - velocity
        pull = _STIFFNESS * error + _DAMPING * slip
        pull[:, :2] += self._against_toppling(centre)
        lift = _LIFT_STIFFNESS * error[:, 2] + _LIFT_DAMPING * slip[:, 2]
        pull[:, 2] = np.maximum(lift, 0.0)
        turn = _UPRIGHTING * np.cross(lean, _wanted_lean(lean, self._heading, upright))
        turn -= _UPRIGHT_DAMPING * np.cross(lean, lean_rate)
        feet = sim.link_positions[:, FOOT_LINKS, :2]
        turn -= _LEANING * np.cross(_UP, _beyond_feet(centre, feet))
        aside = self._heading - rot.heading(sim.link_quats[:, _HEAD])
        turn[:, 2] += _TURNING * np.sin(aside)
        mass = sim.masses[:, None]
        self._set(mass * pull, mass * turn)

    def _against_toppling(self, centre: np.ndarray) -> np.ndarray:
        """Level acceleration ``(n, 2)`` of a body towards its feet.

        Gravity accelerates an inverted pendulum of height ``h`` by ``g / h`` times its distance
        from the foot.

        Args:
            centre: ``(n, 3)`` centres of mass.
        """
        sim = self._sim
        load = np.maximum(sim.contact_force[..., 2], 0.0) + _LEAST_LOAD_N
        feet = (load[..., None] * sim.link_positions[:, FOOT_LINKS, :2]).sum(axis=1)
        feet /= load.sum(axis=1, keepdims=True)
        height = np.maximum(centre[:, 2] - sim.floor, _LEAST_HEIGHT_M)[:, None]
        return _BALANCE * _GRAVITY / height * (feet - centre[:, :2])

    def _set(self, force: np.ndarray, torque: np.ndarray) -> None:
        """Bound and fade a wrench ``(n, 3)``, ``(n, 3)``, and apply it."""
        force = self.share[:, None] * _bounded(force, self.bound_n)
        torque = self.share[:, None] * _bounded(torque, ARM_M * self.bound_n)
        self.force += force / self._sim.substeps
        self.torque += torque / self._sim.substeps
        self._wrench[:, _PELVIS, :3] = force + self._sim.pusher.force_on(_PELVIS)
        self._wrench[:, _PELVIS, 3:] = torque


def checked_bound(bound_n: float) -> float:
    """Validate the bound of the force in newtons.

    Raises:
        InputError: it is not within 0 and 2000 N.
    """
    if not 0.0 <= bound_n <= MAX_ASSIST_N:
        raise InputError(
            f"{bound_n:g} N is not within 0 and {MAX_ASSIST_N:g} N", "assist", "0 turns it off"
        )
    return float(bound_n)


def headsets(sim: BatchSim) -> np.ndarray:
    """Positions of the avatars' headsets ``(n, 3)``."""
    out = np.empty((sim.num_envs, 3))
    for height in np.unique(sim.heights):
        these = sim.heights == height
        position, _ = device_poses(
            sim.link_positions[these], sim.link_quats[these], ["headset"], float(height)
        )
        out[these] = position[:, 0]
    return out


def standing_headsets(heights: np.ndarray) -> np.ndarray:
    """Heights above the floor of the headsets of people of these statures, both ``(n,)`` m."""
    upright = standing_devices(["headset"], DEFAULT_HEIGHT_M)
    return heights * upright[0, 2] / DEFAULT_HEIGHT_M


def _distance(error: np.ndarray) -> np.ndarray:
    """Length ``(n,)`` of the vectors ``(n, 3)`` to the users' heads; sinking counts more."""
    weighted = error.copy()
    weighted[:, 2] *= np.where(error[:, 2] > 0.0, _SINK_WEIGHT, 1.0)
    return np.linalg.norm(weighted, axis=-1)


def _beyond_feet(centre: np.ndarray, feet: np.ndarray) -> np.ndarray:
    """Level vector ``(n, 3)`` by which centres of mass are further than a step from the feet.

    Args:
        centre: ``(n, 3)`` centres of mass.
        feet: ``(n, 2, 2)`` level positions of both feet; the nearest place between them counts.
    """
    along, away = feet[:, 1] - feet[:, 0], centre[:, :2] - feet[:, 0]
    square = np.maximum((along**2).sum(axis=-1), 1e-9)
    share = np.clip((away * along).sum(axis=-1) / square, 0.0, 1.0)
    away = away - share[:, None] * along
    distance = np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-9)
    out = np.zeros_like(centre)
    out[:, :2] = np.maximum(1.0 - _STRIDE_M / distance, 0.0) * away
    return out


def _wanted_lean(lean: np.ndarray, heading: np.ndarray, upright: np.ndarray) -> np.ndarray:
    """Direction of the trunk that is wanted, the nearest of those that are allowed.

    Args:
        lean: ``(n, 3)`` present direction, from the pelvis to the head.
        heading: ``(n,)`` of the users, radians.
        upright: ``(n, 1)``, 1 for users who are upright, 0 for those who bend or squat.
    """
    ahead = np.stack([np.cos(heading), np.sin(heading), np.zeros_like(heading)], axis=-1)
    bent = 1.0 - upright[:, 0]
    sine = np.clip((lean * ahead).sum(axis=-1), _LEAST_LEAN * bent, bent)[:, None]
    return sine * ahead + np.sqrt(np.maximum(1.0 - sine**2, 0.0)) * _UP


def _bounded(vector: np.ndarray, most: float) -> np.ndarray:
    """Vectors ``(n, 3)`` shortened to at most ``most``; zero where not finite."""
    vector = np.where(np.isfinite(vector), vector, 0.0)
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return vector * np.minimum(1.0, most / np.maximum(length, 1e-9))
