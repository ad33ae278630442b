"""The comparison of kinematic systems: the same frames for all, one table.

``python evaluate.py --compare --motions bandai-namco-2:test --out DIR``. An agent is run in every
scenario that suits it; docs/comparison.md says what they and the columns are.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.comparison.plots import plot_accuracy, plot_plausibility
from agents.comparison.report import COSTS, TABLES, table, write
from agents.comparison.run import (
    devices_named,
    is_policy,
    rows_of,
    run_recording,
    suiting,
    workers,
)
from agents.comparison.scenarios import Scenario
from agents.kinematic.data import motions_record
from agents.kinematic.physics_behind import base_of
from agents.kinematic.registry import AGENTS
from agents.kinematic.store import UNTRAINED, find_system, read_system_card
from agents.loading import load_agent
from agents.names import PHYSICS, shipped_policies
from agents.policy.checkpoint import find_policy, read_card
from agents.run_folder import versions
from questsim.errors import InputError, at_least
from questsim.files import whole_file
from questsim.joint_sensors import SENSOR_FPS
from questsim.motion.motion import Motion

FIGURES = {"accuracy.png": plot_accuracy, "plausibility.png": plot_plausibility}
FILES: tuple[str, ...] = ("comparison.json", "comparison.csv", "comparison.md", *FIGURES)
"""What a comparison writes; ``comparison_film.FILES`` too where it is filmed."""


def compare(
    agents: Sequence[str],
    motions: str,
    out: Path | None,
    max_clips: int | None,
    threads: int,
    seed: int,
    sensors: str | None = None,
    video: bool = False,
    video_clips: Sequence[str] = (),
) -> int:
    """Run the comparison and write its table and figures; returns the exit code.

    Args:
        agents: systems: names, checkpoint folders or run folders; none means all that are shipped.
        motions: what to reconstruct.
        out: the folder for ``FILES``.
        max_clips: at most so many, of all kinds.
        threads: that compute side by side.
        seed: of faults and synthetic motions.
        sensors: only with these, a set by name; by default with all that an agent can use.
        video: whether to film it too.
        video_clips: names of the clips to film, of all motions; see ``comparison_film``.

    Raises:
        InputError: nothing to compare, or what cannot be used.
    """
    from questsim.evaluation_report import check_writable
    from questsim.motion.spec import load_recordings

    at_least(1, threads=threads, max_clips=max_clips)
    at_least(0, seed=seed)
    if out is None:
        raise InputError("a comparison needs a folder", "--compare", "add --out DIR")
    planned = plan(agents, sensors)
    check_writable(out)
    everything = load_recordings(motions, seed=seed)
    recordings = chosen(everything, max_clips)
    filmed: Sequence[Motion] = ()
    if video:
        from agents.comparison.film import to_be_filmed

        filmed = to_be_filmed(everything if video_clips else recordings, video_clips)
    with workers(threads) as mapper:
        rows = [run_recording(recordings, mapper)]
        for agent, scenarios in planned.items():
            for row in rows_of(agent, scenarios, recordings, seed, threads, mapper):
                print(f"{agent}: {row.scenario}", file=sys.stderr, flush=True)
                rows.append(row)
    context = {
        "agents": {agent: _training(agent) for agent in planned},
        "data": motions_record(motions, recordings),
        "versions": versions(),
        "threads": threads,
        "seed": seed,
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

        film(agents or representative(planned), filmed, out, threads)
    return 0


def plan(agents: Sequence[str], sensors: str | None) -> dict[str, list[Scenario]]:
    """Agents and the scenarios that each is run in.

    Raises:
        InputError: an agent or set of sensors that is none, or one that cannot use the other.
    """
    devices = devices_named(sensors)
    planned = {agent: suiting(agent, devices) for agent in agents or everyone()}
    if agents:
        for agent, scenarios in planned.items():
            if not scenarios:
                raise InputError(f"{agent} is not run with {sensors}", "--sensors", "leave it out")
    planned = {agent: scenarios for agent, scenarios in planned.items() if scenarios}
    if not planned:
        raise InputError(f"no agent is run with {sensors} alone", "--sensors", "leave it out")
    return planned


def everyone() -> list[str]:
    """All that can be compared without training: systems, these with physics, and policies.

    Without policies that are told the full-body reference, and without ``demo``, which knows the
    embedded motions alone.
    """
    systems = [*UNTRAINED, *(name for name in AGENTS if find_system(name) is not None)]
    apart = [
        name
        for name in shipped_policies()
        if name != "demo" and not load_agent(name).needs.privileged
    ]
    return [*systems, *(name + PHYSICS for name in systems), *apart]


def representative(agents: Iterable[str]) -> list[str]:
    """Of all agents as many as a picture holds: the systems, one with physics, one policy."""
    return [
        agent
        for agent in agents
        if agent in ("hmdposer" + PHYSICS, "questsim")
        or not (is_policy(agent) or base_of(agent) is not None)
    ]


def chosen(motions: Sequence[Motion], count: int | None) -> list[Motion]:
    """A fixed subset at 60 Hz, all kinds of motion in proportion, as ``rolling.choose_clips``."""
    ordered = sorted(motions, key=lambda m: (m.kind, m.style, m.name))
    ordered = [motion.resampled(SENSOR_FPS) for motion in ordered]
    if count is None:
        return ordered
    picks = np.unique(np.linspace(0, len(ordered) - 1, min(count, len(ordered))).astype(int))
    return [ordered[i] for i in picks]


def _training(agent: str) -> dict[str, Any]:
    if is_policy(agent):
        return read_card(find_policy(agent)).get("training", {})
    folder = find_system(base_of(agent) or agent)
    return {} if folder is None else read_system_card(folder)["training"]
