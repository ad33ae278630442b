"""Evaluate one kinematic system, with or without physics, clip by clip."""

from __future__ import annotations

import time
from collections.abc import Sequence

from agents.evaluation.assisted import AssistUse
from agents.evaluation.mapping import Mapper
from agents.kinematic.estimates import Job, estimated
from agents.kinematic.physics_behind import follow_poses, reference_of
from agents.kinematic.without_physics import pose_rollout
from questsim.metrics import Rollout
from questsim.motion.clip import Clip


def estimated_rollouts(jobs: Sequence[Job], mapper: Mapper = map) -> list[Rollout]:
    """A system's estimates on the avatar, without physics.

    Args:
        jobs: a motion each.
        mapper: runs the jobs, see ``process_map``.
    """
    began = time.perf_counter()
    found = list(mapper(estimated, jobs))
    share = (time.perf_counter() - began) / sum(len(job.motion) for job in jobs)
    return [
        pose_rollout(poses, job.motion, share * len(job.motion))
        for poses, job in zip(found, jobs, strict=True)
    ]


def simulated_rollouts(
    jobs: Sequence[Job],
    threads: int = 1,
    assist: AssistUse | None = None,
    mapper: Mapper = map,
    physics_mapper: Mapper = map,
) -> list[Rollout]:
    """Rollouts of an avatar that follows a system's estimates.

    Args:
        jobs: a motion each.
        threads, assist: see ``follow_poses``.
        mapper: runs the estimates, see ``process_map``.
        physics_mapper: runs the batches of the simulation.
    """
    references = list(mapper(reference, jobs))
    motions = [job.motion for job in jobs]
    return follow_poses(references, motions, threads, assist, physics_mapper)


def reference(job: Job) -> Clip:
    """The avatar's reference: a system's estimates retargeted to it."""
    return reference_of(estimated(job), job.motion)
