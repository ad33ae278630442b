"""What a kinematic system makes of motions, as a library: ``questsim estimate``.

To look at it, to score it by other tools, or to train a policy on a system's own errors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from agents.comparison.compare import at_sensor_rate
from agents.comparison.run import Job, devices_named, reconstructed, workers
from agents.comparison.scenarios import scenarios
from agents.kinematic.physics_behind import on_own_body
from agents.kinematic.store import load_system
from agents.resolve import DEFAULT_SYSTEM
from questsim.errors import InputError, at_least
from questsim.motion.clip import Clip
from questsim.motion.library import save_library
from questsim.motion.motion import Motion
from questsim.motion.motions_command import check_library_path
from questsim.motion.retarget import to_clip
from questsim.motion.spec import load_recordings


@dataclass(frozen=True)
class EstimateArgs:
    """Write a library of the motions that a kinematic system estimates from devices."""

    out: Path
    """The library to write, an .npz file."""
    agent: str = DEFAULT_SYSTEM
    """The system: a name, checkpoint folder or run folder."""
    motions: str = "synthetic"
    """What the devices report: synthetic, a dataset, a library, file or folder."""
    sensors: str | None = None
    """The devices, a set by name; by default the first that the system is compared with."""
    max_clips: int | None = None
    """Only this many motions, of all kinds."""
    threads: int = 2
    """Processes side by side."""
    seed: int = 0
    """Of the embedded motions."""


def estimate(args: EstimateArgs) -> None:
    """Write the library; motions are called ``NAME@AGENT``, and keep kind, style and licence.

    Raises:
        InputError: a system, sensors or motions that cannot be used, or a file that cannot be
            written.
    """
    at_least(1, threads=args.threads, max_clips=args.max_clips)
    at_least(0, seed=args.seed)
    devices = devices_named(args.sensors)
    suited = [s for s in scenarios(load_system(args.agent)) if s.has(devices)]
    if not suited:
        raise InputError(f"{args.agent} is not used with {args.sensors}", "--sensors")
    check_library_path(args.out)
    motions = at_sensor_rate(load_recordings(args.motions, seed=args.seed), args.max_clips)
    jobs = [(args.agent, suited[0], motion, 0) for motion in motions]
    with workers(args.threads) as mapper:
        done = list(mapper(_estimated, jobs))
    save_library(args.out, [motion for motion, _ in done], [clip for _, clip in done])
    print(f"{len(done)} motions, {sum(m.duration for m, _ in done):.0f} s, in {args.out}")


def _estimated(job: Job) -> tuple[Motion, Clip]:
    motion = on_own_body(reconstructed(job), job[2])
    name = Path(job[0]).name
    motion = replace(motion, name=f"{motion.name}@{name}", source=f"{name}: {motion.source}")
    return motion, to_clip(motion)
