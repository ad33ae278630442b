"""Compare kinematic systems and policies on the same frames in one table.

``python evaluate.py --compare --motions bandai-namco-2:test --out DIR``. Each agent is run in every
scenario that it supports; docs/comparison.md describes scenarios and columns.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from agents.comparison.costs import plan_costs
from agents.comparison.drawn import (
    DRAWN,
    PREDICTOR,
    Scored,
    compared,
    first_starts,
    predictor_over_time,
    predictor_pairs,
)
from agents.comparison.options import CompareArgs
from agents.comparison.plots import plot_accuracy, plot_plausibility
from agents.comparison.record import FILE as RECORD_FILE
from agents.comparison.record import Record
from agents.comparison.report import COSTS, RECORDING, TABLES, Row, row_of, table, write
from agents.comparison.run import KeptPoses, Plan, compute, suiting
from agents.evaluation.follow import choose_clips
from agents.kinematic.data import motions_record
from agents.kinematic.device_faults import NOISES, Noise
from agents.kinematic.estimates import at_sensor_rate, unsupported
from agents.kinematic.first_answers import SETTLED_FRAMES
from agents.kinematic.processes import process_map
from agents.kinematic.registry import AGENTS
from agents.kinematic.scenario import Scenario
from agents.loading import load_agent
from agents.resolve import (
    DEFAULT_POLICY,
    DEFAULT_SYSTEM,
    PHYSICS,
    SYNTHETIC_POLICY,
    UNTRAINED,
    Resolved,
    resolve,
    shipped_policies,
    shipped_systems,
    with_physics,
)
from agents.resolve import ESTIMATE_TRACKER as TRACKER
from agents.run_folder import versions
from agents.training.monitor import Display
from questsim.errors import INTERRUPTED, InputError, at_least, each_once, usable_seed
from questsim.files import whole_file
from questsim.motion.motion import Motion
from questsim.sensors import SENSOR_SETS

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
    usable_seed(args.seed)
    if args.video_clips and not args.video:
        raise InputError("needs a video", "--video-clips", "add --video")
    planned, out = plan(args.agents, args.sensors), args.out
    _refuse_unused(args, planned)
    check_writable(out)
    if args.finished and not (out / RECORD_FILE).exists():
        raise InputError("has no comparison that was begun", out, "leave --finished out")
    everything = load_recordings(args.motions, seed=args.seed)
    recordings = at_sensor_rate(everything, args.max_clips)
    fewer = choose_clips(recordings, args.fewer_clips or len(recordings))
    filmed = _filmed(args, everything, recordings)
    context: dict[str, Any] = {
        "agents": {name: each.agent.training for name, each in planned.items()},
        "tracker": resolve(TRACKER).training,
        "data": motions_record(args.motions, recordings),
        "versions": versions(),
        "seed": args.seed,
        "fewer_clips": args.fewer_clips,
        "settled_frames": SETTLED_FRAMES,  # of the start "estimate"
    }
    if args.fewer_rows != CompareArgs(out=out).fewer_rows:
        context["fewer_rows"] = sorted(args.fewer_rows)
    plans = all_plans(planned, args)
    work = [
        Work(plan, fewer if plan.slow.intersection(args.fewer_rows) else recordings)
        for plan in plans
    ]
    common = {name: context[name] for name in context if name not in ("agents", "tracker")}
    digests = {name: digest(each.agent) for name, each in planned.items()}
    with Record(out, common, {RECORDING: RECORDING} | digests) as record:
        try:
            scored = _scored(work, recordings, args, record)
        except KeyboardInterrupt:
            print(f"stopped; the same command continues in {out}", file=sys.stderr)
            return INTERRUPTED
    if not scored:
        raise InputError("no row is complete yet", out, "leave --finished out")
    _tell_missing(out, planned if args.agents else (), plans, [row for row, _ in scored])
    places = {recording.name: place for place, recording in enumerate(recordings)}
    if pairs := predictor_pairs(scored, [places[motion.name] for motion in fewer]):
        with whole_file(out / PREDICTOR) as path:
            predictor_over_time(pairs, path)
    _write_all(scored, context, out)
    if filmed:
        shown = args.agents or representative(planned)
        _film(args, shown, filmed, [row for row, _ in compared(scored)], recordings)
    return 0


def _tell_missing(
    out: Path, asked: Iterable[str], plans: Sequence[Plan], rows: Sequence[Row]
) -> None:
    """Say on stderr how many rows of which agents the record lacks.

    Raises:
        InputError: an agent that was asked for by name has no row at all.
    """
    left = Counter(plan.name for plan in plans for _ in plan.rows)
    left.subtract(row.agent for row in rows)
    there = {row.agent for row in rows}
    if absent := [name for name in asked if name not in there]:
        what = f"no row of {', '.join(absent)} is complete"
        raise InputError(what, out, "leave --finished out")
    if told := ", ".join(f"{count} of {name}" for name, count in left.items() if count > 0):
        print(f"warning: rows that are not complete are left out: {told}", file=sys.stderr)


def _filmed(
    args: CompareArgs, everything: Sequence[Motion], recordings: Sequence[Motion]
) -> Sequence[Motion]:
    """The motions of the film; none without ``--video``."""
    if not args.video:
        return ()
    from agents.comparison.film import to_be_filmed

    return to_be_filmed(everything if args.video_clips else recordings, args.video_clips)


def _film(
    args: CompareArgs,
    shown: Sequence[str],
    filmed: Sequence[Motion],
    rows: Sequence[Row],
    recordings: Sequence[Motion],
) -> None:
    """Film the systems to be shown, and draw strips of the clips on which they are worst."""
    from agents.comparison.film import film
    from agents.comparison.worst import worst_strips

    if film(shown, filmed, args.out, args.threads, args.starts[0]):
        worst_strips(rows, recordings, args.out, args.threads)


def _write_all(scored: Sequence[Scored], context: dict[str, Any], out: Path) -> None:
    """Write tables and figures of the rows, and print the tables."""
    rows = [row for row, _ in scored]
    there = {row.agent for row in rows}
    records = context["agents"].items()
    context["agents"] = {name: record for name, record in records if name in there}
    write(rows, context, out)
    for name, plot in FIGURES.items():
        with whole_file(out / name) as path:
            plot(first_starts(rows) or rows, path)
    for name, draw in DRAWN.items():
        with whole_file(out / name) as path:
            draw(scored, path)
    for names in (*TABLES.values(), COSTS):
        print(table(rows, names, ends=True), end="\n\n")
    print(f"written to {out}")


def _refuse_unused(args: CompareArgs, planned: Mapping[str, Planned]) -> None:
    """Refuse options that change nothing in the rows, and rows that are asked for twice."""
    simulated = any(each.agent.simulated for each in planned.values())
    if args.starts != CompareArgs(out=args.out).starts and not simulated:
        raise InputError("does nothing: no agent has physics", "--starts", "leave it out")
    if args.windows and not any(s.online for each in planned.values() for s in each.scenarios):
        what = "does nothing: no agent has the protocol with windows"
        raise InputError(what, "--windows", "leave it out")
    if args.fewer_clips is None and args.fewer_rows != CompareArgs(out=args.out).fewer_rows:
        raise InputError("does nothing", "--fewer-rows", "add --fewer-clips N")
    each_once(agents=args.agents, starts=args.starts, noise=args.noise, fewer_rows=args.fewer_rows)


def all_plans(planned: Mapping[str, Planned], args: CompareArgs) -> list[Plan]:
    """Everything to be computed: the recording, then each agent's scenarios and conditions.

    Noise applies to plain scenarios; with physics it is followed from the first start alone.
    """
    plans = [Plan(None, Scenario("60 Hz", ()))]
    for name, each in planned.items():
        agent = each.agent
        starts = args.starts if agent.simulated else ()
        kept = name + PHYSICS in planned
        for scenario in each.scenarios:
            if scenario.online and not args.windows:
                continue
            if starts[1:] and "starts" in args.fewer_rows:
                plans.append(Plan(agent, scenario, None, starts[:1], kept))
                plans.append(Plan(agent, scenario, None, starts[1:], kept, further=True))
            else:
                plans.append(Plan(agent, scenario, None, starts, kept))
            if scenario.plain:
                plans += [Plan(agent, scenario, noise, starts[:1], kept) for noise in args.noise]
    return plans


def digest(agent: Resolved) -> str:
    """A digest of everything trained that an agent's rows depend on."""
    parts = [agent]
    if agent.kind == "physics":
        parts.append(resolve(TRACKER))
    elif agent.torques:  # begins in its estimates
        parts.append(resolve(DEFAULT_SYSTEM))
    whole = hashlib.sha256()
    for part in parts:
        whole.update(json.dumps(part.training, sort_keys=True, default=str).encode())
        for file in sorted(part.folder.glob("*.safetensors")) if part.folder else ():
            whole.update(file.read_bytes())
    return whole.hexdigest()[:16]


