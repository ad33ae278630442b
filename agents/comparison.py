"""The comparison of kinematic systems: the same frames for all, one table.

``python evaluate.py --compare --motions bandai-namco-2:test --agents ik runs/hmd --out DIR``. A
system is run in every scenario that suits it; docs/agents.md says what they and the columns are.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from agents.agent import load_agent
from agents.checkpoint import find_policy, load_policy, read_card
from agents.comparison_plots import plot_accuracy, plot_plausibility
from agents.comparison_report import Row, row_of, table, write
from agents.evaluation import env_config, roll_out
from agents.kinematic.data import motions_record
from agents.kinematic.drag_solver import DragPoser
from agents.kinematic.efficiency import mmac_a_frame, stream_kib
from agents.kinematic.interface import Body, KinematicSystem, Poses
from agents.kinematic.physics import (
    TRACKER,
    avatar_samples,
    base_of,
    follow_poses,
    reference_of,
    rollout_samples,
)
from agents.kinematic.recurrent import RecurrentPoser
from agents.kinematic.store import UNTRAINED, find_system, load_system, read_system_card
from agents.run_folder import versions
from questsim.errors import InputError, at_least
from questsim.files import whole_file
from questsim.joint_sensors import SENSOR_FPS, SensorSequence, readings
from questsim.motion.motion import Motion
from questsim.motion.retarget import to_clip
from questsim.pose_metrics import pose_samples
from questsim.root_force import root_force
from questsim.sensors import SENSOR_SETS

WINDOW = 40
"""Frames of the online protocol's sliding window (LGSIK-Poser)."""
SILENT_FRAMES = 100
"""A faulty tracker returns after so many frames (DragPoser)."""
FIGURES = {"accuracy.png": plot_accuracy, "plausibility.png": plot_plausibility}
FILES: tuple[str, ...] = ("comparison.json", "comparison.csv", "comparison.md", *FIGURES)
"""What a comparison writes; ``comparison_film.FILES`` too where it is filmed."""


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


