"""Initial places of the objects of a batch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from envs.episode_random import Drawing, EpisodeRandom, within
from envs.objects import WorldObject
from envs.placement import Placement, moved
from envs.reference import Reference
from questsim.body import DEFAULT_HEIGHT_M
from questsim.heightfield import HeightField
from questsim.motion.clip import FPS

CLEARANCE_M = 0.55
"""Least distance of an object from the avatar's pelvis at the start of an episode."""
BEFORE_M, ASIDE_M = 1.0, 1.0
"""Distance of an object before the user of a stream, and between two of them."""
APART_M = 0.9
"""Least distance between two objects: a hurdle reaches 62 cm to each side."""


class Objects(Drawing):
    """The objects of a batch.

    Args:
        objects: options.
        random: numbers to draw from.
        qpos, qvel, sensors: bound fields of the batch.
        base_m: stature that reference lengths are of.
    """

    def __init__(
        self,
        objects: Sequence[WorldObject],
        random: EpisodeRandom,
        qpos: np.ndarray,
        qvel: np.ndarray,
        sensors: np.ndarray,
        base_m: float = DEFAULT_HEIGHT_M,
    ) -> None:
        self._size = base_m / DEFAULT_HEIGHT_M
        n, count = len(qpos), len(objects)
        self._objects, self._random = objects, random
        # Chairs first: the other objects avoid the place of a seated clip's chair.
        self._order = sorted(range(count), key=lambda number: objects[number].kind != "chair")
        self._seats: np.ndarray | None = None
        self._qvel = qvel[:, qvel.shape[1] - 6 * count :]
        self.pose = qpos[:, qpos.shape[1] - 7 * count :].reshape(n, count, 7)
        self._force = sensors[:, 6:].reshape(n, count, 3)

    @property
    def force(self) -> np.ndarray:
        """``(n, count, 3)`` force in N of the avatar on each object, in the world."""
        return self._force

    def place(
        self,
        ids: np.ndarray,
        rows: np.ndarray,
        clips: np.ndarray,
        reference: Reference,
        placement: Placement,
        ratio: np.ndarray,
    ) -> None:
        """Place the objects of episodes ``ids``, which begin at ``rows`` of the reference."""
        if not self._objects:
            return
        numbers = self._random.draw(ids, clips, 2 * len(self._objects))
        roots = reference.qpos[:, :3]
        scale, place = ratio[ids, None], placement.place[ids]
        last = reference.end[clips] - 1
        begin = moved(place, roots[rows].astype(float) * scale)[:, :2]
        self._qvel[ids] = 0.0
        taken: list[np.ndarray] = []
        for number in self._order:
            obj = self._objects[number]
            ahead = within(numbers[:, 2 * number], obj.ahead_s) * FPS
            there = np.minimum(rows + ahead.astype(np.int64), last)
            spot = moved(place, roots[there].astype(float) * scale)[:, :2]
            before = moved(place, roots[np.maximum(there - 9, rows)].astype(float) * scale)[:, :2]
            travel = self._direction(spot - before, place, reference.qpos[rows, 3:7])
            spot = spot + within(numbers[:, 2 * number + 1], obj.aside_m)[:, None] * np.stack(
                [-travel[:, 1], travel[:, 0]], axis=-1
            )
            spot = _kept_away(spot, begin, travel, CLEARANCE_M)
            for _ in taken:  # an object moved away from one may meet another
                for other in taken:
                    spot = _kept_away(spot, other, travel, APART_M)
            if obj.kind == "chair":
                self._under_sitters(reference, clips, place, scale, spot, travel)
            taken.append(spot)
            self.pose[ids, number, :2] = spot
            field = placement.field
            self.pose[ids, number, 2] = 0.0 if field is None else _on_top(field, spot)
            half = 0.5 * np.arctan2(travel[:, 1], travel[:, 0])
            self.pose[ids, number, 3:] = np.stack(
                [np.cos(half), 0.0 * half, 0.0 * half, np.sin(half)], axis=-1
            )

    def place_before(self, spot: np.ndarray, ahead: np.ndarray, field: HeightField | None) -> None:
        """Place the objects of a single avatar side by side before it.

        Args:
            spot: ``(2,)`` position of its pelvis.
            ahead: ``(2,)`` unit vector of its heading.
            field: the ground; None for a plane.
        """
        left = np.array([-ahead[1], ahead[0]])
        half = 0.5 * np.arctan2(ahead[1], ahead[0])
        for number in range(len(self._objects)):
            aside = (number - 0.5 * (len(self._objects) - 1)) * ASIDE_M
            there = spot + BEFORE_M * ahead + aside * left
            self.pose[0, number, :2] = there
            self.pose[0, number, 2] = 0.0 if field is None else _on_top(field, there[None])[0]
            self.pose[0, number, 3:] = np.cos(half), 0.0, 0.0, np.sin(half)
        self._qvel[0] = 0.0

    def _under_sitters(
        self,
        reference: Reference,
        clips: np.ndarray,
        place: np.ndarray,
        scale: np.ndarray,
        spot: np.ndarray,
        travel: np.ndarray,
    ) -> None:
        """Write place and direction of seated clips' chairs to ``spot``, ``travel`` ``(m, 2)``."""
        from questsim.motion.synthesis.seat import SEAT_BEHIND_M  # late: only for chairs

        if self._seats is None:
            self._seats = _seat_rows(reference)
        rows = self._seats[clips]
        sits = np.flatnonzero(rows >= 0)
        rows, place, scale = rows[sits], place[sits], scale[sits]
        nowhere = np.zeros((len(sits), 2))
        look = self._direction(nowhere, place, reference.qpos[rows, 3:7])
        hips = moved(place, reference.qpos[rows, :3].astype(float) * scale)[:, :2]
        spot[sits], travel[sits] = hips - SEAT_BEHIND_M * self._size * scale * look, look

    @staticmethod
    def _direction(step: np.ndarray, place: np.ndarray, quat: np.ndarray) -> np.ndarray:
        """Unit vectors ``(m, 2)`` of the travel, or of the heading for steps close to zero."""
        w, x, y, z = quat.astype(float).T
        look = np.stack([1.0 - 2.0 * (y * y + z * z), 2.0 * (w * z + x * y), 0.0 * w], axis=-1)
        still = place.copy()
        still[:, :2] = 0.0
        look = moved(still, look)[:, :2]
        slow = np.linalg.norm(step, axis=-1, keepdims=True) < 0.05
        way = np.where(slow, look, step)
        return way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-9)


