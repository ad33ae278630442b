"""The comparison of kinematic systems: the same frames for all, one table.

``python evaluate.py --compare --motions bandai-namco-2:test --agents ik runs/hmd --out DIR``. A
system is run in every scenario that suits it; docs/agents.md says what they and the columns are.
"""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from agents.kinematic.data import motions_record
from agents.kinematic.drag_solver import DragPoser
from agents.kinematic.interface import Body, KinematicSystem, Poses
from agents.kinematic.recurrent import RecurrentPoser
from agents.kinematic.store import find_system, load_system, read_system_card
from agents.run_folder import versions
from questsim.errors import InputError, at_least
from questsim.files import whole_file
from questsim.joint_sensors import SENSOR_FPS, SensorSequence, readings
from questsim.motion.motion import Motion
from questsim.motion.retarget import to_clip
from questsim.pose_metrics import pose_samples
from questsim.root_force import root_force
from questsim.sensors import SENSOR_SETS

SCHEMA, SCHEMA_VERSION = "questsim-comparison", 1
FILES = ("comparison.json", "comparison.csv", "comparison.md")
WINDOW = 40
"""Frames of the online protocol's sliding window (LGSIK-Poser)."""
SILENT_FRAMES = 100
"""A faulty tracker returns after so many frames (DragPoser)."""


@dataclass(frozen=True)
class Scenario:
    """What a system is given.

    Attributes:
        name: for the table.
        devices: of the sensors.
        faults: chance a frame that one device falls silent.
        options: of the system.
        online: every frame from the last ``WINDOW`` frames alone.
    """

    name: str
    devices: tuple[str, ...]
    faults: float = 0.0
    options: tuple[tuple[str, Any], ...] = ()
    online: bool = False


_HANDS = ("left_controller", "right_controller")
_SIX = (
    "pelvis_tracker", "headset", *_HANDS, "left_foot_tracker", "right_foot_tracker",
)  # fmt: skip
_RECURRENT = {"HMD": "H+2C", "HMD+2IMU": "H+2C+2IMU", "HMD+3IMU": "H+2C+3IMU"}

DRAG_SCENARIOS: tuple[Scenario, ...] = (
    Scenario("3 head+hands", ("headset", *_HANDS)),
    Scenario("3 hip+hands", ("pelvis_tracker", *_HANDS)),
    Scenario("4", _SIX[:4]),
    Scenario("5 no left foot", (*_SIX[:4], "right_foot_tracker")),
    Scenario("6", _SIX),
    Scenario("6, 1 iteration", _SIX, options=(("iterations", 1),)),
    Scenario("6 position only", _SIX, options=(("rotations", False),)),
    Scenario("faulty 0.5 %", _SIX, faults=0.005),
    Scenario("faulty 1 %", _SIX, faults=0.01),
)
"""Those of DragPoser's table 2, and one iteration a frame."""


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        agent, scenario: what was run in which.
        parameters: of the networks.
        equal: means of the clips' means; pooled: means over all frames, long clips weigh more.
        ms: milliseconds a frame, streamed.
    """

    agent: str
    scenario: str
    parameters: int
    equal: dict[str, float | None]
    pooled: dict[str, float | None]
    ms: float


def compare(
    agents: Sequence[str],
    motions: str,
    out: Path | None,
    max_clips: int | None,
    threads: int,
    seed: int,
) -> int:
    """Run the comparison and write its table; returns the exit code.

    Args:
        agents: systems: names, checkpoint folders or run folders.
        motions: what to reconstruct.
        out: the folder for ``FILES``.
        max_clips: at most so many, of all kinds.
        threads: of the networks.
        seed: of faults and synthetic motions.

    Raises:
        InputError: nothing to compare, or what cannot be used.
    """
    from questsim.evaluation_report import check_writable
    from questsim.motion.spec import load_recordings

    at_least(1, threads=threads, max_clips=max_clips)
    at_least(0, seed=seed)
    if out is None:
        raise InputError("a comparison needs a folder", "--compare", "add --out DIR")
    if not agents:
        raise InputError("names no system", "--agents", "e.g. --agents ik runs/hmdposer")
    for agent in agents:
        load_system(agent)
    check_writable(out)
    torch.set_num_threads(threads)
    recordings = load_recordings(motions, seed=seed)
    recordings = [m.resampled(SENSOR_FPS) for m in _chosen(recordings, max_clips)]
    rows = [
        run(agent, scenario, recordings, seed)
        for agent in agents
        for scenario in scenarios(load_system(agent))
    ]
    context = {
        "agents": {agent: _training(agent) for agent in agents},
        "data": motions_record(motions, recordings),
        "versions": versions(),
        "threads": threads,
        "seed": seed,
    }
    write(rows, context, out)
    print(table(rows, "pooled"))
    print(f"written to {out}")
    return 0


def _chosen(motions: Sequence[Motion], count: int | None) -> list[Motion]:
    """A fixed subset that has all kinds of motion in proportion, as ``rolling.choose_clips``."""
    ordered = sorted(motions, key=lambda m: (m.kind, m.style, m.name))
    if count is None:
        return ordered
    picks = np.unique(np.linspace(0, len(ordered) - 1, min(count, len(ordered))).astype(int))
    return [ordered[i] for i in picks]


def _training(agent: str) -> dict[str, Any]:
    folder = find_system(agent)
    return {} if folder is None else read_system_card(folder)["training"]


def scenarios(system: KinematicSystem) -> tuple[Scenario, ...]:
    """The scenarios that suit a system."""
    if isinstance(system, DragPoser):
        return DRAG_SCENARIOS
    if isinstance(system, RecurrentPoser):
        sets = [(name, SENSOR_SETS[key]) for name, key in _RECURRENT.items()]
        return tuple(
            Scenario(name + (", window 40" if online else ""), devices, online=online)
            for online in (False, True)
            for name, devices in sets
        )
    return (Scenario("6", SENSOR_SETS["6T"]),)


def faulty(sequence: SensorSequence, chance: float, seed: int) -> SensorSequence:
    """Each frame one device falls silent with that chance, and returns after 100 frames.

    Source: DragPoser's faulty trackers. Never all of them: the first that is asked stays.
    """
    rng, present = np.random.default_rng(seed), sequence.present.copy()
    for frame in range(1, len(sequence)):
        if rng.random() < chance:
            device = int(rng.integers(present.shape[1]))
            if present[frame].sum() > 1:
                present[frame : frame + SILENT_FRAMES, device] = False
    return replace(sequence, present=present)


def run(agent: str, scenario: Scenario, motions: Sequence[Motion], seed: int) -> Row:
    """Reconstruct all motions in one scenario and score them."""
    system = load_system(agent, **dict(scenario.options))
    scored: list[dict[str, np.ndarray]] = []
    seconds, frames = 0.0, 0
    for i, motion in enumerate(motions):
        sequence = readings(motion, scenario.devices)
        if scenario.faults:
            sequence = faulty(sequence, scenario.faults, seed + i)
        began = time.perf_counter()
        poses = _reconstructed(system, sequence, Body.of(motion), scenario.online)
        seconds += time.perf_counter() - began
        frames += len(motion)
        scored.append(_scored(poses, motion))
    names = list(scored[0])
    by_clip = {name: [s[name].mean() for s in scored if len(s[name])] for name in names}
    together = {name: np.concatenate([s[name] for s in scored]) for name in names}
    return Row(
        agent=agent,
        scenario=scenario.name,
        parameters=parameters(system),
        equal={name: _mean(np.array(values)) for name, values in by_clip.items()},
        pooled={name: _mean(values) for name, values in together.items()},
        ms=1000.0 * seconds / frames,
    )


def _reconstructed(
    system: KinematicSystem, sequence: SensorSequence, body: Body, online: bool
) -> Poses:
    """Streamed one by one, or each frame from its window alone."""
    if online:
        assert isinstance(system, RecurrentPoser)
        return system.predict_windows(sequence, body, WINDOW)
    return KinematicSystem.predict(system, sequence, body)


def _scored(poses: Poses, motion: Motion) -> dict[str, np.ndarray]:
    want, _ = motion.forward_kinematics()
    got, _ = poses.forward_kinematics()
    samples = pose_samples(got, poses.rotations, want, motion.rotations, motion.fps)
    try:
        force = root_force(to_clip(poses.to_motion(motion.name)))
    except InputError:  # a body that no avatar has
        force = np.zeros(0)
    return samples | {"root_force_bw": force}


def parameters(system: KinematicSystem) -> int:
    """How many numbers a system's networks have; 0 without networks."""
    module = getattr(system, "module", None)
    return sum(p.numel() for p in module.parameters()) if module is not None else 0


