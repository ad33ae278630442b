"""The joint torques that a motion requires: inverse dynamics with ground contact forces."""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress

import mujoco
import numpy as np
import scipy  # it imports its parts on first use

from questsim.assets import mjcf_path
from questsim.body import DEFAULT_HEIGHT_M, build_body
from questsim.body_proportions import Proportions
from questsim.files import whole_file
from questsim.motion.cache import cache_dir
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import sole_points
from questsim.motion.synthesis.seat import SEATED_ROOT_M
from questsim.motion.synthesis.wish import SEATED
from questsim.skeleton import FOOT_LINKS, LINKS, NUM_DOFS

FRICTION = 0.8
"""Friction coefficient of the contact force pyramid; the simulated floor has 1."""

CONTACT_HEIGHT_M = 0.015
"""Sole points below this height can carry load."""

ROOT_WEIGHTS = np.array([1.0, 1.0, 1.0, 3.0, 3.0, 3.0])
"""In the residual on the root, one newton metre counts as three newtons."""

SEAT_POINTS = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -0.12]])
"""Places on a thigh, in its frame, above the points that a seat carries; 1.75 m body."""

THIGH_M = 0.075
"""Distance of these points below the thigh's axis."""

SPREAD = 0.05
"""Regularisation weight of the forces: prefers solutions that load all points."""

# Each force is a non-negative combination of these edges of the friction pyramid.
EDGES = np.array(
    [[FRICTION, 0.0, 1.0], [-FRICTION, 0.0, 1.0], [0.0, FRICTION, 1.0], [0.0, -FRICTION, 1.0]]
)
THIGHS = tuple(LINKS.index(f"{side}_thigh") for side in ("left", "right"))
"""Links that a chair carries."""
VERSION = b"2"
"""Part of the cache key: change it with the method, so that torques are recomputed."""


class InverseDynamics:
    """Torques on the body of one height and preset.

    Accelerations are differences of the clip's velocities. The force on the root
    is supplied by forces at sole points near the floor, inside a friction pyramid, found by
    non-negative least squares (Lawson & Hanson 1974). While a clip of a seated kind has its root at
    the height of the seat, the chair also carries the thighs. A residual that they cannot supply,
    in flight or where the capture is not physical, is dropped. Passive damping and armature are
    included.

    Args:
        height_m: stature in metres.
        preset: of the body.
        proportions: of the body.
    """

    def __init__(
        self,
        height_m: float = DEFAULT_HEIGHT_M,
        preset: str = "default",
        proportions: Proportions | None = None,
    ) -> None:
        # A copy without contacts and joint limits; contact forces are computed here.
        self._model = copy.copy(build_body(height_m, preset, proportions=proportions).model)
        self._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
        self._data = mujoco.MjData(self._model)
        gravity = float(np.linalg.norm(self._model.opt.gravity))
        self.weight_n = float(self._model.body_mass.sum()) * gravity
        scale = height_m / DEFAULT_HEIGHT_M
        self._soles, self._seat = sole_points() * scale, SEAT_POINTS * scale
        self._thigh_m = THIGH_M * scale
        self._seated_below_m = SEATED_ROOT_M * scale + CONTACT_HEIGHT_M
        self._jacobian = np.zeros((3, self._model.nv))

    def torques(self, clip: Clip) -> np.ndarray:
        """Joint torques in N m ``(T, 33)`` at each frame of a clip of this height."""
        return self.forces(clip)[:, 6:]

    def forces(self, clip: Clip) -> np.ndarray:
        """All generalised forces ``(T, 39)`` at each frame of a clip of this height.

        The first six are the residual on the root, in N in the world and in N m, that the floor
        cannot supply.
        """
        acceleration = np.gradient(clip.qvel, 1.0 / FPS, axis=0)
        on_chair = clip.kind in SEATED
        return np.stack(
            [
                self.at(qpos, qvel, qacc, on_chair)
                for qpos, qvel, qacc in zip(clip.qpos, clip.qvel, acceleration, strict=True)
            ]
        )

    def at(
        self, qpos: np.ndarray, qvel: np.ndarray, qacc: np.ndarray, on_chair: bool = False
    ) -> np.ndarray:
        """Generalised forces ``(39,)`` of one frame; see ``forces``.

        Args:
            qpos, qvel, qacc: of the frame.
            on_chair: whether a chair of this body's size is there.
        """
        model, data = self._model, self._data
        data.qpos[:], data.qvel[:], data.qacc[:] = qpos, qvel, qacc
        mujoco.mj_inverse(model, data)
        force = np.array(data.qfrc_inverse)
        jacobians = []
        for link, point in self._bearing_points(on_chair):
            mujoco.mj_jac(model, data, self._jacobian, None, point, link + 1)
            jacobians.append(EDGES @ self._jacobian)
        if jacobians:
            edges = np.concatenate(jacobians)
            root = edges[:, :6].T * ROOT_WEIGHTS[:, None]
            wanted = np.concatenate([force[:6] * ROOT_WEIGHTS, np.zeros(len(edges))])
            factors, _ = scipy.optimize.nnls(np.vstack([root, SPREAD * np.eye(len(edges))]), wanted)
            force -= edges.T @ factors
        return force

    def _bearing_points(self, on_chair: bool) -> Iterator[tuple[int, np.ndarray]]:
        """Link and place of each point of the current pose that floor or chair can carry."""
        for foot, points in zip(FOOT_LINKS, self._soles, strict=True):
            for point in self._in_world(foot, points):
                if point[2] < CONTACT_HEIGHT_M:
                    yield foot, point
        if on_chair and self._data.qpos[2] < self._seated_below_m:
            for thigh in THIGHS:
                for point in self._in_world(thigh, self._seat):
                    yield thigh, point - [0.0, 0.0, self._thigh_m]

    def _in_world(self, link: int, points: np.ndarray) -> np.ndarray:
        """World positions ``(n, 3)`` of points ``(n, 3)`` in a link's frame."""
        turn = self._data.xmat[link + 1].reshape(3, 3)
        return self._data.xpos[link + 1] + points @ turn.T


