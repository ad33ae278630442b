"""Run and score each agent of a comparison, clip by clip, on several processes."""

from __future__ import annotations

import multiprocessing
import signal
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch

from agents.comparison.behind import Shown, follow, shown_of
from agents.comparison.conditions import Noise, Start, called, noisy, starts_of, with_noise
from agents.comparison.record import Record
from agents.comparison.report import RECORDING, Costs, Row, row_of
from agents.comparison.scenarios import PAPER_NAMES, WINDOW, Scenario, faulty, scenarios
from agents.comparison.summary import Summary, summarise
from agents.evaluation.follow import evaluation_sim
from agents.evaluation.mapping import Mapper
from agents.evaluation.rollout import env_config, roll_out
from agents.kinematic.causal import causal_clip
from agents.kinematic.efficiency import mmac_a_frame, stream_kib
from agents.kinematic.first_answers import first_answers
from agents.kinematic.interface import KinematicSystem, Poses, UserBody
from agents.kinematic.physics_behind import (
    TRACKER,
    avatar_samples,
    reference_of,
    rollout_samples,
)
from agents.kinematic.recurrent.poser import RecurrentPoser
from agents.kinematic.store import load_system
from agents.loading import load_agent
from agents.policy.policy_agent import PolicyAgent
from agents.resolve import base_of, resolve
from agents.training.ray_session import ray_map
from questsim.errors import InputError
from questsim.extensions import load_extensions
from questsim.joint_sensors import SENSOR_FPS, SensorSequence, readings
from questsim.motion.clip import FPS, Clip
from questsim.motion.motion import Motion
from questsim.motion.retarget import to_clip
from questsim.pose_metrics import ENDS, pose_samples
from questsim.root_force import root_force
from questsim.sensors import SENSOR_SETS

TIMED_FRAMES = 600
"""Number of frames over which streaming is timed."""

CHUNK = 48
"""Clips that are simulated together."""


def _begin_process() -> None:
    # Ctrl-C is the parent's to answer.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    load_extensions()
    torch.set_num_threads(1)


@contextmanager
def workers(count: int, on_ray: int = 0, ray: str | None = None) -> Iterator[Mapper]:
    """A ``map`` on several processes with one thread each; results have the same bits.

    Threads would not help: Python code takes most of a frame's time.

    Args:
        count: processes of this machine.
        on_ray: Ray workers that are used instead, if any.
        ray: address of their cluster.

    Raises:
        InputError: see ``ray_map``.
    """
    torch.set_num_threads(1)
    if on_ray or ray is not None:
        with ray_map(on_ray, ray) as mapper:
            yield mapper
        return
    if count == 1:
        yield map
        return
    with ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _begin_process) as pool:
        yield pool.map


def devices_named(sensors: str | None) -> tuple[str, ...] | None:
    """The devices of ``--sensors``; None if it is not given.

    Raises:
        InputError: there is no such set.
    """
    if sensors is None:
        return None
    if sensors not in SENSOR_SETS:
        known = ", ".join(SENSOR_SETS)
        raise InputError(f"unknown sensor set {sensors!r}", "--sensors", f"choose from {known}")
    return SENSOR_SETS[sensors]


def suiting(agent: str, devices: Sequence[str] | None) -> list[Scenario]:
    """The scenarios that an agent supports; with ``--sensors``, only those of its devices.

    Raises:
        InputError: there is no such agent.
    """
    if resolve(agent).torques:
        sensors = load_agent(agent).needs.sensors
        name = PAPER_NAMES.get(sensors, sensors)
        found: Sequence[Scenario] = [Scenario(name, SENSOR_SETS[sensors])]
    else:
        base = base_of(agent)
        found = scenarios(load_system(base or agent))
        if base is not None:
            found = [scenario for scenario in found if scenario.plain]
    return [scenario for scenario in found if scenario.has(devices)]


Job = tuple[str, Scenario, Motion, int, Noise | None]
"""Agent, scenario, motion, seed and fault of the devices."""


@dataclass(frozen=True)
class Plan:
    """Rows of one agent in one scenario, which are computed together.

    Attributes:
        agent, scenario: of the rows.
        noise: fault of the devices.
        starts: of the avatar; empty for a kinematic system without physics.
    """

    agent: str
    scenario: Scenario
    noise: Noise | None = None
    starts: tuple[Start, ...] = ()

    @property
    def rows(self) -> list[str]:
        """Scenarios of the rows; with physics the one without comes first."""
        name = self.scenario.name
        if not self.starts:
            return [called(name, self.noise)]
        found = [called(name, self.noise, start) for start in self.starts]
        if base_of(self.agent) is not None:
            found.insert(0, called(name, self.noise) + ", no physics")
        return found

    def job(self, motion: Motion, seed: int) -> Job:
        """The work on one motion."""
        return self.agent, self.scenario, motion, seed, self.noise

    def key(self, row: str) -> str:
        """Name of a row in the record."""
        return f"{self.agent}: {row}"


