"""Targets, scores and observations of a batch, computed by the compiled kernels.

The kernels release the GIL. Simulations are divided into chunks, one for each thread.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from envs import footing, observation_kernel, score_kernel
from envs.config import EnvConfig, offsets_of
from envs.kernel_arguments import (
    Devices,
    Episodes,
    Privileged,
    ReferencePoses,
    ReferenceRows,
    Scores,
    State,
    Target,
    ground_of,
)
from envs.layout import SCAN_POINTS, observation_layout, observation_size
from envs.leg_ik import legs
from envs.reference import Reference
from envs.surroundings import Surroundings
from questsim.reward import COMPILED

if TYPE_CHECKING:
    from envs.own_legs import OwnFeet

_NOW = np.zeros(1, np.int64)


class View(NamedTuple):
    """A reference, its present target, the observation of it, and the teacher's devices.

    ``own``: see ``Reference``.
    """

    poses: ReferencePoses
    rows: ReferenceRows
    devices: Devices
    target: Target
    observation: np.ndarray
    teacher: tuple[np.ndarray, np.ndarray]
    own: OwnFeet | None


class KernelRunner:
    """Runs the kernels on the arrays of a batch.

    Args:
        config: options of the task.
        state: physics of the ``n`` simulations.
        episodes: what each simulation plays.
        around: ground and device errors.
        references: the one that scores; then, if agents observe another, that one.
        previous_force: ``(n, 2)`` vertical force on the feet a step ago, N.
        num_threads: number of threads; results do not depend on it.

    Attributes:
        layout: slices of an observation by name.
        views: one for each reference.
        target: poses that links are scored against. On a terrain the feet of walking users are
            adapted in it; in the views' targets, which are observed, only those of standing users.
        scores: of the last step.
        floor: ``(n,)`` height in metres of the ground under each avatar.
    """

    def __init__(
        self,
        config: EnvConfig,
        state: State,
        episodes: Episodes,
        around: Surroundings,
        references: tuple[Reference, ...],
        previous_force: np.ndarray,
        num_threads: int,
    ) -> None:
        n = len(episodes.frame)
        self._state, self._episodes, self._previous_force = state, episodes, previous_force
        self._ground = ground_of(around.placement.field)
        self.layout = observation_layout(config)
        self._all, self.floor = np.arange(n), np.zeros(n)
        self._chunks = chunks(n, num_threads)
        self._pool = ThreadPoolExecutor(num_threads) if len(self._chunks) > 1 else None
        reward, compiled = config.reward, slice(0, len(COMPILED))
        self._weights, self._kernels = reward.weights[compiled], reward.kernels[compiled]
        # The present pose. Teachers also need the next: their springs pull halfway towards it.
        shows = config.privileged_frames if config.privileged else ()
        self._ahead, self._legs = np.unique((0, 1, *shows) if shows else (0,)), legs()
        offsets = np.array(shows, np.int64)
        teacher = config.teacher_devices
        self._teacher_offsets = np.array(offsets_of(teacher[1]) if teacher else (), np.int64)
        self._privileged = Privileged(offsets, np.searchsorted(self._ahead, offsets))
        self.views = tuple(self._view(config, around, reference) for reference in references)
        sizes = self.views[0].target.angles.shape[2], self.views[0].target.position.shape[2]
        level = around.placement.field is None
        self.target = self.views[0].target if level else Target.of(n, 1, *sizes)
        self.scores = Scores(np.zeros((n, len(COMPILED))), np.zeros(n), np.zeros(n))

    def _view(self, config: EnvConfig, around: Surroundings, reference: Reference) -> View:
        n = len(self._episodes.frame)
        poses = reference.poses
        return View(
            poses,
            reference.rows,
            Devices(
                reference.dev_position,
                reference.dev_quat,
                around.signals.late,
                around.signals.newest,
                np.array(config.frame_offsets),
                around.faults.poses,
            ),
            Target.of(n, len(self._ahead), poses.qpos.shape[1] - 7, poses.position.shape[1]),
            np.zeros((n, observation_size(self.layout)), np.float32),
            (reference.teacher_position, reference.teacher_quat),
            reference.own,
        )

    def fill_targets(self, ids: np.ndarray) -> None:
        """Fill the targets of the simulations ``ids`` at their present frames."""
        self._in_chunks(self._fill_chunk, ids)

    def score(self) -> None:
        """Fill the targets and score the present state of all simulations."""
        self._in_chunks(self._score_chunk, self._all)

    def observe(self, ids: np.ndarray) -> None:
        """Write the observations of the simulations ``ids``."""
        self._in_chunks(self._observe_chunk, ids)

    def _in_chunks(self, work: Callable[..., None], ids: np.ndarray) -> None:
        # Only a whole batch is worth its threads: resets are of few simulations.
        whole = len(ids) == len(self._all)
        if self._pool is None or not whole:
            for first, last in self._chunks if whole else [(0, len(ids))]:
                work(first, last, ids)
            return
        for future in [self._pool.submit(work, *chunk, ids) for chunk in self._chunks]:
            future.result()

    def _fill_chunk(self, first: int, last: int, ids: np.ndarray) -> None:
        for view in self.views:
            self._fill(first, last, ids, view, self._ahead, 0.0, view.target)
        if self.target is not self.views[0].target:
            self._fill(first, last, ids, self.views[0], _NOW, 1.0, self.target)

    def _fill(
        self,
        first: int,
        last: int,
        ids: np.ndarray,
        view: View,
        ahead: np.ndarray,
        walking: float,
        target: Target,
    ) -> None:
        if view.own is not None:
            from envs.own_legs import fill_own  # late: few tasks have such a body

            fill_own(
                first, last, ids, self._episodes, ahead, view.poses, view.own.roles, self._ground,
                view.own.legs, walking, target,
            )  # fmt: skip
            return
        footing.fill(
            first, last, ids, self._episodes, ahead, view.poses, self._ground, self._legs, walking,
            target,
        )  # fmt: skip

    def _score_chunk(self, first: int, last: int, ids: np.ndarray) -> None:
        self._fill_chunk(first, last, ids)
        score_kernel.score(
            first, last, self._state, self._previous_force, self._episodes, self.views[0].rows,
            self.target, self._kernels, self._weights, self.scores,
        )  # fmt: skip

    def _observe_chunk(self, first: int, last: int, ids: np.ndarray) -> None:
        for view in self.views:
            observation_kernel.observe(
                first, last, ids, self._state, self._episodes, view.rows, view.target,
                view.devices, self._privileged, self._ground, self.floor, view.observation,
            )  # fmt: skip
            if "height_scan" in self.layout:
                observation_kernel.scan(
                    first, last, ids, self._state, SCAN_POINTS, self._ground, self.floor,
                    self.layout["height_scan"].start, view.observation,
                )  # fmt: skip
            if "o_teacher" in self.layout:
                observation_kernel.observe_exactly(
                    first, last, ids, self._state, self._episodes, *view.teacher,
                    self._teacher_offsets, self.layout["o_teacher"].start, view.observation,
                )  # fmt: skip

    def close(self) -> None:
        """Stop the threads."""
        if self._pool is not None:
            self._pool.shutdown()


def chunks(count: int, parts: int) -> list[tuple[int, int]]:
    """``parts`` near-equal ranges that cover ``range(count)``, without empty ones."""
    edges = np.linspace(0, count, min(parts, count) + 1).astype(int)
    return [(int(a), int(b)) for a, b in pairwise(edges) if b > a]
