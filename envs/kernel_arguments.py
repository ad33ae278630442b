"""What the compiled loops read, in records by name: arrays of one shape cannot change places."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from envs.footsteps import Footsteps
from questsim.heightfield import HeightField
from questsim.skeleton import NUM_DOFS, NUM_LINKS


class State(NamedTuple):
    """The physics of ``n`` simulations, as views of MuJoCo's batch.

    Attributes:
        qpos, qvel: ``(n, nq)``, ``(n, nv)``; the avatar's come first.
        xpos, xquat, cvel, com: of the bodies ``(n, nbody, ...)``, as MuJoCo has them; ``com`` is
            ``subtree_com``.
        foot_force: ``(n, 2, 3)`` force of the floor on each foot, world, N.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    xpos: np.ndarray
    xquat: np.ndarray
    cvel: np.ndarray
    com: np.ndarray
    foot_force: np.ndarray


class Episodes(NamedTuple):
    """What each of ``n`` simulations plays, and where.

    Attributes:
        frame, begin, end: ``(n,)`` reference row now, the clip's first, one past its last.
        place: ``(n, 4)`` where the clip is played: x, y, cosine and sine of its turn.
        ratio: ``(n,)`` body height over 1.75 m; reference lengths are of the 1.75 m body.
        height: ``(n,)`` metres.
    """

    frame: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    place: np.ndarray
    ratio: np.ndarray
    height: np.ndarray


class ReferencePoses(NamedTuple):
    """Poses of ``F`` reference rows: what ``footing.fill`` turns into a ``Target``.

    Attributes:
        qpos: ``(F, 40)``; position: ``(F, 16, 3)``; quat: ``(F, 16, 4)`` of the links.
        steps: when each foot stands; empty ones will do on a plane.
    """

    qpos: np.ndarray
    position: np.ndarray
    quat: np.ndarray
    steps: Footsteps


class ReferenceRows(NamedTuple):
    """How ``F`` reference rows move, all clips one after the other.

    Attributes:
        qvel: ``(F, 39)``.
        velocity, angular_velocity: ``(F, 16, 3)`` of the links.
        torque: ``(F, 33)`` of joint limits; empty where nothing is privileged.
    """

    qvel: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray
    torque: np.ndarray


class Target(NamedTuple):
    """What ``n`` simulations are asked to do in ``k`` frames, in the world.

    Attributes:
        angles: ``(n, k, 33)`` rad.
        position: ``(n, k, 16, 3)`` of the links in metres, in the world.
        quat: ``(n, k, 16, 4)`` of the links, as the clip has them before it is turned to its place.
        rise: ``(n, k, 16)`` what the ground adds to the links' vertical velocity in m/s.
    """

    angles: np.ndarray
    position: np.ndarray
    quat: np.ndarray
    rise: np.ndarray

    @staticmethod
    def of(simulations: int, frames: int) -> Target:
        """Room for that many."""
        shape = (simulations, frames)
        return Target(
            np.zeros((*shape, NUM_DOFS)),
            np.zeros((*shape, NUM_LINKS, 3)),
            np.zeros((*shape, NUM_LINKS, 4)),
            np.zeros((*shape, NUM_LINKS)),
        )


class Devices(NamedTuple):
    """What ``D`` devices report.

    Attributes:
        position, quat: ``(F, D, 3)``, ``(F, D, 4)`` in each reference row.
        late: ``(n,)`` frames by which they are late.
        newest: ``(n, D)`` the last row that each can show.
        offsets: ``(k,)`` frames ahead of each block of o_user.
    """

    position: np.ndarray
    quat: np.ndarray
    late: np.ndarray
    newest: np.ndarray
    offsets: np.ndarray


class Privileged(NamedTuple):
    """Which frames of the reference teachers observe.

    Attributes:
        offsets: ``(p,)`` frames ahead; slots: ``(p,)`` their places in the ``Target``.
    """

    offsets: np.ndarray
    slots: np.ndarray


class Ground(NamedTuple):
    """The floor.

    Attributes:
        surface: ``(rows, columns)`` height of what collides, or one number for a plane.
        height: the same of what carries the clips (ditches are bridged), see ``HeightField``.
        grid: x and y of the grid's first point, and its distance of points.
    """

    surface: np.ndarray
    height: np.ndarray
    grid: np.ndarray


def ground_of(field: HeightField | None) -> Ground:
    """The arrays of a height field; None is a plane at zero."""
    if field is None:
        return Ground(np.zeros((1, 1)), np.zeros((1, 1)), np.array([0.0, 0.0, 1.0]))
    return Ground(field.height, field.ground, np.array([*field.origin, field.cell_m]))


class Scores(NamedTuple):
    """What a step is worth.

    Attributes:
        terms: ``(n, 6)`` of the reward; reward: ``(n,)``.
        error: ``(n,)`` mean distance of the links from the reference in metres.
    """

    terms: np.ndarray
    reward: np.ndarray
    error: np.ndarray
