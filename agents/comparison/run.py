"""Run and score each agent of a comparison, clip by clip, on several processes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from agents.comparison.behind import Shown, follow_shown, shown_of
from agents.comparison.conditions import Start, row_name, starts_of, with_noise
from agents.comparison.options import Slow
from agents.comparison.record import Record
from agents.comparison.report import RECORDING
from agents.comparison.summary import Summary, sums_of
from agents.evaluation.mapping import Mapper
from agents.evaluation.rollout import env_config, roll_out
from agents.kinematic.device_faults import Noise
from agents.kinematic.estimates import Job, estimated_together, loaded, scenarios_of
from agents.kinematic.first_answers import begun, begun_in_estimates
from agents.kinematic.interface import Poses
from agents.kinematic.physics_behind import avatar_samples, rollout_samples
from agents.kinematic.scenario import PAPER_NAMES, Scenario
from agents.loading import load_agent
from agents.resolve import Resolved, resolve
from questsim.errors import InputError
from questsim.joint_sensors import SENSOR_FPS
from questsim.motion.clip import FPS
from questsim.motion.motion import Motion
from questsim.motion.retarget import to_clip
from questsim.pose_metrics import ENDS, pose_samples
from questsim.root_force import root_force
from questsim.sensors import SENSOR_SETS

CHUNK = 48
"""Clips that are simulated together."""


def suiting(agent: str | Resolved) -> list[Scenario]:
    """The scenarios that an agent supports.

    Raises:
        InputError: there is no such agent.
    """
    resolved = resolve(agent)
    if not resolved.torques:
        return scenarios_of(resolved)
    sensors = load_agent(resolved).needs.sensors
    return [Scenario(PAPER_NAMES.get(sensors, sensors), SENSOR_SETS[sensors])]


@dataclass(frozen=True)
class Plan:
    """Rows of one agent in one scenario, which are computed together.

    Attributes:
        agent: of the rows; None for the motions themselves.
        scenario: of the rows.
        noise: fault of the devices.
        starts: of the avatar; empty for a kinematic system without physics.
        kept: whether a plan with physics needs the estimates after this one.
        further: whether another plan has the first start, and with it the row without physics.
    """

    agent: Resolved | None
    scenario: Scenario
    noise: Noise | None = None
    starts: tuple[Start, ...] = ()
    kept: bool = False
    further: bool = False

    @property
    def name(self) -> str:
        """Name of the agent in the table."""
        return RECORDING if self.agent is None else self.agent.name

    @property
    def system(self) -> str | None:
        """The kinematic system that is scored or followed; None for policies and the motions."""
        return self.agent.base if self.agent is not None and not self.agent.torques else None

    @property
    def slow(self) -> set[Slow]:
        """Why it takes more time than a kinematic system that streams exact signals."""
        reasons: dict[Slow, bool] = {
            "avatars": bool(self.starts),
            "starts": self.further,
            "noise": self.noise is not None,
            "options": not self.scenario.plain,
        }
        return {reason for reason, holds in reasons.items() if holds}

    @property
    def rows(self) -> list[str]:
        """Scenarios of the rows; of a system with physics, the one without comes first."""
        name = self.scenario.name
        if not self.starts:
            return [row_name(name, self.noise)]
        found = [row_name(name, self.noise, start) for start in self.starts]
        if self.system is not None and not self.further:
            found.insert(0, row_name(name, self.noise) + ", no physics")
        return found

    def job(self, motion: Motion, seed: int) -> Job:
        """The work on one motion."""
        return Job(self.system or self.name, self.scenario, motion, seed, self.noise)

    def key(self, row: str) -> str:
        """Name of a row in the record."""
        return f"{self.name}: {row}"


class KeptPoses:
    """The poses of the last system and scenario, so that rows with physics use them again."""

    def __init__(self) -> None:
        self._of: tuple[str, Scenario, Noise | None] | None = None
        self._poses: dict[str, Poses] = {}

    def of(self, plan: Plan) -> dict[str, Poses]:
        """The poses kept so far by the name of their motion; those of another plan are dropped."""
        what = (plan.system or plan.name, plan.scenario, plan.noise)
        if self._of != what:
            self._of, self._poses = what, {}
        return self._poses


def compute(
    plan: Plan,
    motions: Sequence[Motion],
    seed: int,
    threads: int,
    mapper: Mapper,
    record: Record,
    estimates: KeptPoses,
    whole: bool = False,
) -> Iterator[int]:
    """Score the clips that the record lacks; yields how many are done after each step.

    Args:
        plan, motions, seed, threads, mapper, record: see ``Plan`` and ``workers``.
        estimates: poses of the plan before, if it is of the same system and scenario.
        whole: with physics, ``mapper`` runs whole chunks: physics runs where the mapper does.
    """
    names = [motion.name for motion in motions]
    missing = record.missing([plan.key(row) for row in plan.rows], names)
    kept = estimates.of(plan)
    if not plan.starts:
        key = plan.key(plan.rows[0])
        together = list(_parts([plan.job(motions[i], seed + i) for i in missing]))
        for jobs, found in zip(together, mapper(_score, together), strict=True):
            for job, (poses, summary) in zip(jobs, found, strict=True):
                if poses is not None and plan.kept:
                    kept[job.motion.name] = poses
                record.add(key, job.motion.name, summary)
            yield len(jobs)
        return
    # The same batches, whatever is missing: noise is drawn by the place in the batch.
    parts = [
        range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(motions)))
        for chunk in sorted({i // CHUNK for i in missing})
    ]
    chunks = [[plan.job(motions[i], seed + i) for i in part] for part in parts]
    if whole:
        done = mapper(_whole_chunk, [(plan, chunk) for chunk in chunks])
    else:
        done = (simulated(plan, chunk, threads, mapper, kept) for chunk in chunks)
    for part, rows in zip(parts, done, strict=True):
        for row, summaries in rows:
            for i, summary in zip(part, summaries, strict=True):
                record.add(plan.key(row), names[i], summary)
        yield len(part)


def simulated(
    plan: Plan, jobs: Sequence[Job], threads: int, mapper: Mapper, kept: dict[str, Poses]
) -> ScoredRows:
    """Rows of a policy or of a system with physics: name and sums of each clip.

    Args:
        plan, jobs: of the rows; physics runs all jobs together.
        threads, mapper: see ``workers``.
        kept: known estimates by the name of their motion; gets the others.
    """
    if plan.system is None:
        return _policy(plan, jobs, threads, mapper)
    return _behind(plan, jobs, threads, mapper, _all_poses(jobs, mapper, kept))


def _whole_chunk(job: tuple[Plan, Sequence[Job]]) -> list[tuple[str, list[Summary]]]:
    plan, chunk = job
    return list(simulated(plan, chunk, 1, map, {}))


def _parts(jobs: Sequence[Job]) -> Iterator[list[Job]]:
    """Jobs that a system does together, of motions of similar length."""
    if not jobs:
        return
    size = (
        1 if jobs[0].agent == RECORDING else loaded(jobs[0].agent, jobs[0].scenario.options).at_once
    )
    ordered = sorted(jobs, key=lambda job: len(job.motion)) if size > 1 else jobs
    for first in range(0, len(ordered), size):
        yield list(ordered[first : first + size])


def _all_poses(jobs: Sequence[Job], mapper: Mapper, kept: dict[str, Poses]) -> list[Poses]:
    """The estimates of all jobs: those that are kept already, and the others."""
    parts = list(_parts([job for job in jobs if job.motion.name not in kept]))
    for part, found in zip(parts, mapper(estimated_together, parts), strict=True):
        kept.update({job.motion.name: poses for job, poses in zip(part, found, strict=True)})
    return [kept[job.motion.name] for job in jobs]


# -- a system ----------------------------------------------------------------------------------


def scored(jobs: Sequence[Job]) -> list[Summary]:
    """The sums of the clips of jobs of one row, in their order."""
    found = {}
    for part in _parts(jobs):
        found.update(
            {job.motion.name: summary for job, (_, summary) in zip(part, _score(part), strict=True)}
        )
    return [found[job.motion.name] for job in jobs]


def _score(jobs: list[Job]) -> list[tuple[Poses | None, Summary]]:
    """Estimates and sums of the clips of jobs of one row; of the recording itself only sums."""
    if jobs[0].agent == RECORDING:
        return [(None, _scored_itself(job)) for job in jobs]
    found = estimated_together(jobs)
    return [(poses, _scored(poses, job)) for poses, job in zip(found, jobs, strict=True)]


def _scored(poses: Poses, job: Job) -> Summary:
    return sums_of(_samples(poses, job.motion, job.scenario.ends), SENSOR_FPS)


def _scored_itself(job: Job) -> Summary:
    """Of the motions themselves: no errors, but their own skating, jitter and floating."""
    motion = job.motion
    offsets = np.broadcast_to(motion.offsets, (len(motion), *motion.offsets.shape))
    poses = Poses(motion.root_position, motion.rotations, offsets)
    return sums_of(_samples(poses, motion), SENSOR_FPS)


def _samples(poses: Poses, motion: Motion, ends: Sequence[int] = ENDS) -> dict[str, np.ndarray]:
    want, _ = motion.forward_kinematics()
    got, _ = poses.forward_kinematics()
    samples = pose_samples(got, poses.rotations, want, motion.rotations, motion.fps, ends)
    try:
        force = root_force(to_clip(poses.to_motion(motion.name)))
    except InputError:  # no avatar has this stature
        force = np.zeros(0)
    return samples | {"root_force_bw": force}


# -- with physics ------------------------------------------------------------------------------


ScoredRows = Iterator[tuple[str, list[Summary]]]


def _behind(
    plan: Plan, jobs: Sequence[Job], threads: int, mapper: Mapper, poses: Sequence[Poses]
) -> ScoredRows:
    """A system's poses on the avatar without physics, then with physics from each start."""
    motions = [job.motion for job in jobs]
    shown = list(mapper(_shown, list(zip(poses, motions, strict=True))))
    truths = list(mapper(to_clip, motions))
    ends, rows = plan.scenario.ends, iter(plan.rows)
    if not plan.further:
        yield (
            next(rows),
            [
                sums_of(avatar_samples(each.clip, truth, ends), FPS)
                for each, truth in zip(shown, truths, strict=True)
            ],
        )
    for row, start in zip(rows, plan.starts, strict=True):
        true = [begun(truth, start) for truth in truths]
        pairs = zip(follow_shown(shown, start, threads), true, strict=True)
        scored = [
            rollout_samples(replace(rollout, reference=truth), ends) for rollout, truth in pairs
        ]
        yield row, [sums_of(samples, FPS) for samples in scored]


def _shown(pair: tuple[Poses, Motion]) -> Shown:
    """What the tracker behind a kinematic system is shown."""
    return shown_of(*pair)


def _policy(plan: Plan, jobs: Sequence[Job], threads: int, mapper: Mapper) -> ScoredRows:
    """A torque policy on the same motions, with the devices it was trained with."""
    assert plan.agent is not None
    policy, clips = load_agent(plan.agent), list(mapper(to_clip, [job.motion for job in jobs]))
    for row, start in zip(plan.rows, plan.starts, strict=True):
        config = with_noise(env_config(policy), plan.noise)
        config = replace(config, starts=starts_of(start))
        follow, begin_at = begun_in_estimates(clips, start)
        rollouts = roll_out(policy, follow, config, threads, begin_at=begin_at)
        yield row, [sums_of(rollout_samples(r, plan.scenario.ends), FPS) for r in rollouts]
