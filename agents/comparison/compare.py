"""Compare kinematic systems and policies on the same frames in one table.

``python evaluate.py --compare --motions bandai-namco-2:test --out DIR``. Each agent is run in every
scenario that it supports; docs/comparison.md describes scenarios and columns.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from agents.comparison.conditions import NOISES
from agents.comparison.costs import plan_costs
from agents.comparison.drawn import (
    DRAWN,
    PREDICTOR,
    Scored,
    compared,
    predictor_over_time,
    predictor_pairs,
)
from agents.comparison.options import CompareArgs
from agents.comparison.plots import plot_accuracy, plot_plausibility
from agents.comparison.record import FILE as RECORD_FILE
from agents.comparison.record import Record
from agents.comparison.report import COSTS, RECORDING, TABLES, row_of, table, write
from agents.comparison.run import Estimates, Plan, compute, devices_named, suiting, workers
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
"""Files that a comparison writes, besides ``PREDICTOR`` and ``film.FILES``."""


def compare(args: CompareArgs) -> int:
    """Run the comparison and write its tables and figures; returns the exit code.

    Raises:
        InputError: there is nothing to compare, or an argument cannot be used.
    """
    from questsim.evaluation_report import check_writable
    from questsim.motion.spec import load_recordings

    at_least(1, threads=args.threads, max_clips=args.max_clips, fewer_clips=args.fewer_clips)
    at_least(0, seed=args.seed)
    if args.video_clips and not args.video:
        raise InputError("needs a video", "--video-clips", "add --video")
    planned, out = plan(args.agents, args.sensors), args.out
    _refuse_unused(args, planned)
    check_writable(out)
    everything = load_recordings(args.motions, seed=args.seed)
    recordings = at_sensor_rate(everything, args.max_clips)
    filmed: Sequence[Motion] = ()
    if args.video:
        from agents.comparison.film import to_be_filmed

        filmed = to_be_filmed(everything if args.video_clips else recordings, args.video_clips)
    context: dict[str, Any] = {
        "agents": {agent: resolve(agent).training for agent in planned},
        "tracker": resolve(TRACKER).training,
        "data": motions_record(args.motions, recordings),
        "versions": versions(),
        "seed": args.seed,
        "fewer_clips": args.fewer_clips,
    }
    plans = all_plans(planned, args)
    common = {name: context[name] for name in context if name not in ("agents", "tracker")}
    with Record(out, common, {agent: digest(agent) for agent in (RECORDING, *planned)}) as record:
        try:
            scored = _scored(plans, recordings, args, record)
        except KeyboardInterrupt:
            print(f"stopped; the same command goes on in {out}", file=sys.stderr)
            return INTERRUPTED
    if not scored:
        raise InputError("no row is complete yet", out, "leave --finished out")
    places = {recording.name: place for place, recording in enumerate(recordings)}
    fewer = [places[motion.name] for motion in _fewer(recordings, args)]
    if pairs := predictor_pairs(scored, fewer):
        with whole_file(out / PREDICTOR) as path:
            predictor_over_time(pairs, path)
    _write_all(scored, context, out)
    if filmed:
        from agents.comparison.film import film
        from agents.comparison.worst import worst_strips

        shown = args.agents or representative(planned)
        if film(shown, filmed, out, args.threads, args.starts[0]):
            worst_strips([row for row, _ in compared(scored)], recordings, out, args.threads)
    return 0


def _write_all(scored: Sequence[Scored], context: dict[str, Any], out: Path) -> None:
    """Write tables and figures of the rows, and print the tables."""
    rows = [row for row, _ in scored]
    there = {row.agent for row in rows}
    records = context["agents"].items()
    context["agents"] = {name: record for name, record in records if name in there}
    write(rows, context, out)
    exact = [row for row in rows if ", noise: " not in row.scenario] or rows
    for name, plot in FIGURES.items():
        with whole_file(out / name) as path:
            plot(exact, path)
    for name, draw in DRAWN.items():
        with whole_file(out / name) as path:
            draw(scored, path)
    for names in (*TABLES.values(), COSTS):
        print(table(rows, names, ends=True), end="\n\n")
    print(f"written to {out}")


def _simulated(agent: str) -> bool:
    return resolve(agent).torques or base_of(agent) is not None


def _refuse_unused(args: CompareArgs, planned: Mapping[str, Sequence[Scenario]]) -> None:
    """Refuse options that change nothing in the rows, and rows that are asked for twice."""
    if args.starts != CompareArgs(out=args.out).starts and not any(map(_simulated, planned)):
        raise InputError("does nothing: no agent has physics", "--starts", "leave it out")
    if args.windows and not any(s.online for scenarios in planned.values() for s in scenarios):
        what = "does nothing: no agent has the protocol with windows"
        raise InputError(what, "--windows", "leave it out")
    for option, values in (("starts", args.starts), ("noise", args.noise)):
        if len(set(values)) < len(values):
            raise InputError("has a value twice", f"--{option}", "give each once")


def all_plans(planned: Mapping[str, Sequence[Scenario]], args: CompareArgs) -> list[Plan]:
    """Everything to be computed: the recording, then each agent's scenarios and conditions.

    Noise applies to plain scenarios; with physics it is followed from the first start alone.
    """
    plans = [Plan(RECORDING, Scenario("60 Hz", ()))]
    for agent, scenarios in planned.items():
        starts = args.starts if _simulated(agent) else ()
        kept = agent + PHYSICS in planned
        for scenario in scenarios:
            if scenario.online and not args.windows:
                continue
            plans.append(Plan(agent, scenario, None, starts, kept))
            if scenario.plain:
                plans += [Plan(agent, scenario, each, starts[:1], kept) for each in args.noise]
    return plans


def digest(agent: str) -> str:
    """A digest of everything trained that an agent's rows depend on."""
    if agent == RECORDING:
        return RECORDING
    parts, found = [agent], resolve(agent)
    if found.kind == "physics":
        parts.append(TRACKER)
    elif found.torques:  # begins in its estimates
        parts.append(DEFAULT_SYSTEM)
    whole = hashlib.sha256()
    for part in parts:
        each = resolve(part)
        whole.update(json.dumps(each.training, sort_keys=True, default=str).encode())
        for file in sorted(each.folder.glob("*.safetensors")) if each.folder else ():
            whole.update(file.read_bytes())
    return whole.hexdigest()[:16]