class Work(NamedTuple):
    """A plan and its clips."""

    plan: Plan
    motions: Sequence[Motion]

    @property
    def names(self) -> list[str]:
        """Names of the clips."""
        return [motion.name for motion in self.motions]


def _scored(
    work: Sequence[Work], motions: Sequence[Motion], args: CompareArgs, record: Record
) -> list[Scored]:
    """Compute what is missing and make all rows; times are measured at the end, in one pass."""
    if not args.finished:
        _compute(work, args, record)
    scored, measured = [], {} if args.times else None
    fewer = min((each.names for each in work), key=len)
    for each in work:
        plan, names = each.plan, each.names
        there = [not record.missing([plan.key(row)], names) for row in plan.rows]
        if not any(there):
            continue
        costs = plan_costs(plan, motions, measured)
        for row, cost, complete in zip(plan.rows, costs, there, strict=True):
            if complete:
                found = record.of(plan.key(row), names)
                same = record.of(plan.key(row), fewer) if len(fewer) < len(names) else ()
                scored.append((row_of(plan.name, row, found, cost, names, same), found))
    return scored


def _compute(work: Sequence[Work], args: CompareArgs, record: Record) -> None:
    """Compute the clips that the record lacks, and show how long it will take.

    Args:
        work: plans of all rows with their clips.
        args: seed and threads.
        record: gets the results.
    """
    left = 0
    for each in work:
        keys = [each.plan.key(row) for row in each.plan.rows]
        left += len(record.missing(keys, each.names))
    whole, done, rate, began = max(left, 1), 0, 0.0, time.monotonic()
    estimates = KeptPoses()
    with Display() as display, process_map(args.threads, args.workers, args.ray) as mapper:
        for number, each in enumerate(in_turn(work), start=1):
            name = each.plan.key(each.plan.rows[0])
            steps = compute(
                each.plan,
                each.motions,
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
            display.say(f"{number}/{len(work)} {name}; about {minutes:.0f} min left")


def in_turn(work: Sequence[Work]) -> list[Work]:
    """The order of computation: exact signals and plain streams first; physics after estimates."""
    first: dict[tuple[str, Scenario, Noise | None], int] = {}
    keys = []
    for number, (plan, _) in enumerate(work):
        estimates = plan.system or plan.name, plan.scenario, plan.noise
        alike = first.setdefault(estimates, number)
        noise = 0 if plan.noise is None else 1 + NOISES.index(plan.noise)
        keys.append((noise, not plan.scenario.plain, alike, number))
    return [work[key[-1]] for key in sorted(keys)]


@dataclass(frozen=True)
class Planned:
    """An agent of the comparison and the scenarios in which it is run."""

    agent: Resolved
    scenarios: Sequence[Scenario]

    def only(self, sensors: str) -> Planned:
        """The agent in the scenarios of a sensor set alone; in none if there is no such set."""
        devices = SENSOR_SETS.get(sensors, ())
        return replace(self, scenarios=[each for each in self.scenarios if each.has(devices)])


def plan(agents: Sequence[str], sensors: str | None) -> dict[str, Planned]:
    """The agents by name, each with the scenarios in which it is run.

    Raises:
        InputError: an unknown agent or sensor set, or an agent that cannot use the sensors.
    """
    resolved = [resolve(name) for name in agents or shipped_agents()]
    every = {agent.name: Planned(agent, suiting(agent)) for agent in resolved}
    if sensors is None:
        return every
    planned = {name: each.only(sensors) for name, each in every.items()}
    for name, each in planned.items():
        if agents and not each.scenarios:
            raise unsupported(name, sensors, every[name].scenarios)
    planned = {name: each for name, each in planned.items() if each.scenarios}
    if not planned:
        found = [scenario for each in every.values() for scenario in each.scenarios]
        raise unsupported("no agent", sensors, found)
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


def representative(planned: Mapping[str, Planned]) -> list[str]:
    """The agents that fit into a picture: the systems, one with physics, one policy."""
    always = (DEFAULT_SYSTEM + PHYSICS, DEFAULT_POLICY)
    return [n for n, each in planned.items() if n in always or not each.agent.simulated]