def _seat_rows(reference: Reference) -> np.ndarray:
    """For each clip the row ``(C,)`` in which the user sits; -1 for clips that are not seated."""
    from questsim.motion.synthesis.synthetic import SEATED

    rows = np.full(len(reference.names), -1)
    for clip, kind in enumerate(reference.kinds):
        if kind in SEATED:
            first, last = int(reference.start[clip]), int(reference.end[clip])
            rows[clip] = first + reference.qpos[first:last, 2].argmin()
    return rows


def _kept_away(
    spot: np.ndarray, other: np.ndarray, travel: np.ndarray, distance_m: float
) -> np.ndarray:
    """Spots ``(m, 2)``, moved along the travel until far enough from the others."""
    offset = spot - other
    along = (offset * travel).sum(axis=-1)
    across = offset - along[:, None] * travel
    needed = np.sqrt(np.maximum(distance_m**2 - (across**2).sum(axis=-1), 0.0))
    near = np.linalg.norm(offset, axis=-1) < distance_m
    return other + across + np.where(near, needed, along)[:, None] * travel


def _on_top(field: HeightField, spot: np.ndarray) -> np.ndarray:
    """Highest ground ``(m,)`` within 0.3 m of spots ``(m, 2)``."""
    reach = np.linspace(-0.3, 0.3, 7)
    around = np.stack(np.meshgrid(reach, reach), -1).reshape(1, -1, 2)
    return field.height_at(spot[:, None] + around).max(axis=-1)