def _mean(values: np.ndarray) -> float | None:
    return float(values.mean()) if len(values) else None


# -- the table -----------------------------------------------------------------------------------

_Getter = Callable[[Row], dict[str, float | None]]
_WEIGHTS: dict[str, _Getter] = {"equal": lambda row: row.equal, "pooled": lambda row: row.pooled}


def table(rows: Sequence[Row], weighting: str) -> str:
    """A Markdown table; ``weighting`` is ``equal`` or ``pooled``."""
    names = list(rows[0].pooled)
    head = ["agent", "scenario", *names, "parameters", "ms a frame"]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for row in rows:
        figures = [_WEIGHTS[weighting](row)[name] for name in names]
        cells = ["-" if value is None else f"{value:.2f}" for value in figures]
        told = [row.agent, row.scenario, *cells, f"{row.parameters:,}", f"{row.ms:.1f}"]
        lines.append(f"| {' | '.join(told)} |")
    return "\n".join(lines)


def write(rows: Sequence[Row], context: dict[str, Any], out: Path) -> None:
    """Write the table as Markdown, CSV and JSON.

    Raises:
        InputError: the folder cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    report = {
        "schema": SCHEMA,
        "version": SCHEMA_VERSION,
        "context": context,
        "rows": [vars(row) for row in rows],
    }
    with whole_file(out / "comparison.json") as path:
        path.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    with whole_file(out / "comparison.csv") as path, path.open("w", newline="") as file:
        names = list(rows[0].pooled)
        writer = csv.writer(file)
        writer.writerow(["agent", "scenario", "weighting", *names, "parameters", "ms"])
        for row in rows:
            for weighting, figures in _WEIGHTS.items():
                values = [figures(row)[name] for name in names]
                writer.writerow(
                    [row.agent, row.scenario, weighting, *values, row.parameters, row.ms]
                )
    parts = [
        "# Comparison of kinematic systems",
        "",
        f"{context['data']['clips']} clips of `{context['data']['motions']}`, 60 frames a second.",
        "",
        "## All frames alike (length-weighted)",
        "",
        table(rows, "pooled"),
        "",
        "## All clips alike (equal-weighted)",
        "",
        table(rows, "equal"),
    ]
    with whole_file(out / "comparison.md") as path:
        path.write_text("\n".join(parts) + "\n", encoding="utf-8")
