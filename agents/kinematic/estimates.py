"""Estimates of a kinematic system on recorded motions, from the signals of its devices."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

from agents.evaluation.follow import choose_clips
from agents.kinematic.device_faults import Noise, faulty, noisy
from agents.kinematic.interface import KinematicSystem, Poses, UserBody
from agents.kinematic.recurrent.poser import RecurrentPoser
from agents.kinematic.scenario import WINDOW, Scenario
from agents.kinematic.store import load_system
from agents.resolve import Resolved, resolve
from questsim.errors import InputError
from questsim.joint_sensors import SENSOR_FPS, SensorSequence, readings
from questsim.motion.motion import Motion
from questsim.sensors import SENSOR_SETS


class Job(NamedTuple):
    """One motion to estimate.

    Attributes:
        agent: name or folder of the system.
        scenario: its devices and options.
        motion: the user's, at 60 Hz.
        seed: of the faults of the devices.
        noise: fault of the devices; None for exact signals.
    """

    agent: str
    scenario: Scenario
    motion: Motion
    seed: int = 0
    noise: Noise | None = None


def at_sensor_rate(motions: Sequence[Motion], count: int | None = None) -> list[Motion]:
    """Motions at 60 Hz, in a fixed order; at most ``count``, all kinds in proportion."""
    subset = choose_clips(motions, len(motions) if count is None else count)
    return [motion.resampled(SENSOR_FPS) for motion in subset]


# -- which devices -----------------------------------------------------------------------------


def scenarios_of(agent: str | Resolved) -> list[Scenario]:
    """The scenarios that a kinematic system supports; behind physics only the plain ones.

    Raises:
        InputError: there is no such system.
    """
    found = resolve(agent)
    if found.kind == "physics":
        return [scenario for scenario in load_system(found.base).scenarios if scenario.plain]
    return list(load_system(found).scenarios)


def scenario_with(agent: str | Resolved, sensors: str | None) -> Scenario:
    """The first scenario of a kinematic system that has the devices of ``--sensors``.

    Args:
        agent: the system.
        sensors: name of a sensor set; None takes the system's first scenario.

    Raises:
        InputError: there is no such system, or it does not support these sensors.
    """
    found = scenarios_of(agent)
    if sensors is None:
        return found[0]
    for scenario in found if sensors in SENSOR_SETS else ():
        if scenario.has(SENSOR_SETS[sensors]):
            return scenario
    raise unsupported(str(getattr(agent, "name", agent)), sensors, found)


def unsupported(agent: str, sensors: str, found: Iterable[Scenario]) -> InputError:
    """The error of a value of ``--sensors`` that an agent does not support.

    Args:
        agent: name of the agent.
        sensors: the value.
        found: scenarios of the agent, whose sensor sets are listed.
    """
    used = [scenario.devices for scenario in found]
    sets = ", ".join(name for name, devices in SENSOR_SETS.items() if devices in used)
    known = sensors in SENSOR_SETS
    what = f"{agent} does not support {sensors}" if known else f"unknown sensor set {sensors!r}"
    return InputError(what, "--sensors", f"choose from {sets}")


# -- estimates ---------------------------------------------------------------------------------


@lru_cache(maxsize=2)
def loaded(agent: str, options: tuple[tuple[str, Any], ...]) -> KinematicSystem:
    """A system with its options; the last two are kept."""
    return load_system(agent, **dict(options))


def estimated(job: Job) -> Poses:
    """A system's estimate of a motion at 60 Hz, streamed or each frame from its window."""
    return estimated_together([job])[0]


def estimated_together(jobs: Sequence[Job]) -> list[Poses]:
    """Like ``estimated``; all jobs are of one system, scenario and noise."""
    agent, scenario = jobs[0].agent, jobs[0].scenario
    system, sequences = loaded(agent, scenario.options), [device_signals(job) for job in jobs]
    bodies = [UserBody.of(job.motion) for job in jobs]
    if not scenario.online:
        return system.predict_many(sequences, bodies)
    assert isinstance(system, RecurrentPoser)
    pairs = zip(sequences, bodies, strict=True)
    return [system.predict_windows(sequence, body, WINDOW) for sequence, body in pairs]


def device_signals(job: Job) -> SensorSequence:
    """The device signals of a motion, with the faults of the scenario and the job."""
    scenario = job.scenario
    sequence = noisy(readings(job.motion, scenario.devices), job.noise, job.seed)
    return faulty(sequence, scenario.faults, job.seed) if scenario.faults else sequence