def compute(
    plan: Plan,
    motions: Sequence[Motion],
    seed: int,
    threads: int,
    mapper: Mapper,
    record: Record,
    whole: bool = False,
) -> Iterator[int]:
    """Score the clips that the record lacks; yields how many are done after each step.

    Args:
        plan, motions, seed, threads, mapper, record: see ``Plan`` and ``workers``.
        whole: with physics, ``mapper`` runs whole chunks: physics runs where the mapper does.
    """
    names = [motion.name for motion in motions]
    missing = record.missing([plan.key(row) for row in plan.rows], names)
    if not plan.starts:
        jobs = [plan.job(motions[i], seed + i) for i in missing]
        key = plan.key(plan.rows[0])
        function = _scored_itself if plan.agent == RECORDING else _scored
        for i, summary in zip(missing, mapper(function, jobs), strict=True):
            record.add(key, names[i], summary)
            yield 1
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
        scored = _behind if base_of(plan.agent) is not None else _policy
        done = (scored(plan, chunk, threads, mapper) for chunk in chunks)
    for part, rows in zip(parts, done, strict=True):
        for row, summaries in rows:
            for i, summary in zip(part, summaries, strict=True):
                record.add(plan.key(row), names[i], summary)
        yield len(part)


def _whole_chunk(job: tuple[Plan, Sequence[Job]]) -> list[tuple[str, list[Summary]]]:
    plan, chunk = job
    scored = _behind if base_of(plan.agent) is not None else _policy
    return list(scored(plan, chunk, 1, map))


# -- a system ----------------------------------------------------------------------------------


@lru_cache(maxsize=2)
def _loaded(agent: str, options: tuple[tuple[str, Any], ...]) -> KinematicSystem:
    return load_system(agent, **dict(options))


def run(
    agent: str, scenario: Scenario, motions: Sequence[Motion], seed: int, mapper: Mapper = map
) -> Row:
    """Reconstruct all motions in one scenario and score them."""
    jobs: list[Job] = [
        (agent, scenario, motion, seed + i, None) for i, motion in enumerate(motions)
    ]
    return row_of(
        agent, scenario.name, list(mapper(_scored, jobs)), costs(agent, scenario, motions)
    )


def costs(agent: str, scenario: Scenario, motions: Sequence[Motion]) -> Costs:
    """What a streamed frame of a kinematic system costs, on this thread."""
    system = _loaded(agent, scenario.options)
    found = Costs(parameters(system), streamed_ms(agent, scenario, motions))
    if scenario.online or not found.parameters:
        return found
    sequence = readings(motions[0], scenario.devices)
    mmac = mmac_a_frame(system, sequence, UserBody.of(motions[0]))
    return replace(found, mmac=mmac, stream_kib=stream_kib(system))


def _scored(job: Job) -> Summary:
    return summarise(_samples(reconstructed(job), job[2], job[1].ends), SENSOR_FPS)


def _scored_itself(job: Job) -> Summary:
    """Of the motions themselves: no errors, but their own skating, jitter and floating."""
    motion = job[2]
    offsets = np.broadcast_to(motion.offsets, (len(motion), *motion.offsets.shape))
    poses = Poses(motion.root_position, motion.rotations, offsets)
    return summarise(_samples(poses, motion), SENSOR_FPS)


def _samples(poses: Poses, motion: Motion, ends: Sequence[int] = ENDS) -> dict[str, np.ndarray]:
    want, _ = motion.forward_kinematics()
    got, _ = poses.forward_kinematics()
    samples = pose_samples(got, poses.rotations, want, motion.rotations, motion.fps, ends)
    try:
        force = root_force(to_clip(poses.to_motion(motion.name)))
    except InputError:  # no avatar has this stature
        force = np.zeros(0)
    return samples | {"root_force_bw": force}


def reconstructed(job: Job) -> Poses:
    """A system's estimate of a motion at 60 Hz, streamed or each frame from its window."""
    agent, scenario, motion = job[:3]
    system, sequence, body = _loaded(agent, scenario.options), _told(job), UserBody.of(motion)
    if scenario.online:
        assert isinstance(system, RecurrentPoser)
        return system.predict_windows(sequence, body, WINDOW)
    return system.predict(sequence, body)


def _told(job: Job) -> SensorSequence:
    """The device signals, with the scenario's faults and the comparison's noise."""
    _, scenario, motion, seed, noise = job
    sequence = noisy(readings(motion, scenario.devices), noise, seed)
    return faulty(sequence, scenario.faults, seed) if scenario.faults else sequence


def streamed_ms(agent: str, scenario: Scenario, motions: Sequence[Motion]) -> float | None:
    """Milliseconds per frame on one thread over the first frames; None for windows."""
    if scenario.online:
        return None
    seconds, frames = 0.0, 0
    for i, motion in enumerate(motions):
        system = _loaded(agent, scenario.options)
        sequence = _told((agent, scenario, motion, i, None))
        system.reset(UserBody.of(motion), sequence.names)
        count = min(len(sequence), TIMED_FRAMES - frames)
        told = [sequence[t] for t in range(count)]
        began = time.perf_counter()
        for frame in told:
            system.step(frame)
        seconds, frames = seconds + time.perf_counter() - began, frames + count
        if frames >= TIMED_FRAMES:
            break
    return 1000.0 * seconds / frames


