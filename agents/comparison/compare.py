"""Compare kinematic systems and policies on the same frames in one table.

``python evaluate.py --compare --motions bandai-namco-2:test --out DIR``. Each agent is run in every
scenario that it supports; docs/comparison.md describes scenarios and columns.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Mapping, Sequence

from agents.comparison.drawn import DRAWN, Scored
from agents.comparison.options import CompareArgs
from agents.comparison.plots import plot_accuracy, plot_plausibility
from agents.comparison.record import FILE as RECORD_FILE
from agents.comparison.record import Record
from agents.comparison.report import COSTS, RECORDING, TABLES, row_of, table, write
from agents.comparison.run import Plan, compute, devices_named, plan_costs, suiting, workers
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
    base_of,
    resolve,
    shipped_policies,
    shipped_systems,
    with_physics,
)
from agents.resolve import ESTIMATE_TRACKER as TRACKER
from agents.run_folder import versions
from agents.training.monitor import Display
from questsim.errors import INTERRUPTED, InputError, at_least
from questsim.files import whole_file
from questsim.joint_sensors import SENSOR_FPS
from questsim.motion.motion import Motion

FIGURES = {"accuracy.png": plot_accuracy, "plausibility.png": plot_plausibility}
FILES: tuple[str, ...] = (
    "comparison.json", "comparison.csv", "comparison.md", RECORD_FILE, *FIGURES, *DRAWN,
)  # fmt: skip
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
    context = {
        "agents": {agent: resolve(agent).training for agent in planned},
        "tracker": resolve(TRACKER).training,
        "data": motions_record(args.motions, recordings),
        "versions": versions(),
        "seed": args.seed,
    }
    plans = all_plans(planned, args)
    with Record(out, context) as record:
        try:
            scored = _scored(plans, recordings, args, record)
        except KeyboardInterrupt:
            print(f"stopped; the same command goes on in {out}", file=sys.stderr)
            return INTERRUPTED
    rows = [row for row, _ in scored]
    write(rows, context, out)
    for name, plot in FIGURES.items():
        with whole_file(out / name) as path:
            plot(rows, path)
    for name, draw in DRAWN.items():
        with whole_file(out / name) as path:
            draw(scored, path)
    for names in (*TABLES.values(), COSTS):
        print(table(rows, names, ends=True), end="\n\n")
    print(f"written to {out}")
    if filmed:
        from agents.comparison.film import film

        film(args.agents or representative(planned), filmed, out, args.threads)
    return 0


def all_plans(planned: Mapping[str, Sequence[Scenario]], args: CompareArgs) -> list[Plan]:
    """Everything to be computed: the recording, then each agent's scenarios and conditions.

    Noise applies to plain scenarios; with physics it is followed from the first start alone.
    """
    plans = [Plan(RECORDING, Scenario("60 Hz", ()))]
    for agent, scenarios in planned.items():
        physics = resolve(agent).torques or base_of(agent) is not None
        starts = args.starts if physics else ()
        for scenario in scenarios:
            plans.append(Plan(agent, scenario, None, starts))
            if scenario.plain:
                plans += [Plan(agent, scenario, noise, starts[:1]) for noise in args.noise]
    return plans


def _scored(
    plans: Sequence[Plan], motions: Sequence[Motion], args: CompareArgs, record: Record
) -> list[Scored]:
    """Compute what is missing and make all rows; times are measured at the end, in one pass."""
    names = [motion.name for motion in motions]
    left = sum(len(record.missing([plan.key(row) for row in plan.rows], names)) for plan in plans)
    whole, done, rate, began = max(left, 1), 0, 0.0, time.monotonic()
    with Display() as display, workers(args.threads, args.workers, args.ray) as mapper:
        for number, plan in enumerate(plans, start=1):
            told = f"{plan.agent}: {plan.rows[0]}"
            for count in compute(
                plan, motions, args.seed, args.threads, mapper, record, args.workers > 0
            ):
                done += count
                rate = (time.monotonic() - began) / done
                display.show("compare", min(done / whole, 1.0), told, rate * max(whole - done, 0))
            minutes = rate * max(whole - done, 0) / 60
            display.say(f"{number}/{len(plans)} {told}; about {minutes:.0f} min left")
    scored = []
    for plan in plans:
        for row, costs in zip(plan.rows, plan_costs(plan, motions), strict=True):
            clips = record.of(plan.key(row), names)
            scored.append((row_of(plan.agent, row, clips, costs), clips))
    return scored


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
