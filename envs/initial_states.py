"""Initial states of episodes: the reference's state in the world, changed as ``Starts`` asks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from envs.bodies import Bodies
from envs.config import EnvConfig
from envs.kernel_arguments import Target
from envs.placement import Placement, moved, turn_quat, turned
from envs.reference import Reference
from envs.starts import Beginnings, Estimates
from questsim import rotations as rot
from questsim.errors import InputError
from questsim.motion.clip import Clip

Clearance = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Height ``(m,)`` above the ground of the lowest sole point, of simulations ``(m,)`` in poses
``(m, 40)``."""


def estimates_of(
    begin_at: Mapping[str, Clip] | None, config: EnvConfig, bodies: Bodies, reference: Reference
) -> Estimates | None:
    """The estimates in which episodes may begin; None if no episode does.

    Raises:
        InputError: estimates without ``starts.estimate`` or the reverse, or of other bodies.
    """
    asked = config.starts is not None and config.starts.estimate > 0.0
    if asked != (begin_at is not None):
        fix = "give both or neither"
        raise InputError("starts.estimate and begin_at belong together", "BatchSim", fix)
    if begin_at is None:
        return None
    if any(bodies.proportions):
        what = "estimates are of the default body's proportions, the clips are not"
        raise InputError(what, "starts.estimate", "leave one out")
    return Estimates(begin_at, reference.names, list(reference.end - reference.start))


class InitialStates:
    """Makes the initial states of a batch's episodes.

    Args:
        config: options of the task.
        reference: the clips.
        bodies: statures of the avatars.
        ratio: ``(n,)`` stature of each user over that of the reference.
        placement: where the clips are played.
        starts: changes the states.
        estimates: of the clips' states, for ``starts.estimate``; None without them.
        clearance: see ``Clearance``.
    """

    def __init__(
        self,
        config: EnvConfig,
        reference: Reference,
        bodies: Bodies,
        ratio: np.ndarray,
        placement: Placement,
        starts: Beginnings,
        estimates: Estimates | None,
        clearance: Clearance,
    ) -> None:
        self._reference, self._ratio, self._placement = reference, ratio, placement
        self._starts, self._estimates, self._clearance = starts, estimates, clearance
        self._taller = bodies.heights / bodies.user_heights
        self._unscaled = bool((self._taller != 1.0).any())

    def draw(
        self, ids: np.ndarray, rows: np.ndarray, clips: np.ndarray, target: Target
    ) -> tuple[np.ndarray, np.ndarray]:
        """``qpos (m, 40)`` and ``qvel (m, 39)`` of the episodes that ``ids`` begin.

        Args:
            ids: ``(m,)`` simulations.
            rows, clips: ``(m,)`` row of the reference and clip of each.
            target: of the whole batch, filled for these rows.
        """
        scale = self._ratio[ids, None]
        qpos = self._reference.qpos[rows].astype(float)
        qvel = self._reference.qvel[rows].astype(float)
        qpos[:, :3] *= scale
        qvel[:, :3] *= scale
        # An avatar of another size than its user stands on the ground like the user.
        more = (self._taller[ids] - 1.0) * qpos[:, 2] if self._unscaled else None
        if self._placement.field is not None:
            self._put_on_ground(ids, target, qpos, qvel, more)
        elif self._unscaled:
            qpos[:, 2] *= self._taller[ids]
        estimate = self._estimate(ids, rows, clips)
        self._starts.change(ids, clips, qpos, qvel, partial(self._clearance, ids), estimate)
        return qpos, qvel

    def _estimate(
        self, ids: np.ndarray, rows: np.ndarray, clips: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """The estimates of rows of the reference, in the world; None without estimates."""
        if self._estimates is None:
            return None
        has, qpos, qvel = self._estimates.at(clips, rows - self._reference.start[clips])
        scale, place = self._ratio[ids, None], self._placement.place[ids]
        qpos[:, :3], qvel[:, :3] = moved(place, qpos[:, :3] * scale), turned(place, qvel[:, :3])
        qvel[:, :3] *= scale
        qpos[:, 3:7] = rot.quat_multiply(turn_quat(place), qpos[:, 3:7])
        field = self._placement.field
        if field is not None:
            qpos[:, 2] += field.ground_at(qpos[:, :2])
        return has, qpos, qvel

    def _put_on_ground(
        self,
        ids: np.ndarray,
        target: Target,
        qpos: np.ndarray,
        qvel: np.ndarray,
        more: np.ndarray | None,
    ) -> None:
        """Move poses to their places and put their feet on the ground; no sole is below it.

        ``more``: by how many metres each pelvis is higher than the user's.
        """
        place = self._placement.place[ids]
        qpos[:, :3], qpos[:, 7:] = target.position[ids, 0, 0], target.angles[ids, 0]
        qpos[:, 3:7] = rot.quat_multiply(turn_quat(place), qpos[:, 3:7])
        qvel[:, :3] = turned(place, qvel[:, :3])
        qvel[:, 2] += target.rise[ids, 0, 0]
        if more is not None:
            qpos[:, 2] += more
        qpos[:, 2] += np.maximum(-self._clearance(ids, qpos), 0.0)