def reference_torques(clips: Sequence[Clip], preset: str = "default") -> np.ndarray:
    """Torques of clips of the 1.75 m body, divided by its torque limits; clips are concatenated.

    They take 0.1 ms a frame to compute; each clip's are kept in the cache folder.

    Args:
        clips: of 1.75 m.
        preset: of the body.

    Returns:
        ``(F, 33)`` float32, as shares of each joint's limit.
    """
    limits = build_body(preset=preset).torque_limits
    dynamics: dict[Proportions | None, InverseDynamics] = {}

    def shares(clip: Clip) -> np.ndarray:
        if clip.proportions not in dynamics:
            dynamics[clip.proportions] = InverseDynamics(
                preset=preset, proportions=clip.proportions
            )
        return dynamics[clip.proportions].torques(clip) / limits

    body = preset.encode() + mjcf_path("humanoid.xml").read_bytes()
    return np.concatenate([cached_torques(clip, body, shares, NUM_DOFS) for clip in clips])


def cached_torques(
    clip: Clip, body: bytes, shares: Callable[[Clip], np.ndarray], dofs: int
) -> np.ndarray:
    """Torques ``(T, dofs)`` of a clip, float32, from the cache folder or computed and put there.

    Args:
        clip: of the body.
        body: what distinguishes the body from all others, except the clip's proportions.
        shares: computes the torques.
        dofs: the body's number of hinges.
    """
    digest = hashlib.sha256(VERSION + body)
    digest.update(np.ascontiguousarray(clip.qpos, "<f8").tobytes())
    digest.update(repr(clip.proportions and clip.proportions.places).encode())
    if clip.kind in SEATED:
        digest.update(b"chair")
    path = cache_dir() / "torques" / f"{digest.hexdigest()[:32]}.npy"
    with suppress(OSError, ValueError, EOFError):  # missing or damaged: computed anew
        kept = np.load(path, allow_pickle=False)
        if kept.shape == (len(clip), dofs):
            return kept
    torques = shares(clip).astype(np.float32)
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as fresh, fresh.open("wb") as file:
        np.save(file, torques)
    return torques
