"""What a streamed frame of each agent of a comparison costs, on one thread."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from agents.comparison.report import Costs, Row, row_of
from agents.comparison.run import Plan, scored
from agents.evaluation.follow import evaluation_sim
from agents.evaluation.rollout import env_config
from agents.kinematic.causal import causal_clip
from agents.kinematic.efficiency import mmac_a_frame, stream_kib
from agents.kinematic.estimates import Job, device_signals, loaded
from agents.kinematic.interface import KinematicSystem, UserBody
from agents.kinematic.physics_behind import TRACKER
from agents.kinematic.scenario import Scenario
from agents.loading import load_agent
from agents.policy.policy_agent import PolicyAgent
from agents.resolve import Resolved
from questsim.joint_sensors import SENSOR_FPS, readings
from questsim.motion.clip import FPS
from questsim.motion.motion import Motion
from questsim.motion.retarget import to_clip

TIMED_FRAMES = 600
"""Number of frames over which streaming is timed."""


def run(agent: str, scenario: Scenario, motions: Sequence[Motion], seed: int) -> Row:
    """Reconstruct all motions in one scenario and score them."""
    jobs = [Job(agent, scenario, motion, seed + i) for i, motion in enumerate(motions)]
    return row_of(agent, scenario.name, scored(jobs), costs(agent, scenario, motions))


def costs(agent: str, scenario: Scenario, motions: Sequence[Motion]) -> Costs:
    """What a streamed frame of a kinematic system costs, on this thread."""
    size = parameters(loaded(agent, scenario.options))
    found = Costs(size, streamed_ms(agent, scenario, motions))
    return _counted(found, agent, scenario, motions)


def _counted(found: Costs, agent: str, scenario: Scenario, motions: Sequence[Motion]) -> Costs:
    """The costs with multiply-accumulates and memory; not of windows, and not without networks."""
    if scenario.online or not found.parameters:
        return found
    system = loaded(agent, scenario.options)
    sequence = readings(motions[0], scenario.devices)
    mmac = mmac_a_frame(system, sequence, UserBody.of(motions[0]))
    return replace(found, mmac=mmac, stream_kib=stream_kib(system))


def streamed_ms(agent: str, scenario: Scenario, motions: Sequence[Motion]) -> float | None:
    """Milliseconds per frame on one thread over the first frames; None for windows."""
    if scenario.online:
        return None
    seconds, frames = 0.0, 0
    for i, motion in enumerate(motions):
        system = loaded(agent, scenario.options)
        sequence = device_signals(Job(agent, scenario, motion, i))
        system.reset(UserBody.of(motion), sequence.names)
        count = min(len(sequence), TIMED_FRAMES - frames)
        part = [sequence[t] for t in range(count)]
        began = time.perf_counter()
        for frame in part:
            system.step(frame)
        seconds, frames = seconds + time.perf_counter() - began, frames + count
        if frames >= TIMED_FRAMES:
            break
    return 1000.0 * seconds / frames


def parameters(system: KinematicSystem) -> int:
    """Number of parameters of a system's networks; 0 without networks."""
    module = getattr(system, "module", None)
    return sum(p.numel() for p in module.parameters()) if module is not None else 0


def plan_costs(
    plan: Plan, motions: Sequence[Motion], measured: dict[str, float | None] | None
) -> list[Costs]:
    """Costs of the rows of a plan, in their order; with noise only the sizes.

    Args:
        plan: the rows.
        motions: to measure on.
        measured: times by what was measured, so that rows of one system share one measurement;
            None to measure none.
    """
    if plan.agent is None:
        return [Costs()]
    agent, scenario = plan.agent, plan.scenario

    def ms(name: str, measure: Callable[[], float | None]) -> float | None:
        if measured is None:
            return None
        if name not in measured:
            measured[name] = measure()
        return measured[name]

    system = plan.system
    if system is None:
        whole = Costs(_policy_size(agent))
        if plan.noise is None:
            whole = replace(whole, ms=ms(plan.name, lambda: policy_ms(agent, motions)))
        return [whole] * len(plan.rows)
    alone = Costs(parameters(loaded(system, scenario.options)))
    if plan.noise is None:
        key = f"{system}: {scenario.name}"
        alone = replace(alone, ms=ms(key, lambda: streamed_ms(system, scenario, motions)))
    if not plan.starts:
        return [alone if plan.noise else _counted(alone, system, scenario, motions)]
    whole = replace(alone, parameters=alone.parameters + _policy_size(TRACKER))
    if alone.ms is not None:
        tracker = ms(TRACKER, lambda: policy_ms(TRACKER, motions)) or 0.0
        retargeting = ms("retargeting", lambda: retargeted_ms(motions)) or 0.0
        # A frame of the avatar lasts 1/36 s, one of the system 1/60 s.
        whole = replace(whole, ms=alone.ms + (tracker + retargeting) * FPS / SENSOR_FPS)
    return [*([] if plan.further else [alone]), *[whole] * len(plan.starts)]


def policy_ms(agent: str | Resolved, motions: Sequence[Motion]) -> float:
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
    clip = causal_clip(motion, at_once=1)
    return 1000.0 * (time.perf_counter() - began) / len(clip)


def _policy_size(agent: str | Resolved) -> int:
    loaded = load_agent(agent)
    if not isinstance(loaded, PolicyAgent):
        return 0
    return sum(p.numel() for p in loaded.policy.parameters())
