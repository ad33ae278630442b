"""Initial states of episodes that differ from the reference's state.

A live user's whole-body state is unknown, and a pushed avatar is off the reference. So episodes may
begin standing at rest, or with a disturbance from which recovery is possible.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from envs.avatar import Avatar
from envs.checks import check_number
from envs.episode_random import Drawing, EpisodeRandom
from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M
from questsim.errors import InputError
from questsim.motion.clip import Clip

_CENTRE_M = 0.55
"""Height of the centre of mass over stature: a lean of 1 rad moves it by this share."""


@dataclass(frozen=True)
class Starts:
    """Shares of the episodes that do not begin in the reference's state, and their errors.

    Attributes:
        standing: share that begins upright, arms hanging, at rest, at the reference's place.
        still: share that begins in the reference's pose, at rest.
        disturbed: share that begins in the reference's pose with the errors below. Each is drawn
            uniformly up to its greatest value, in a random direction.
        estimate: share that begins in an estimate of the reference's state, where the environment
            has one (``begin_at``).
        lean_m: displacement of the centre of mass by a lean of the whole body.
        speed_m_s: speed of the centre of mass as the body topples.
        place_m: horizontal error of the position.
        lift_m: height above the ground.
        joints_rad: error of every joint angle.

    Raises:
        InputError: an invalid share, or an error that is negative or above its limit.
    """

    standing: float = 0.0
    still: float = 0.0
    disturbed: float = 0.0
    estimate: float = 0.0
    lean_m: float = 0.1
    speed_m_s: float = 0.6
    place_m: float = 0.05
    lift_m: float = 0.02
    joints_rad: float = 0.1

    def __post_init__(self) -> None:
        for name in ("standing", "still", "disturbed", "estimate"):
            check_number(name, getattr(self, name), 0.0, 1.0, "starts")
        if self.total > 1.0:
            raise InputError(f"the shares add up to {self.total:g}", "starts", "at most 1")
        for name, most in (
            ("lean_m", 0.5),
            ("speed_m_s", 3.0),
            ("place_m", 0.5),
            ("lift_m", 0.5),
            ("joints_rad", 1.0),
        ):
            check_number(name, getattr(self, name), 0.0, most, "starts")

    @property
    def total(self) -> float:
        """Share of the episodes that do not begin in the reference's own state."""
        return self.standing + self.still + self.disturbed + self.estimate


WHOLLY: dict[str, Starts | None] = {
    "reference": None,
    "still": Starts(still=1.0),
    "standing": Starts(standing=1.0),
    "estimate": Starts(estimate=1.0),
    "first-estimate": Starts(estimate=1.0),
}
"""Starts in which all episodes begin alike, by the names of ``evaluate.py --begin``."""


