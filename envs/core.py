"""Simulation of many avatars, each following a clip, stepped together as a MuJoCo batch.

Every interface (gymnasium, vector, stable-baselines3, kinematic) is a thin layer over ``BatchSim``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from envs.actions import checked_actions
from envs.avatar import avatar_of
from envs.bodies import Bodies, models_of, on_their_bodies
from envs.checks import check_count
from envs.config import EnvConfig
from envs.episode_random import Seeds, Streams
from envs.initial_states import InitialStates, estimates_of
from envs.kernel_arguments import Episodes
from envs.kernel_runner import KernelRunner
from envs.moment import finite_extra_terms, moment_of
from envs.physics import POSITION, Physics
from envs.reference import Reference, check_are_clips, check_shown
from envs.sampler import Sampler
from envs.surroundings import Surroundings
from questsim import bodies
from questsim import rotations as rot
from questsim.errors import InputError
from questsim.motion.clip import FPS, Clip
from questsim.reward import COMPILED, Moment

# State of a running episode, besides the physics.
_EPISODE = ("clip", "frame", "_first", "_end", "contact_force", "_previous_force")


class BatchSim:
    """A batch of avatars following clips at 36 Hz.

    Args:
        clips: the motions; an environment plays one from start to end, then draws another.
        config: options of the task.
        num_envs: number of simulations; None means one for each clip.
        seed: seed of sampling and of sensor noise.
        num_threads: threads of physics and kernels; results do not depend on it.
        shown: clips that agents observe (devices and reference) instead of ``clips``: one for each
            clip, of the same length and stature, e.g. the estimates of a kinematic system. Initial
            states and scores come from ``clips``.
        begin_at: estimates of the clips' states by name, for ``starts.estimate``.

    Attributes:
        layout: slices of an observation by name.
        observation: ``(n, size)`` float32, of the present state.
        true_observation: the observation made from ``clips``; without ``shown`` the same as
            ``observation``.
        reward: ``(n,)``; reward_terms: ``(n, terms)`` in the order of ``reward_names``.
        error: ``(n,)`` mean distance of the links from the reference in metres.
        fell, ended, unstable: ``(n,)`` bool of the last step: the error passed its limit (or
            the physics failed), the clip ended, the physics was not finite or ran out of memory.
        clip, frame: ``(n,)`` clip being played and present row of the reference.
        bodies: stature and proportions of each avatar.
        heights, user_heights, masses: ``(n,)`` stature of the avatars and of their users in metres,
            and mass of the avatars in kg.
        placement, pusher, objects, signals: see ``Surroundings``.
        unstable_count: total number of resets because the physics was unstable.
    """

    def __init__(
        self,
        clips: Sequence[Clip],
        config: EnvConfig | None = None,
        num_envs: int | None = None,
        seed: int = 0,
        num_threads: int = 1,
        shown: Sequence[Clip] | None = None,
        begin_at: Mapping[str, Clip] | None = None,
    ) -> None:
        self.config = config or EnvConfig()
        self.num_envs = n = len(clips) if num_envs is None else num_envs
        _check_counts(self.config, n, num_threads, len(clips))
        clips = on_their_bodies(clips, self.config, n, seed)
        self.reference = seen = Reference.of(clips, self.config, seed)
        if shown is not None:
            check_are_clips(shown, "shown")
            shown = on_their_bodies(shown, self.config, n, seed)
            check_shown(clips, shown)
            seen = Reference.of(shown, self.config, seed)
        self.avatar = avatar_of(self.config.body)
        self.bodies = Bodies(clips, self.config, n, self.reference.heights, seed)
        self.heights, self.user_heights = self.bodies.heights, self.bodies.user_heights
        ratio = self.user_heights / self.avatar.base_m
        estimates = estimates_of(begin_at, self.config, self.bodies, self.reference)
        self._build_batch(num_threads, seed)
        self._streams = Streams(n, seed, 0)
        sampling, of_clip = self.config.sampling, self.bodies.of_clip
        self._sampler = Sampler(
            self.reference, sampling != "uniform", sampling == "kind",
            of_clip=of_clip if self.bodies.differ else None,
        )  # fmt: skip
        self._all = np.arange(n)
        self._around = Surroundings(self.config, self.reference, ratio, self.batch, seed)
        self.placement, self.pusher = self._around.placement, self._around.pusher
        self.objects, self.signals = self._around.objects, self._around.signals
        self._initial = InitialStates(
            self.config, self.reference, self.bodies, ratio, self.placement, self._around.starts,
            estimates, self._clearance_in,
        )  # fmt: skip
        self._begin_episodes(ratio)
        references = (self.reference,) if shown is None else (self.reference, seen)
        self._runner = KernelRunner(
            self.config, self._physics.state, self._episodes, self._around, references,
            self._previous_force, num_threads,
        )  # fmt: skip
        self._make_outputs()

    def _make_outputs(self) -> None:
        """The arrays that interfaces read after each step."""
        n, scores = self.num_envs, self._runner.scores
        self.layout = self._runner.layout
        self.true_observation = self._runner.views[0].observation
        self.observation = self._runner.views[-1].observation
        self.reward, self.error, self.reward_terms = scores.reward, scores.error, scores.terms
        self.reward_names = self.config.reward.terms
        if len(self.reward_names) > len(COMPILED):
            self.reward_terms = np.zeros((n, len(self.reward_names)))
        self.fell, self.ended = np.zeros(n, bool), np.zeros(n, bool)
        self.unstable, self._counted = np.zeros(n, bool), np.zeros(n, bool)
        self.unstable_count = 0

    def _begin_episodes(self, ratio: np.ndarray) -> None:
        """Arrays of the episodes, which every kernel reads."""
        n = self.num_envs
        self.clip, self.frame = np.zeros(n, np.int64), np.zeros(n, np.int64)
        self._end, self._first = np.zeros(n, np.int64), np.zeros(n, np.int64)
        self._begin = np.zeros(n, np.int64)
        self._previous_force = np.zeros((n, 2))
        place, scale = self.placement.place, self.bodies.scale(self.config)
        self._episodes = Episodes(self.frame, self._begin, self._end, place, ratio, scale)

    def _build_batch(self, num_threads: int, seed: int) -> None:
        self.body, models = models_of(self.bodies, self.config, self.avatar, seed)
        self.substeps = self.body.substeps
        self._physics = physics = Physics(models, num_threads)
        self.batch, self.torque_limits = physics.batch, physics.torque_limits
        self.qpos, self.qvel, self.ctrl = physics.qpos, physics.qvel, physics.ctrl
        self.contact_force = physics.state.foot_force
        dofs, links = len(self.avatar.dofs), len(self.avatar.links)
        self._positions, self._velocities = 7 + dofs, 6 + dofs
        self._links = slice(1, 1 + links)
        self.masses = np.array([m.body_mass[self._links].sum() for m in models])
        self.renew_forces: Callable[[], None] | None = None

    # -- read by evaluation and rendering --------------------------------------------------

    @property
    def link_positions(self) -> np.ndarray:
        """``(n, 16, 3)`` world positions of the links in metres."""
        return self._physics.state.xpos[:, self._links]

    @property
    def link_quats(self) -> np.ndarray:
        """``(n, 16, 4)`` world orientations of the links, wxyz."""
        return self._physics.state.xquat[:, self._links]

    @property
    def joint_angles(self) -> np.ndarray:
        """``(n, 33)`` rad."""
        return self.qpos[:, 7 : self._positions]

    @property
    def floor(self) -> np.ndarray:
        """``(n,)`` height in metres of the ground under each avatar, the origin of frame S."""
        return self._runner.floor

    def placed_clip(self, i: int, clip: Clip) -> Clip:
        """Reference of simulation ``i`` in the world.

        Args:
            i: the simulation.
            clip: the clip that it plays. The reference is this clip, scaled, moved to its place,
                with its feet adapted to the ground there.
        """
        from questsim.motion.reproportion import with_proportions  # late: for rendering and scores

        if self.config.body is not None:
            height = float(self.user_heights[i])
            scaled = bodies.clip_for(self.config.body, clip).scaled(height)
        else:
            scaled = clip.scaled(float(self.user_heights[i]))
            scaled = with_proportions(scaled, self.bodies.proportions[i])
        return self._around.placed_clip(i, scaled, int(self._first[i]))

    @property
    def foot_clearance(self) -> np.ndarray:
        """``(n, 2)`` height in metres of each foot's lowest sole point above the floor below it."""
        return self._clearance(self._all)

    def _clearance(self, ids: np.ndarray) -> np.ndarray:
        position, quat = self.link_positions[ids], self.link_quats[ids]
        return self.avatar.clearance(position, quat, self.heights[ids], self.placement.field)

    # -- episodes --------------------------------------------------------------------------

    def reset(self, ids: np.ndarray | None = None, clip: int | None = None, frame: int = 0) -> None:
        """Begin episodes in the simulations ``ids`` (all, if None).

        Args:
            ids: sorted simulation indices.
            clip: clip to play; None draws one.
            frame: first frame within that clip.
        """
        ids = self._all if ids is None else ids
        if clip is not None:
            self.bodies.check_plays(ids, clip)
            clips, first = np.full(len(ids), clip), np.full(len(ids), frame)
        elif self.config.fixed_start:
            clips, first = ids, np.zeros(len(ids), np.int64)
        else:
            groups = self.bodies.of_sim[ids] if self.bodies.differ else None
            clips, first = self._sampler.draw(self._streams.draw(ids, 2), groups)
        reference = self.reference
        self.clip[ids], self._first[ids] = clips, first
        self.frame[ids] = reference.start[clips] + first
        self._begin[ids], self._end[ids] = reference.start[clips], reference.end[clips]
        rows = self.frame[ids]
        self.placement.draw(ids, clips)
        self.batch.reset(ids, stage=int(mujoco.mjtStage.mjSTAGE_NONE.value))
        self._runner.fill_targets(ids)
        self._physics.stopped[ids], self._counted[ids] = False, False
        qpos, qvel = self._initial.draw(ids, rows, clips, self._runner.target)
        self.qpos[ids, : self._positions], self.qvel[ids, : self._velocities] = qpos, qvel
        self._around.begin(ids, rows, clips)
        self._physics.forward(ids)
        self.contact_force[ids] = 0.0
        self._previous_force[ids] = 0.0
        self._runner.observe(ids)

    def _clearance_in(self, ids: np.ndarray, qpos: np.ndarray) -> np.ndarray:
        """Height ``(m,)`` above the ground of the lowest sole point in poses ``(m, 40)``."""
        self.qpos[ids, : self._positions] = qpos
        self._physics.forward(ids, POSITION)
        return self._clearance(ids).min(axis=-1)

    def step(self, action: np.ndarray) -> None:
        """Advance 1/36 s under torques ``action * torque_limits``, and score the new state.

        Simulations that fell or ended stay where they are until ``reset``.

        Args:
            action: ``(n, 33)``, clipped to [-1, 1].

        Raises:
            InputError: actions of another shape, or not finite; nothing has moved then.
        """
        np.clip(checked_actions(action, self.ctrl.shape), -1.0, 1.0, out=self.ctrl)
        self.ctrl *= self.torque_limits
        self.pusher.apply()
        self._physics.step(self.substeps, self.renew_forces)
        self._after_step()

    def show(self, pose: np.ndarray) -> None:
        """Advance one frame kinematically: set the poses ``(n, 40)``, without physics.

        Velocities are finite differences of poses; contact forces are zero.
        """
        before, after = self.qpos[:, : self._positions], np.asarray(pose, float)
        turn = rot.quat_multiply(rot.quat_conjugate(before[:, 3:7]), after[:, 3:7])
        self.qvel[:, :3] = FPS * (after[:, :3] - before[:, :3])
        self.qvel[:, 3:6] = FPS * rot.as_rotation(turn).as_rotvec()
        self.qvel[:, 6 : self._velocities] = FPS * (after[:, 7:] - before[:, 7:])
        self.qpos[:, : self._positions] = after
        self._physics.forward()
        self._after_step(physics=False)

    def _after_step(self, physics: bool = True) -> None:
        self._previous_force[:] = self.contact_force[..., 2]
        if physics:
            # The sensor reports the force of each foot on the floor.
            np.negative(self._physics.sensors[:, :6].reshape(-1, 2, 3), out=self.contact_force)
        self.frame += 1
        np.minimum(self.frame, self._end - 1, out=self.frame)
        self._runner.score()
        if self.reward_terms is not self._runner.scores.terms:
            self._add_extra_terms()
        self.unstable[:] = self._physics.unstable()
        self.unstable |= ~np.isfinite(self.error + self.reward)
        # A simulation stays unstable until its reset; count it once per episode.
        self.unstable_count += int((self.unstable & ~self._counted).sum())
        self._counted |= self.unstable
        self.reward[self.unstable], self.reward_terms[self.unstable] = 0.0, 0.0
        np.logical_or(self.error > self.config.max_error_m, self.unstable, out=self.fell)
        np.logical_and(self.frame >= self._end - 1, ~self.fell, out=self.ended)
        self.signals.advance(self.frame + self.config.frame_offsets[-1] - self.signals.late)
        self._recentre()
        self._runner.observe(self._all)
        if self.unstable.any():
            for view in self._runner.views:
                broken = view.observation[self.unstable]
                view.observation[self.unstable] = np.nan_to_num(broken, posinf=0.0, neginf=0.0)

    def _recentre(self) -> None:
        """Move the users that jump in this frame; its score is still of the old place."""
        randomisation = self.config.randomisation
        if randomisation is None or not randomisation.recentres:
            return
        since = self.frame - self.reference.start[self.clip] - self._first
        running = self.frame < self._end - 1
        root = self._runner.views[0].target.position[:, 0, 0, :2]
        ids = self._around.faults.recentre(np.where(running, since, -1), self.placement.place, root)
        if len(ids):
            self._runner.fill_targets(ids)

    def record_ended(self, ids: np.ndarray) -> None:
        """Tell the sampler how the episodes of ``ids`` ended; call before their ``reset``."""
        first = self._first[ids]
        length = self.frame[ids] - self.reference.start[self.clip[ids]] - first
        self._sampler.record(self.clip[ids], first, length, self.fell[ids])

    def _add_extra_terms(self) -> None:
        """Reward terms that are not compiled, for the whole batch in one thread."""
        reward, first = self.config.reward, len(COMPILED)
        extra = finite_extra_terms(reward, self.moment(), np.isfinite(self.reward + self.error))
        self.reward_terms[:, :first] = self._runner.scores.terms
        self.reward_terms[:, first:] = extra
        self.reward += extra @ reward.weights[first:]

    def moment(self) -> Moment:
        """Data of the last step that reward terms read."""
        runner = self._runner
        return moment_of(
            self._physics.state, self._episodes, runner.views[0].rows, runner.target,
            torque=self.ctrl, torque_limits=self.torque_limits,
            previous_force=self._previous_force,
        )  # fmt: skip

    def seed(self, seeds: Seeds) -> None:
        """Seed the random streams of episodes: clips, frames and everything else drawn per episode.

        Randomised bodies, latencies and noise are drawn once, when the batch is made, and do not
        change. Learned failure rates are reset.

        Args:
            seeds: one for all, or one for each simulation; None keeps the streams of that one.
        """
        self._streams.seed(seeds)
        self._around.seed(seeds)
        self._sampler.forget()

    @property
    def sampler(self) -> Sampler:
        """Where episodes begin; it learns where the policy falls."""
        return self._sampler

    def get_state(self) -> dict[str, Any]:
        """State that determines all later steps: random numbers, sampler, episodes and physics."""
        return {
            "rng": self._streams.get_state(),
            "sampler": self._sampler.get_state(),
            "unstable_count": self.unstable_count,
            "episodes": {name: getattr(self, name).copy() for name in _EPISODE},
            "physics": self.batch.state.copy(),
            "surroundings": self._around.get_state(),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore the result of ``get_state`` and observe; later steps repeat bit for bit.

        Raises:
            InputError: the state has a different number of simulations.
        """
        if state["physics"].shape != self.batch.state.shape:
            count = len(state["physics"])
            what = f"the state is of {count} simulations, this batch has {self.num_envs}"
            raise InputError(what, "resume", f"use {count}")
        self._streams.set_state(state["rng"])
        self._sampler.set_state(state["sampler"])
        self.batch.reset(stage=int(mujoco.mjtStage.mjSTAGE_NONE.value))
        self.batch.state[:] = state["physics"]
        self._physics.forward()
        for name in _EPISODE:
            getattr(self, name)[:] = state["episodes"][name]
        self._begin[:] = self.reference.start[self.clip]
        self._around.set_state(state["surroundings"])
        self.unstable_count = state["unstable_count"]
        self._runner.fill_targets(self._all)
        self._runner.observe(self._all)

    def close(self) -> None:
        """Stop the threads."""
        self._runner.close()


def _check_counts(config: EnvConfig, num_envs: int, num_threads: int, clips: int) -> None:
    if clips:  # without any, `Reference.of` says so
        check_count("num_envs", num_envs)
    check_count("num_threads", num_threads)
    if config.fixed_start and num_envs > clips:
        raise InputError(f"num_envs is {num_envs}, more than the {clips} clips", "fixed_start")
