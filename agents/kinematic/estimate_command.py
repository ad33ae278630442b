"""Write the estimates of a kinematic system as a motion library: ``questsim estimate``.

Use them to view the poses, to score them with other tools, or to train a policy on estimates.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from agents.kinematic.estimates import Job, at_sensor_rate, estimated, scenario_with
from agents.kinematic.options import EstimateArgs
from agents.kinematic.physics_behind import on_own_body
from agents.kinematic.processes import process_map
from agents.resolve import resolve_system
from agents.training.watched import beside_ray
from questsim.errors import at_least, usable_seed
from questsim.motion.clip import Clip
from questsim.motion.library import save_library
from questsim.motion.motion import Motion
from questsim.motion.motions_command import check_library_path
from questsim.motion.retarget import to_clip
from questsim.motion.spec import check_seed, load_recordings


@beside_ray
def estimate(args: EstimateArgs) -> None:
    """Write the library; motions are named ``NAME@AGENT`` and keep kind, style and licence.

    Raises:
        InputError: the system, sensors or motions cannot be used, or the file cannot be written.
    """
    at_least(1, threads=args.threads, max_clips=args.max_clips)
    usable_seed(args.seed)
    scenario = scenario_with(resolve_system(args.agent), args.sensors)
    check_library_path(args.out, args.motions)
    check_seed(args.motions, args.seed)
    motions = at_sensor_rate(load_recordings(args.motions, seed=args.seed), args.max_clips)
    jobs = [Job(args.agent, scenario, motion) for motion in motions]
    with process_map(args.threads, args.workers, args.ray) as mapper:
        done = list(mapper(_estimated, jobs))
    save_library(args.out, [motion for motion, _ in done], [clip for _, clip in done])
    motions_made = "1 motion" if len(done) == 1 else f"{len(done)} motions"
    print(f"{motions_made}, {sum(m.duration for m, _ in done):.0f} s, in {args.out}")


def _estimated(job: Job) -> tuple[Motion, Clip]:
    motion = on_own_body(estimated(job), job.motion)
    name = Path(job.agent).name
    motion = replace(motion, name=f"{motion.name}@{name}", source=f"{name}: {motion.source}")
    return motion, to_clip(motion)
