"""Feasibility checks: the reasons for which a variation is rejected.

Legs must reach their feet, joint speeds must be human, soles must stay above the floor, and the
floor must be able to carry the motion: inverse dynamics computes the force and the moment on the
root that forces under the soles cannot supply.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M, build_body
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import central_difference, sole_positions
from questsim.skeleton import DOFS, FOOT_LINKS

MISFIT_M, MISFIT_RAD = 0.015, np.deg2rad(12.0)
"""Tolerance of a stance foot's position and orientation; a foot in the air has three times that."""
BELOW_FLOOR_M = 0.02
"""A sole may be this far below the floor, as in the recordings themselves."""
FAST_RAD_S = {
    "hip": 14.0, "knee": 18.0, "ankle": 16.0, "spine": 5.0, "chest": 5.0, "neck": 8.0,
    "shoulder": 20.0, "elbow": 20.0, "wrist": 25.0,
}  # fmt: skip
"""Maximum joint speeds; 99.99 % of the recorded frames of bandai-namco-2 are below."""
BACKWARDS_M_S = 1.3
"""People walk backwards up to about this fast; running backwards is rejected."""
WINDOW_S = 0.3
"""Shorter violations are tolerated, e.g. landings and noise of the recording."""
FORCE, MOMENT_M = 0.15, 0.04
"""Tolerated residual on the root: body weights, and metres of the pressure outside the feet."""
CONTACT_HEIGHT_M, FRICTION = 0.025, 0.9
"""Sole points below this can carry load (1.75 m body); the simulated floor's friction is 1."""
BASE_FACTOR = 1.25
"""A variation's residual may be this many times that of its clip."""


def fast_joint(clip: Clip) -> str | None:
    """The first hinge that is faster than a person's; None if there is none."""
    most = np.abs(clip.qvel[:, 6:]).max(axis=0)
    for hinge, speed in zip(DOFS, most, strict=True):
        part = hinge.split("_")[-2]
        if speed > FAST_RAD_S[part]:
            return hinge
    return None


def feet_missed(contacts: np.ndarray, misfit: tuple[np.ndarray, np.ndarray]) -> bool:
    """Whether the legs fail to bring the feet to their targets.

    Args:
        contacts: ``(T, 2)`` bool.
        misfit: ``(T, 2)`` metres and radians.
    """
    allowed = np.where(contacts, 1.0, 3.0)
    distance, angle = misfit
    return bool((distance > allowed * MISFIT_M).any() or (angle > allowed * MISFIT_RAD).any())


def in_the_floor(clip: Clip) -> bool:
    """Whether a sole is below the floor."""
    feet = list(FOOT_LINKS)
    soles = sole_positions(clip.link_position[:, feet], clip.link_quat[:, feet], clip.height_m)
    return bool(soles[..., 2].min() < -BELOW_FLOOR_M)


def too_fast_backwards(clip: Clip) -> bool:
    """Whether a reversed clip runs backwards: it has flight, or is faster than people walk so."""
    speed = np.linalg.norm(clip.qvel[:, :2], axis=-1)
    flies = ~clip.contacts.any(axis=1)
    return bool(np.percentile(speed, 95) > BACKWARDS_M_S or flies.mean() > 0.02)


def lacking(clip: Clip) -> tuple[float, float]:
    """Largest force and moment on the root over ``WINDOW_S`` that the floor cannot supply.

    The equations of motion of the whole body (Newton and Euler; Kajita et al. 2003 for the
    pressure): inverse dynamics of the six rows without joint torques.

    Returns:
        body weights, and metres (moment over weight): how far the pressure is outside the feet.
    """
    force, pressure = reaction(clip)
    feet = list(FOOT_LINKS)
    soles = sole_positions(clip.link_position[:, feet], clip.link_quat[:, feet], clip.height_m)
    bears = (soles[..., 2] < CONTACT_HEIGHT_M * clip.height_m / DEFAULT_HEIGHT_M).reshape(-1, 8)
    push = np.maximum(force[:, 2], 0.0)
    slip = np.maximum(np.linalg.norm(force[:, :2], axis=-1) - FRICTION * push, 0.0)
    standing = bears.any(axis=1)
    short = np.where(standing, slip + push - force[:, 2], np.linalg.norm(force, axis=-1))
    outside = _outside(pressure, soles[..., :2].reshape(-1, 8, 2), bears)
    moment = np.where(standing, outside, 0.0) * push
    frames = max(int(WINDOW_S * FPS), 1)
    worst = [uniform_filter1d(part, frames, mode="nearest").max() for part in (short, moment)]
    return float(worst[0]), float(worst[1])


def reaction(clip: Clip) -> tuple[np.ndarray, np.ndarray]:
    """The ground reaction that a motion requires.

    Returns:
        ``(T, 3)`` the force in body weights, and ``(T, 2)`` the centre of pressure in metres
        (meaningless where the force does not push).
    """
    model = build_body(clip.height_m).model
    gravity = float(np.linalg.norm(model.opt.gravity))
    mass = model.body_mass[1:] / model.body_mass.sum()
    centers = clip.link_position + rot.quat_rotate(clip.link_quat, model.body_ipos[1:])
    velocity = central_difference(centers)
    center = np.einsum("l,tlk->tk", mass, centers)
    around = np.cross(centers - center[:, None], velocity * mass[:, None])
    own = rot.quat_multiply(clip.link_quat, model.body_iquat[1:])
    spin = rot.quat_rotate(rot.quat_conjugate(own), clip.link_angular_velocity)
    inertia = model.body_inertia[1:] / model.body_mass.sum()
    momentum = (around + rot.quat_rotate(own, spin * inertia)).sum(axis=1)
    turn = central_difference(momentum)
    force = central_difference(np.einsum("l,tlk->tk", mass, velocity))
    force[:, 2] += gravity
    push = np.maximum(force[:, 2], 0.1 * gravity)
    x = center[:, 0] - (turn[:, 1] + center[:, 2] * force[:, 0]) / push
    y = center[:, 1] + (turn[:, 0] - center[:, 2] * force[:, 1]) / push
    return force / gravity, np.stack([x, y], axis=-1)


def _outside(point: np.ndarray, corners: np.ndarray, bears: np.ndarray) -> np.ndarray:
    """Metres ``(T,)`` from points ``(T, 2)`` to the hull of the loaded corners ``(T, 8, 2)``.

    By the hull's support function, in 24 directions: up to 1 % too near.
    """
    angle = np.arange(24) * (2.0 * np.pi / 24)
    ways = np.stack([np.cos(angle), np.sin(angle)])
    reach = np.where(bears[..., None], corners @ ways, -np.inf).max(axis=1)
    return np.maximum((point @ ways - reach).max(axis=1), 0.0)


def unsupported(clip: Clip, base: tuple[float, float]) -> bool:
    """Whether a motion's residual exceeds that of its recording, ``base``, by too much."""
    force, moment = lacking(clip)
    return force > max(FORCE, BASE_FACTOR * base[0]) or moment > max(
        MOMENT_M, BASE_FACTOR * base[1]
    )
