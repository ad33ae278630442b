"""Arguments of the compiled loops as named records: arrays of equal shape cannot be swapped."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from envs.footsteps import Footsteps
from questsim.heightfield import HeightField


class State(NamedTuple):
    """The physics of ``n`` simulations, as views of MuJoCo's batch.

    Attributes:
        qpos, qvel: ``(n, nq)``, ``(n, nv)``; the avatar's come first.
        xpos, xquat, cvel, com: ``(n, nbody, ...)`` in MuJoCo's conventions; ``com`` is
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
    """The clip of each of ``n`` simulations, and its place.

    Attributes:
        frame, begin, end: ``(n,)`` present reference row, the clip's first, one past its last.
        place: ``(n, 4)`` where the clip is played: x, y, cosine and sine of its turn.
        ratio: ``(n,)`` body height over 1.75 m; reference lengths are of the 1.75 m body.
        scale: ``(n, 1)`` stature in metres, or ``(n, 6)`` with the proportions behind it.
    """

    frame: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    place: np.ndarray
    ratio: np.ndarray
    scale: np.ndarray


class ReferencePoses(NamedTuple):
    """Poses of ``F`` reference rows: what ``footing.fill`` turns into a ``Target``.

    Attributes:
        qpos: ``(F, 40)``; position: ``(F, 16, 3)``; quat: ``(F, 16, 4)`` of the links.
        steps: stance phases of the feet; may be empty on a plane.
    """

    qpos: np.ndarray
    position: np.ndarray
    quat: np.ndarray
    steps: Footsteps


class ReferenceRows(NamedTuple):
    """Velocities and torques of ``F`` reference rows, all clips one after the other.

    Attributes:
        qvel: ``(F, 39)``.
        velocity, angular_velocity: ``(F, 16, 3)`` of the links.
        torque: ``(F, 33)`` as shares of the joints' limits; empty unless privileged.
    """

    qvel: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray
    torque: np.ndarray


class Target(NamedTuple):
    """Target poses of ``n`` simulations in ``k`` frames, in the world.

    Attributes:
        angles: ``(n, k, 33)`` rad.
        position: ``(n, k, 16, 3)`` of the links in metres, in the world.
        quat: ``(n, k, 16, 4)`` of the links, before the clip is turned to its place.
        rise: ``(n, k, 16)`` vertical velocity in m/s that the ground adds to the links.
    """

    angles: np.ndarray
    position: np.ndarray
    quat: np.ndarray
    rise: np.ndarray

    @staticmethod
    def of(simulations: int, frames: int, dofs: int, links: int) -> Target:
        """Allocate targets of ``n`` simulations and ``k`` frames."""
        shape = (simulations, frames)
        return Target(
            np.zeros((*shape, dofs)),
            np.zeros((*shape, links, 3)),
            np.zeros((*shape, links, 4)),
            np.zeros((*shape, links)),
        )


class PoseFaults(NamedTuple):
    """Noise and mounting errors of ``D`` devices in ``n`` simulations; empty without errors.

    Attributes:
        key: ``(n,)`` uint64, of the episode's noise.
        std: ``(n, 2)`` standard deviation of each coordinate in metres, and of each component of
            the rotation vector in rad.
        mount_offset: ``(n, D, 3)`` displacement in the device's frame, metres.
        mount_quat: ``(n, D, 4)`` rotation from the nominal mount, in the device's frame.
    """

    key: np.ndarray
    std: np.ndarray
    mount_offset: np.ndarray
    mount_quat: np.ndarray


class Devices(NamedTuple):
    """Reported poses of ``D`` devices.

    Attributes:
        position, quat: ``(F, D, 3)``, ``(F, D, 4)`` in each reference row.
        late: ``(n,)`` latency in frames.
        newest: ``(n, D)`` the newest row that each device has delivered.
        offsets: ``(k,)`` frames ahead of each block of o_user.
        faults: errors of the reported poses.
    """

    position: np.ndarray
    quat: np.ndarray
    late: np.ndarray
    newest: np.ndarray
    offsets: np.ndarray
    faults: PoseFaults


class Privileged(NamedTuple):
    """Frames of the reference that teachers observe.

    Attributes:
        offsets: ``(p,)`` frames ahead; slots: ``(p,)`` their places in the ``Target``.
    """

    offsets: np.ndarray
    slots: np.ndarray


class Ground(NamedTuple):
    """The floor.

    Attributes:
        surface: ``(rows, columns)`` height of the colliding ground, or one number for a plane.
        height: the same, with ditches bridged; clips are lifted by it, see ``HeightField``.
        grid: x and y of the grid's first point, and the spacing of the grid.
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
    """Scores of a step.

    Attributes:
        terms: ``(n, 6)`` terms of the reward; reward: ``(n,)``.
        error: ``(n,)`` mean distance of the links from the reference in metres.
    """

    terms: np.ndarray
    reward: np.ndarray
    error: np.ndarray