class Estimates:
    """Estimates of the reference's states in which episodes may begin.

    Args:
        clips: estimates by the name of their clip, in the same coordinates. One that is shorter
            than its clip is of the clip's first frames.
        names: names of all clips of the batch.
        lengths: frames of each.

    Raises:
        InputError: an estimate is longer than its clip, or there is none at all.
    """

    def __init__(
        self, clips: Mapping[str, Clip], names: Sequence[str], lengths: Sequence[int]
    ) -> None:
        used = [clips.get(name) for name in names]
        for name, clip, length in zip(names, used, lengths, strict=True):
            if clip is not None and len(clip) > length:
                raise InputError(
                    f"its estimate has {len(clip)} frames, the motion {length}", name,
                    "make estimates of these very motions",
                )  # fmt: skip
        common = [clip.scaled(DEFAULT_HEIGHT_M) for clip in used if clip is not None]
        if not common:
            raise InputError("there is no estimate of these motions", "starts.estimate")
        self._count = np.array([0 if clip is None else len(clip) for clip in used])
        self._start = np.cumsum(self._count) - self._count
        self._qpos = np.concatenate([clip.qpos for clip in common])
        self._qvel = np.concatenate([clip.qvel for clip in common])

    def at(
        self, clips: np.ndarray, frames: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Whether there is an estimate ``(m,)`` bool, ``qpos (m, 40)``, ``qvel (m, 39)``.

        The states are those of the 1.75 m body; they are undefined where a frame has no estimate.
        """
        has = frames < self._count[clips]
        rows = np.where(has, self._start[clips] + frames, 0)
        return has, self._qpos[rows].copy(), self._qvel[rows].copy()


class Beginnings(Drawing):
    """Changes the initial states of a batch's episodes.

    Args:
        options: shares and errors; None for the reference's state.
        random: numbers to draw from.
        avatar: ranges of the hinges, and the pose upright.
        heights: ``(n,)`` statures in metres.
    """

    def __init__(
        self,
        options: Starts | None,
        random: EpisodeRandom,
        avatar: Avatar,
        heights: np.ndarray,
    ) -> None:
        self._options, self._random, self._heights = options, random, heights
        self._range, self._upright = avatar.joint_range, avatar.upright

    def change(
        self,
        ids: np.ndarray,
        clips: np.ndarray,
        qpos: np.ndarray,
        qvel: np.ndarray,
        clearance: Callable[[np.ndarray], np.ndarray],
        estimate: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
    ) -> None:
        """Change states in place: ``qpos (m, 40)`` and ``qvel (m, 39)`` of simulations ``ids``.

        Args:
            ids, clips: ``(m,)`` simulations, and the clip of each.
            qpos, qvel: the reference's state in the world.
            clearance: function of poses ``(m, 40)`` and ids that returns the height ``(m,)`` of
                the lowest sole point above the ground.
            estimate: result of ``Estimates.at``, in the world; None without estimates.
        """
        options = self._options
        if options is None or options.total == 0.0 or len(ids) == 0:
            return
        numbers = self._random.draw(ids, clips, 8 + len(self._upright))
        standing = numbers[:, 0] < options.standing
        disturbed = ~standing & (numbers[:, 0] < options.standing + options.disturbed)
        at_reference = options.total - options.estimate
        qvel[~standing & ~disturbed & (numbers[:, 0] < at_reference)] = 0.0
        estimated = np.zeros(len(ids), bool)
        if estimate is not None:
            has, pose, velocity = estimate
            estimated = has & (numbers[:, 0] >= at_reference) & (numbers[:, 0] < options.total)
            qpos[estimated], qvel[estimated] = pose[estimated], velocity[estimated]
        qpos[standing, 3:7] = rot.yaw_quat(rot.heading(qpos[standing, 3:7]))
        qpos[standing, 7:], qvel[standing] = self._upright, 0.0
        self._disturb(disturbed, numbers[disturbed], self._heights[ids], qpos, qvel)
        above = clearance(qpos)
        lift = np.where(disturbed, options.lift_m * numbers[:, 7], 0.0)
        # Put standing avatars on the ground; lift the others until no foot is in it.
        below = np.where(standing, above, np.minimum(above, 0.0))
        changed = standing | disturbed | estimated
        qpos[changed, 2] += (lift - below)[changed]

    def _disturb(
        self,
        which: np.ndarray,
        numbers: np.ndarray,
        heights: np.ndarray,
        qpos: np.ndarray,
        qvel: np.ndarray,
    ) -> None:
        """Disturb the avatars ``which`` ``(m,)`` bool: lean, speed, place and joint angles."""
        options = self._options
        assert options is not None
        centre_m = _CENTRE_M * heights[which]
        lean = _direction(numbers[:, 1]) * (options.lean_m * numbers[:, 2] / centre_m)[:, None]
        spin = _direction(numbers[:, 3]) * (options.speed_m_s * numbers[:, 4] / centre_m)[:, None]
        place = _direction(numbers[:, 5]) * (options.place_m * numbers[:, 6])[:, None]
        # The avatar turns about the point of the ground below its root.
        arm = np.zeros((len(numbers), 3))
        arm[:, 2] = qpos[which, 2]
        turn = rot.as_quat(rot.from_rotvec(lean))
        qpos[which, 3:7] = rot.quat_multiply(turn, qpos[which, 3:7])
        qpos[which, :3] += np.cross(lean, arm) + place
        qvel[which, :3] += np.cross(spin, arm)
        inverse = rot.quat_conjugate(qpos[which, 3:7])
        qvel[which, 3:6] += rot.as_rotation(inverse).apply(spin)
        error = options.joints_rad * (2.0 * numbers[:, 8:] - 1.0)
        # A joint that is beyond its range in the reference stays there.
        low = np.minimum(self._range[:, 0], qpos[which, 7:])
        high = np.maximum(self._range[:, 1], qpos[which, 7:])
        qpos[which, 7:] = np.clip(qpos[which, 7:] + error, low, high)


def _direction(numbers: np.ndarray) -> np.ndarray:
    """Horizontal unit vectors ``(m, 3)`` for numbers in [0, 1)."""
    angle = 2.0 * np.pi * numbers
    return np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
