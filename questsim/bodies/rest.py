"""The pose in which a body stands upright with its arms hanging, and the frames of its roles."""

from __future__ import annotations

import mujoco
import numpy as np

from questsim import rotations as rot
from questsim.bodies.description import Description
from questsim.bodies.solver import Solver
from questsim.skeleton import LINKS

HANGING: tuple[tuple[str, str], ...] = tuple(
    (f"{side}_{upper}", f"{side}_{lower}")
    for side in ("left", "right")
    for upper, lower in (
        ("thigh", "shin"), ("shin", "foot"), ("upper_arm", "forearm"), ("forearm", "hand"),
    )
)  # fmt: skip
"""Roles whose origins are one below the other in the rest pose."""
_DOWN = np.array([0.0, 0.0, -1.0])
_STEPS = 100


def rest_pose(
    description: Description,
    model: mujoco.MjModel,
    link: np.ndarray,
    at: np.ndarray,
    mapped: np.ndarray,
    joint_range: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """The rest pose ``(7 + D,)`` and the frames ``(16, 4)`` of the roles in their links.

    Without ``[rest]`` the limbs are let hang as far as their hinges go, the root as in the MJCF.

    Args:
        description: may give the pose.
        model: the compiled MJCF.
        link, at, mapped: ``(16,)``, ``(16, 3)``, ``(16,)`` the roles, see ``BodyMap``.
        joint_range: ``(D, 2)`` rad.
    """
    solver = Solver(model, joint_range)
    start = np.array(model.qpos0)
    start[7:] = np.clip(start[7:], joint_range[:, 0], joint_range[:, 1])
    for name, degrees in description.rest.items():
        start[model.joint(name).qposadr[0]] = np.radians(degrees)
    solver.set_pose(start)
    if not description.rest:
        solver.until_still(lambda: _hang(solver, link, at, start), _STEPS)
        solver.data.qpos[:7] = start[:7]
        solver.set_pose(solver.data.qpos.copy())
    turn = np.stack([rot.quat_conjugate(solver.quat(i)) for i in link])
    for upper, lower in HANGING:
        a, b = LINKS.index(upper), LINKS.index(lower)
        direction = solver.place(link[b], at[b]) - solver.place(link[a], at[a])
        # What still leans in the rest pose leans in the link's own frame.
        leans = _between(direction, _DOWN)
        turn[a] = rot.quat_conjugate(rot.quat_multiply(leans, solver.quat(link[a])))
        if lower.endswith("hand"):
            turn[b] = rot.quat_conjugate(rot.quat_multiply(leans, solver.quat(link[b])))
    return solver.data.qpos.copy(), turn


def _hang(solver: Solver, link: np.ndarray, at: np.ndarray, start: np.ndarray) -> None:
    for upper, lower in HANGING:
        a, b = LINKS.index(upper), LINKS.index(lower)
        arm = solver.place(link[b], at[b]) - solver.place(link[a], at[a])
        length = float(np.linalg.norm(arm))
        if length < 1e-6:
            continue
        jacobian = solver.move_jacobian(link[b], at[b]) - solver.move_jacobian(link[a], at[a])
        solver.add(_DOWN - arm / length, jacobian / length, 1.0)
    root = np.zeros((6, solver.model.nv))
    root[:, :6] = np.eye(6)
    solver.add(np.zeros(6), root, 100.0)
    solver.add_angles(start[7:], 0.03)


def _between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Quaternion of the shortest rotation of direction ``first`` to ``second``."""
    length = float(np.linalg.norm(first))
    if length < 1e-6:
        return np.array([1.0, 0.0, 0.0, 0.0])
    first = first / length
    quat = np.concatenate([[1.0 + first @ second], np.cross(first, second)])
    size = float(np.linalg.norm(quat))
    return quat / size if size > 1e-6 else np.array([0.0, 0.0, 1.0, 0.0])
