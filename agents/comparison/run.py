"""Run and score each agent of a comparison, clip by clip, on several processes."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from typing import Any, Protocol, TypeVar

import numpy as np
import torch

from agents.comparison.report import RECORDING, Row, row_of
from agents.comparison.scenarios import PAPER_NAMES, WINDOW, Scenario, faulty, scenarios
from agents.evaluation.rollout import env_config, roll_out
from agents.kinematic.efficiency import mmac_a_frame, stream_kib
from agents.kinematic.interface import KinematicSystem, Poses, UserBody
from agents.kinematic.physics_behind import (
    TRACKER,
    avatar_samples,
    follow_poses,
    reference_of,
    rollout_samples,
)
from agents.kinematic.recurrent.poser import RecurrentPoser
from agents.kinematic.store import load_system
from agents.loading import load_agent
from agents.policy.policy_agent import PolicyAgent
from agents.resolve import base_of, resolve
from questsim.errors import InputError
from questsim.extensions import load_extensions
from questsim.joint_sensors import SensorSequence, readings
from questsim.motion.clip import Clip
from questsim.motion.motion import Motion
from questsim.motion.retarget import to_clip
from questsim.pose_metrics import ENDS, pose_samples
from questsim.root_force import root_force
from questsim.sensors import SENSOR_SETS

TIMED_FRAMES = 600
"""Number of frames over which streaming is timed."""

JobT = TypeVar("JobT")
ResultT = TypeVar("ResultT")


class Mapper(Protocol):
    """Like ``map``: the results of a function on every job, in order."""

    def __call__(
        self, function: Callable[[JobT], ResultT], jobs: Iterable[JobT], /
    ) -> Iterable[ResultT]:
        """The results."""
        ...


def _begin_process() -> None:
    load_extensions()
    torch.set_num_threads(1)


@contextmanager
def workers(count: int) -> Iterator[Mapper]:
    """A ``map`` on several processes with one thread each; results have the same bits.

    Threads would not help: Python code takes most of a frame's time.
    """
    torch.set_num_threads(1)
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


def rows_of(
    agent: str,
    chosen: Sequence[Scenario],
    motions: Sequence[Motion],
    seed: int,
    threads: int,
    mapper: Mapper,
) -> Iterator[Row]:
    """All rows of one agent: a system, a system with physics, or a torque policy."""
    if resolve(agent).torques:
        yield run_policy(agent, chosen[0], motions, threads)
        return
    for scenario in chosen:
        if base_of(agent) is None:
            yield run(agent, scenario, motions, seed, mapper)
        else:
            yield from run_physics(agent, scenario, motions, threads, mapper)


def run_recording(motions: Sequence[Motion], mapper: Mapper = map) -> Row:
    """The row of the motions themselves: zero errors, their own skating, jitter and floating."""
    return row_of(RECORDING, "60 Hz", 0, list(mapper(_scored_itself, motions)), None)


def _scored_itself(motion: Motion) -> dict[str, np.ndarray]:
    offsets = np.broadcast_to(motion.offsets, (len(motion), *motion.offsets.shape))
    return _samples(Poses(motion.root_position, motion.rotations, offsets), motion)


# -- a system ----------------------------------------------------------------------------------


@lru_cache(maxsize=2)
def _loaded(agent: str, options: tuple[tuple[str, Any], ...]) -> KinematicSystem:
    return load_system(agent, **dict(options))


def run(
    agent: str, scenario: Scenario, motions: Sequence[Motion], seed: int, mapper: Mapper = map
) -> Row:
    """Reconstruct all motions in one scenario and score them."""
    jobs = [(agent, scenario, motion, seed + i) for i, motion in enumerate(motions)]
    scored = list(mapper(_scored, jobs))
    system = _loaded(agent, scenario.options)
    row = row_of(agent, scenario.name, parameters(system), scored, _streamed_ms(scenario, jobs))
    if scenario.online or not row.parameters:
        return row
    sequence = readings(motions[0], scenario.devices)
    mmac = mmac_a_frame(system, sequence, UserBody.of(motions[0]))
    return replace(row, mmac=mmac, stream_kib=stream_kib(system))


Job = tuple[str, Scenario, Motion, int]


def _scored(job: Job) -> dict[str, np.ndarray]:
    return _samples(reconstructed(job), job[2], job[1].ends)


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
    agent, scenario, motion, _ = job
    system, sequence, body = _loaded(agent, scenario.options), _told(job), UserBody.of(motion)
    if scenario.online:
        assert isinstance(system, RecurrentPoser)
        return system.predict_windows(sequence, body, WINDOW)
    return system.predict(sequence, body)


def _told(job: Job) -> SensorSequence:
    """The device signals, with the scenario's faults."""
    _, scenario, motion, seed = job
    sequence = readings(motion, scenario.devices)
    return faulty(sequence, scenario.faults, seed) if scenario.faults else sequence


def _streamed_ms(scenario: Scenario, jobs: Sequence[Job]) -> float | None:
    """Milliseconds per frame on one thread over the first frames; None for windows."""
    if scenario.online:
        return None
    seconds, frames = 0.0, 0
    for job in jobs:
        system, sequence = _loaded(job[0], scenario.options), _told(job)
        system.reset(UserBody.of(job[2]), sequence.names)
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


def run_physics(
    agent: str, scenario: Scenario, motions: Sequence[Motion], threads: int, mapper: Mapper = map
) -> list[Row]:
    """Two rows: a system's poses on the avatar without and with physics.

    Both are compared with the motion on the avatar. Milliseconds are per 60 Hz frame.
    """
    base = base_of(agent) or agent
    jobs = [(base, scenario, motion, 0) for motion in motions]
    references = list(mapper(reference, jobs))
    kinematic_ms = _streamed_ms(scenario, jobs) or 0.0
    began = time.perf_counter()
    rollouts = follow_poses(references, motions, threads)
    physics_ms = 1000.0 * (time.perf_counter() - began) / sum(map(len, motions))
    pairs = zip(references, rollouts, strict=True)
    without = [avatar_samples(clip, rollout.reference, scenario.ends) for clip, rollout in pairs]
    behind = [rollout_samples(rollout, scenario.ends) for rollout in rollouts]
    count = parameters(_loaded(base, ()))
    name, whole = scenario.name, count + _policy_size(TRACKER)
    return [
        row_of(agent, f"{name}, no physics", count, without, kinematic_ms),
        row_of(agent, name, whole, behind, kinematic_ms + physics_ms),
    ]


def reference(job: Job) -> Clip:
    """The avatar's reference: a system's poses retargeted to it."""
    return reference_of(reconstructed(job), job[2])


def run_policy(agent: str, scenario: Scenario, motions: Sequence[Motion], threads: int) -> Row:
    """The row of a torque policy on the same motions, with the devices it was trained with."""
    policy = load_agent(agent)
    began = time.perf_counter()
    rollouts = roll_out(policy, [to_clip(m) for m in motions], env_config(policy), threads)
    ms = 1000.0 * (time.perf_counter() - began) / sum(map(len, motions))
    scored = [rollout_samples(rollout, scenario.ends) for rollout in rollouts]
    return row_of(agent, scenario.name, _policy_size(agent), scored, ms)


def _policy_size(agent: str) -> int:
    loaded = load_agent(agent)
    if not isinstance(loaded, PolicyAgent):
        return 0
    return sum(p.numel() for p in loaded.policy.parameters())
