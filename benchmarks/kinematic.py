"""Time per streamed frame of each kinematic system on one thread, over the published time.

    OMP_NUM_THREADS=1 python -m benchmarks.kinematic [--preset paper] [--json]

The networks are untrained but have the sizes of the preset. Training does not change the time per
frame, except for DragPoser, whose solver stops early when it makes no progress. Systems take turns,
so that a change of clock affects all equally. A figure is the median milliseconds per frame over
half the published or released time, the target: a figure below 1 meets it.
"""

from __future__ import annotations

import statistics
import sys

import torch

from agents.kinematic.data import MotionBank
from agents.kinematic.interface import KinematicSystem, UserBody
from agents.kinematic.registry import AGENTS
from agents.kinematic.scenario import SIX
from benchmarks.common import arguments, report, seconds
from questsim.cli import guarded
from questsim.errors import InputError
from questsim.joint_sensors import SensorSequence, readings
from questsim.motion.motion import Motion
from questsim.motion.retarget_back import to_motion
from questsim.motion.synthesis.synthetic import synthetic_clips
from questsim.sensors import SENSOR_SETS

DRAG_ITERATIONS = (10, 1)


def main() -> None:
    """Measure and print."""
    args = arguments(__doc__ or "", {"preset": "paper"}, frames=120, rounds=3)
    if args.preset not in ("paper", "cpu", "smoke"):
        raise InputError(f"there is no preset {args.preset!r}", "--preset", "paper, cpu or smoke")
    torch.set_num_threads(1)
    walk = next(clip for clip in synthetic_clips() if clip.kind == "walk")
    report(
        measure(args.preset, to_motion(walk).resampled(60.0), args.frames, args.rounds), args.json
    )


def measure(preset: str, motion: Motion, frames: int, rounds: int) -> dict[str, float]:
    """Milliseconds per frame and their ratio to the target, by system.

    Args:
        preset: preset of every system.
        motion: motion at 60 Hz from which the device signals are made.
        frames: number of frames in a round.
        rounds: number of rounds; every system runs once in each.
    """
    systems = {}
    for agent in AGENTS:
        for iterations in DRAG_ITERATIONS if agent == "dragposer" else (None,):
            name = agent if iterations is None else f"{agent}, {iterations} iterations"
            systems[name] = untrained(agent, preset, motion, iterations)
    times: dict[str, list[float]] = {name: [] for name in systems}
    for _ in range(rounds):
        for name, (system, sequence) in systems.items():
            times[name] += _streamed(system, sequence, UserBody.of(motion), frames)
    figures = {}
    for name, found in times.items():
        ms = 1000.0 * statistics.median(found)
        figures[f"{name} ms"] = ms
        published = AGENTS[name.split(",")[0]].paper_ms
        if published is not None:
            figures[f"{name} of what is allowed"] = ms / (0.5 * published)
    return figures


def untrained(
    agent: str, preset: str, motion: Motion, iterations: int | None
) -> tuple[KinematicSystem, SensorSequence]:
    """A system of a preset's size with fitted normalisers, and its device signals."""
    torch.manual_seed(0)
    entry = AGENTS[agent]
    config = entry.presets[preset]
    module = entry.build(config.spec)
    for stage, learning in config.stages.items():
        entry.task(module, stage, learning, MotionBank([motion], learning.window), 2)
    options = {} if iterations is None else {"iterations": iterations}
    system = entry.system(module, agent, list(config.stages), options)
    scenario = next((s for s in entry.scenarios if s.devices == SIX), None)
    devices = scenario.devices if scenario else SENSOR_SETS[entry.sensors[-1]]
    return system, readings(motion, devices)


def _streamed(
    system: KinematicSystem, sequence: SensorSequence, body: UserBody, frames: int
) -> list[float]:
    """Seconds of each frame, without the first few frames of warm-up."""
    system.reset(body, sequence.names)
    told = [sequence[t] for t in range(min(frames, len(sequence)))]
    return [seconds(lambda frame=frame: system.step(frame)) for frame in told][5:]


if __name__ == "__main__":
    sys.exit(guarded(main))
