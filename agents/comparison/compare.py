"""Compare kinematic systems and policies on the same frames in one table.

``python evaluate.py --compare --motions bandai-namco-2:test --out DIR``. Each agent is run in every
scenario that it supports; docs/comparison.md describes scenarios and columns.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence

from agents.comparison.options import CompareArgs
from agents.comparison.plots import plot_accuracy, plot_plausibility
from agents.comparison.report import COSTS, TABLES, table, write
from agents.comparison.run import (
    devices_named,
    rows_of,
    run_recording,
    suiting,
    workers,
)
from agents.comparison.scenarios import Scenario
from agents.evaluation.follow import choose_clips
from agents.kinematic.data import motions_record
from agents.kinematic.registry import AGENTS
from agents.loading import load_agent
from agents.resolve import (
    DEFAULT_POLICY,
    DEFAULT_SYSTEM,
    PHYSICS,
    SYNTHETIC_POLICY,
    UNTRAINED,
    resolve,
    shipped_policies,
    shipped_systems,
    with_physics,
)
from agents.run_folder import versions
from questsim.errors import InputError, at_least
from questsim.files import whole_file
from questsim.joint_sensors import SENSOR_FPS
from questsim.motion.motion import Motion

FIGURES = {"accuracy.png": plot_accuracy, "plausibility.png": plot_plausibility}
FILES: tuple[str, ...] = ("comparison.json", "comparison.csv", "comparison.md", *FIGURES)
"""Files that a comparison writes; with a film, also ``film.FILES``."""


def compare(args: CompareArgs) -> int:
    """Run the comparison and write its tables and figures; returns the exit code.

    Raises:
        InputError: there is nothing to compare, or an argument cannot be used.
    """
    from questsim.evaluation_report import check_writable
    from questsim.motion.spec import load_recordings

    at_least(1, threads=args.threads, max_clips=args.max_clips)
    at_least(0, seed=args.seed)
    if args.video_clips and not args.video:
        raise InputError("needs a video", "--video-clips", "add --video")
    planned, out = plan(args.agents, args.sensors), args.out
    check_writable(out)
    everything = load_recordings(args.motions, seed=args.seed)
    recordings = at_sensor_rate(everything, args.max_clips)
    filmed: Sequence[Motion] = ()
    if args.video:
        from agents.comparison.film import to_be_filmed

        filmed = to_be_filmed(everything if args.video_clips else recordings, args.video_clips)
    with workers(args.threads) as mapper:
        rows = [run_recording(recordings, mapper)]
        for agent, scenarios in planned.items():
            for row in rows_of(agent, scenarios, recordings, args.seed, args.threads, mapper):
                print(f"{agent}: {row.scenario}", file=sys.stderr, flush=True)
                rows.append(row)
    context = {
        "agents": {agent: resolve(agent).training for agent in planned},
        "data": motions_record(args.motions, recordings),
        "versions": versions(),
        "threads": args.threads,
        "seed": args.seed,
    }
    write(rows, context, out)
    for name, plot in FIGURES.items():
        with whole_file(out / name) as path:
            plot(rows, path)
    for names in (*TABLES.values(), COSTS):
        print(table(rows, names), end="\n\n")
    print(f"written to {out}")
    if filmed:
        from agents.comparison.film import film

        film(args.agents or representative(planned), filmed, out, args.threads)
    return 0


def plan(agents: Sequence[str], sensors: str | None) -> dict[str, list[Scenario]]:
    """Agents and the scenarios in which each is run.

    Raises:
        InputError: an unknown agent or sensor set, or an agent that cannot use the sensors.
    """
    devices = devices_named(sensors)
    planned = {agent: suiting(agent, devices) for agent in agents or everyone()}
    if agents:
        for agent, scenarios in planned.items():
            if not scenarios:
                raise InputError(f"{agent} does not support {sensors}", "--sensors", "leave it out")
    planned = {agent: scenarios for agent, scenarios in planned.items() if scenarios}
    if not planned:
        raise InputError(f"no agent supports {sensors} alone", "--sensors", "leave it out")
    return planned


def everyone() -> list[str]:
    """All agents available without training: systems, systems with physics, and policies.

    Policies that observe the full-body reference are left out, and so is the policy trained only
    on the embedded motions.
    """
    families = [*UNTRAINED, *AGENTS]  # the order of tables
    others = [name for name in shipped_systems() if name not in families]
    systems = [*(name for name in families if name in shipped_systems()), *others]
    apart = [
        name
        for name in shipped_policies()
        if name != SYNTHETIC_POLICY and not load_agent(name).needs.privileged
    ]
    return [*systems, *with_physics(systems), *apart]


def representative(agents: Iterable[str]) -> list[str]:
    """The agents that fit into a picture: the systems, one with physics, one policy."""
    return [
        agent
        for agent in agents
        if agent in (DEFAULT_SYSTEM + PHYSICS, DEFAULT_POLICY) or resolve(agent).kind == "system"
    ]


def at_sensor_rate(motions: Sequence[Motion], count: int | None = None) -> list[Motion]:
    """Motions at 60 Hz, in a fixed order; at most ``count``, all kinds in proportion."""
    subset = choose_clips(motions, len(motions) if count is None else count)
    return [motion.resampled(SENSOR_FPS) for motion in subset]