def parameters(system: KinematicSystem) -> int:
    """Number of parameters of a system's networks; 0 without networks."""
    module = getattr(system, "module", None)
    return sum(p.numel() for p in module.parameters()) if module is not None else 0


# -- with physics ------------------------------------------------------------------------------


Scored = Iterator[tuple[str, list[Summary]]]


def _behind(plan: Plan, jobs: Sequence[Job], threads: int, mapper: Mapper) -> Scored:
    """A system's poses on the avatar without physics, then with physics from each start."""
    based = [(base_of(plan.agent) or plan.agent, *job[1:]) for job in jobs]
    shown = list(mapper(shown_to, based))
    truths = list(mapper(to_clip, [job[2] for job in jobs]))
    ends, rows = plan.scenario.ends, iter(plan.rows)
    without = [
        summarise(avatar_samples(each.clip, truth, ends), FPS)
        for each, truth in zip(shown, truths, strict=True)
    ]
    yield next(rows), without
    for row, start in zip(rows, plan.starts, strict=True):
        pairs = zip(follow(shown, start, threads), truths, strict=True)
        scored = [
            rollout_samples(replace(rollout, reference=truth), ends) for rollout, truth in pairs
        ]
        yield row, [summarise(samples, FPS) for samples in scored]


def shown_to(job: Job) -> Shown:
    """What the tracker behind a kinematic system is shown."""
    return shown_of(reconstructed(job), job[2])


def reference(job: Job) -> Clip:
    """The avatar's reference: a system's poses retargeted to it."""
    return reference_of(reconstructed(job), job[2])


def _policy(plan: Plan, jobs: Sequence[Job], threads: int, mapper: Mapper) -> Scored:
    """A torque policy on the same motions, with the devices it was trained with."""
    policy, clips = load_agent(plan.agent), list(mapper(to_clip, [job[2] for job in jobs]))
    for row, start in zip(plan.rows, plan.starts, strict=True):
        config = with_noise(env_config(policy), plan.noise)
        config = replace(config, starts=starts_of(start))
        begin_at = first_answers(clips) if start == "estimate" else None
        rollouts = roll_out(policy, clips, config, threads, begin_at=begin_at)
        yield row, [summarise(rollout_samples(r, plan.scenario.ends), FPS) for r in rollouts]


def plan_costs(plan: Plan, motions: Sequence[Motion]) -> list[Costs]:
    """Costs of the rows of a plan, in their order; with noise only the sizes."""
    base = base_of(plan.agent)
    if plan.agent == RECORDING:
        return [Costs()]
    if plan.starts and base is None:
        whole = Costs(_policy_size(plan.agent))
        if plan.noise is None:
            whole = replace(whole, ms=policy_ms(plan.agent, motions))
        return [whole] * len(plan.rows)
    system = base or plan.agent
    alone = Costs(parameters(_loaded(system, plan.scenario.options)))
    if plan.noise is None:
        alone = costs(system, plan.scenario, motions)
    if not plan.starts:
        return [alone]
    alone = replace(alone, mmac=None, stream_kib=None)
    whole = replace(alone, parameters=alone.parameters + _policy_size(TRACKER))
    if alone.ms is not None:
        # A frame of the avatar lasts 1/36 s, one of the system 1/60 s.
        extra = (policy_ms(TRACKER, motions) + retargeted_ms(motions)) * FPS / SENSOR_FPS
        whole = replace(whole, ms=alone.ms + extra)
    return [alone, *[whole] * len(plan.starts)]


def policy_ms(agent: str, motions: Sequence[Motion]) -> float:
    """Milliseconds per 36 Hz frame of a policy and its physics: one avatar on one thread."""
    policy, clip = load_agent(agent), to_clip(max(motions, key=len))
    sim = evaluation_sim([clip], env_config(policy))
    try:
        policy.bind(sim)
        sim.reset()
        policy.reset(1)
        count = min(len(clip) - 2, TIMED_FRAMES)
        began = time.perf_counter()
        for _ in range(count):
            sim.step(policy.act(sim.observation))
        return 1000.0 * (time.perf_counter() - began) / count
    finally:
        sim.close()


def retargeted_ms(motions: Sequence[Motion]) -> float:
    """Milliseconds per 36 Hz frame of retargeting poses as they come."""
    motion = max(motions, key=len)
    began = time.perf_counter()
    clip = causal_clip(motion)
    return 1000.0 * (time.perf_counter() - began) / len(clip)


def _policy_size(agent: str) -> int:
    loaded = load_agent(agent)
    if not isinstance(loaded, PolicyAgent):
        return 0
    return sum(p.numel() for p in loaded.policy.parameters())