def compare(
    agents: Sequence[str],
    motions: str,
    out: Path | None,
    max_clips: int | None,
    threads: int,
    seed: int,
    video: bool = False,
    video_clips: Sequence[str] = (),
) -> int:
    """Run the comparison and write its table and figures; returns the exit code.

    Args:
        agents: systems: names, checkpoint folders or run folders.
        motions: what to reconstruct.
        out: the folder for ``FILES``.
        max_clips: at most so many, of all kinds.
        threads: of the networks.
        seed: of faults and synthetic motions.
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
    if not agents:
        raise InputError("names no system", "--agents", "e.g. --agents ik runs/hmdposer")
    for agent in agents:
        _check(agent)
    check_writable(out)
    torch.set_num_threads(threads)
    everything = load_recordings(motions, seed=seed)
    recordings = chosen(everything, max_clips)
    filmed: Sequence[Motion] = ()
    if video:
        from agents.comparison_film import to_be_filmed

        filmed = to_be_filmed(everything if video_clips else recordings, video_clips)
    rows = [row for agent in agents for row in rows_of(agent, recordings, seed, threads)]
    context = {
        "agents": {agent: _training(agent) for agent in agents},
        "data": motions_record(motions, recordings),
        "versions": versions(),
        "threads": threads,
        "seed": seed,
    }
    write(rows, context, out)
    for name, plot in FIGURES.items():
        with whole_file(out / name) as path:
            plot(rows, path)
    print(table(rows, "pooled"))
    print(f"written to {out}")
    if filmed:
        from agents.comparison_film import film

        film(agents, filmed, out, threads)
    return 0


def chosen(motions: Sequence[Motion], count: int | None) -> list[Motion]:
    """A fixed subset at 60 Hz, all kinds of motion in proportion, as ``rolling.choose_clips``."""
    ordered = sorted(motions, key=lambda m: (m.kind, m.style, m.name))
    ordered = [motion.resampled(SENSOR_FPS) for motion in ordered]
    if count is None:
        return ordered
    picks = np.unique(np.linspace(0, len(ordered) - 1, min(count, len(ordered))).astype(int))
    return [ordered[i] for i in picks]


def is_policy(agent: str) -> bool:
    """Whether an agent is a torque policy and no kinematic system."""
    if agent in UNTRAINED or find_system(agent) is not None:
        return False
    try:
        find_policy(agent)
    except InputError:
        return False
    return True


def _check(agent: str) -> None:
    """Refuse what is no kinematic system, with or without physics, and no policy."""
    if not is_policy(agent):
        load_system(base_of(agent) or agent)


def _training(agent: str) -> dict[str, Any]:
    if is_policy(agent):
        return read_card(find_policy(agent)).get("training", {})
    folder = find_system(base_of(agent) or agent)
    return {} if folder is None else read_system_card(folder)["training"]


def rows_of(agent: str, motions: Sequence[Motion], seed: int, threads: int) -> list[Row]:
    """All rows of one agent: a system, one with physics behind it, or a torque policy."""
    if is_policy(agent):
        return [run_policy(agent, motions, threads)]
    base = base_of(agent)
    if base is None:
        return [run(agent, scenario, motions, seed) for scenario in scenarios(load_system(agent))]
    plain = [s for s in scenarios(load_system(base)) if not (s.online or s.options or s.faults)]
    return [row for scenario in plain for row in run_physics(agent, scenario, motions, threads)]


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
    row = row_of(agent, scenario.name, parameters(system), scored, 1000.0 * seconds / frames)
    if scenario.online or not row.parameters:
        return row
    sequence = readings(motions[0], scenario.devices)
    mmac = mmac_a_frame(system, sequence, Body.of(motions[0]))
    return replace(row, mmac=mmac, stream_kib=stream_kib(system))


def run_physics(
    agent: str, scenario: Scenario, motions: Sequence[Motion], threads: int
) -> list[Row]:
    """Two rows: a system's poses on the avatar without physics, and with.

    Both are held against the motion on the avatar. Milliseconds are a frame of 60 Hz.
    """
    system = load_system(base_of(agent) or agent)
    began = time.perf_counter()
    poses = estimates(system, scenario.devices, motions)
    references = [reference_of(p, m) for p, m in zip(poses, motions, strict=True)]
    frames, kinematic = sum(map(len, motions)), time.perf_counter() - began
    rollouts = follow_poses(references, motions, threads)
    whole = time.perf_counter() - began
    pairs = zip(references, rollouts, strict=True)
    without = [avatar_samples(clip, rollout.reference) for clip, rollout in pairs]
    behind = [rollout_samples(rollout) for rollout in rollouts]
    count = parameters(system)
    return [
        row_of(agent, f"{scenario.name}, no physics", count, without, 1000.0 * kinematic / frames),
        row_of(
            agent, scenario.name, count + _policy_size(TRACKER), behind, 1000.0 * whole / frames
        ),
    ]


def estimates(
    system: KinematicSystem, devices: Sequence[str], motions: Sequence[Motion]
) -> list[Poses]:
    """What a system makes of what devices report of motions at 60 Hz."""
    return [system.predict(readings(motion, devices), Body.of(motion)) for motion in motions]


def run_policy(agent: str, motions: Sequence[Motion], threads: int) -> Row:
    """A torque policy on the same motions, with the devices it was made for."""
    policy = load_agent(agent)
    began = time.perf_counter()
    rollouts = roll_out(policy, [to_clip(m) for m in motions], env_config(policy), threads)
    ms = 1000.0 * (time.perf_counter() - began) / sum(map(len, motions))
    scored = [rollout_samples(rollout) for rollout in rollouts]
    name = {sensors: name for name, sensors in _RECURRENT.items()}
    told = name.get(policy.needs.sensors, policy.needs.sensors)
    return row_of(agent, told, _policy_size(agent), scored, ms)


def _policy_size(agent: str) -> int:
    return sum(p.numel() for p in load_policy(find_policy(agent)).policy.parameters())


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