def _fewer(motions: Sequence[Motion], args: CompareArgs) -> list[Motion]:
    """The motions of rows that are limited by ``--fewer-clips``."""
    return choose_clips(motions, args.fewer_clips or len(motions))


def _scored(
    plans: Sequence[Plan], motions: Sequence[Motion], args: CompareArgs, record: Record
) -> list[Scored]:
    """Compute what is missing and make all rows; times are measured at the end, in one pass."""
    fewer = _fewer(motions, args)
    clips = {id(plan): motions if plan.plain else fewer for plan in plans}
    names = {key: [motion.name for motion in each] for key, each in clips.items()}
    if not args.finished:
        _compute(plans, clips, names, args, record)
    scored, measured = [], {} if args.times else None
    for plan in plans:
        there = [not record.missing([plan.key(row)], names[id(plan)]) for row in plan.rows]
        if not any(there):
            continue
        costs = plan_costs(plan, motions, measured)
        for row, cost, complete in zip(plan.rows, costs, there, strict=True):
            if complete:
                found = record.of(plan.key(row), names[id(plan)])
                scored.append((row_of(plan.agent, row, found, cost, names[id(plan)]), found))
    return scored


def _compute(
    plans: Sequence[Plan],
    clips: Mapping[int, Sequence[Motion]],
    names: Mapping[int, Sequence[str]],
    args: CompareArgs,
    record: Record,
) -> None:
    """Compute the clips that the record lacks, and show how long it will take.

    Args:
        plans: of all rows.
        clips, names: motions of each plan and their names, by the plan's ``id``.
        args: seed and threads.
        record: gets the results.
    """
    left = sum(
        len(record.missing([plan.key(row) for row in plan.rows], names[id(plan)])) for plan in plans
    )
    whole, done, rate, began = max(left, 1), 0, 0.0, time.monotonic()
    estimates = Estimates()
    with Display() as display, workers(args.threads, args.workers, args.ray) as mapper:
        for number, plan in enumerate(in_turn(plans), start=1):
            name = f"{plan.agent}: {plan.rows[0]}"
            steps = compute(
                plan,
                clips[id(plan)],
                args.seed,
                args.threads,
                mapper,
                record,
                estimates,
                args.workers > 0,
            )
            for count in steps:
                done += count
                rate = (time.monotonic() - began) / done
                display.show("compare", min(done / whole, 1.0), name, rate * max(whole - done, 0))
            minutes = rate * max(whole - done, 0) / 60
            display.say(f"{number}/{len(plans)} {name}; about {minutes:.0f} min left")


def in_turn(plans: Sequence[Plan]) -> list[Plan]:
    """The order of computation: exact signals and plain streams first; physics after estimates."""

    def place(plan: Plan) -> tuple[int, bool, int, int]:
        base = base_of(plan.agent) or plan.agent
        alike = [
            other
            for other in plans
            if (base_of(other.agent) or other.agent) == base
            and (other.scenario, other.noise) == (plan.scenario, plan.noise)
        ]
        noise = 0 if plan.noise is None else 1 + NOISES.index(plan.noise)
        return noise, not plan.scenario.plain, plans.index(alike[0]), plans.index(plan)

    return sorted(plans, key=place)


def plan(agents: Sequence[str], sensors: str | None) -> dict[str, list[Scenario]]:
    """Agents and the scenarios in which each is run.

    Raises:
        InputError: an unknown agent or sensor set, or an agent that cannot use the sensors.
    """
    devices = devices_named(sensors)
    planned = {agent: suiting(agent, devices) for agent in agents or shipped_agents()}
    if agents:
        for agent, scenarios in planned.items():
            if not scenarios:
                raise InputError(f"{agent} does not support {sensors}", "--sensors", "leave it out")
    planned = {agent: scenarios for agent, scenarios in planned.items() if scenarios}
    if not planned:
        raise InputError(f"no agent supports {sensors} alone", "--sensors", "leave it out")
    return planned


def shipped_agents() -> list[str]:
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
