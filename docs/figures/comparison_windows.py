"""Errors by frame in a window without past: ``python -m docs.figures.comparison_windows``.

    python -m docs.figures.comparison_windows --motions bandai-namco-2:test --max-clips 24

Cuts every clip into windows of 40 frames, each of which a system estimates from zero LSTM states,
as in LGSIK-Poser's online protocol. Prints a table of the mean joint error by frame in the window
and draws ``docs/images/comparison-windows.png``. Unlike the error since the start of a clip, this
does not depend on how clips begin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import tyro

from agents.kinematic.estimates import at_sensor_rate
from agents.kinematic.interface import KinematicSystem, UserBody
from agents.kinematic.scenario import WINDOW, Scenario
from agents.kinematic.store import load_system
from questsim.cli import guarded
from questsim.errors import InputError, at_least
from questsim.joint_sensors import SensorSequence, readings
from questsim.motion.motion import Motion
from questsim.motion.spec import load_recordings
from questsim.plots import figure_file
from questsim.pose_metrics import HEAD, aligned, joints_cm

PICTURE = Path(__file__).parents[1] / "images" / "comparison-windows.png"
EVERY = 20
"""Frames from the begin of a window to that of the next (LGSIK-Poser's training windows)."""
SHOWN = (1, 2, 3, 5, 10, 15, 20, 30, 40)
"""Frames in the table, counted from one."""


@dataclass(frozen=True)
class Args:
    """Print and draw the joint error by frame in the window."""

    motions: str = "synthetic"
    """Motions, as for evaluate.py."""
    max_clips: int | None = None
    """Use only this many motions, of all kinds."""
    agents: tuple[str, ...] = ("hmdposer", "lgsik", "lgsik-lengths")
    """Systems with the protocol."""


def part(sequence: SensorSequence, begin: int, count: int) -> SensorSequence:
    """``count`` frames of a sequence."""
    names = [field.name for field in fields(sequence) if field.name != "names"]
    cut = slice(begin, begin + count)
    return replace(sequence, **{name: getattr(sequence, name)[cut] for name in names})


def by_frame(
    system: KinematicSystem, scenario: Scenario, motions: Sequence[Motion]
) -> tuple[np.ndarray, int]:
    """Mean joint error in cm ``(40,)`` by frame, heads aligned, and the number of windows.

    Raises:
        InputError: no motion has as many frames as a window.
    """
    errors = []
    for motion in motions:
        sequence, body = readings(motion, scenario.devices), UserBody.of(motion)
        truth = motion.forward_kinematics()[0]
        for begin in range(0, len(motion) - WINDOW + 1, EVERY):
            poses = system.predict(part(sequence, begin, WINDOW), body)
            want = truth[begin : begin + WINDOW]
            got = aligned(poses.forward_kinematics()[0], want, HEAD)
            errors.append(joints_cm(got, want))
    if not errors:
        raise InputError(f"no motion has {WINDOW} frames", "--motions", "use longer ones")
    return np.mean(errors, axis=0), len(errors)


def systems_of(names: Sequence[str]) -> dict[str, tuple[KinematicSystem, list[Scenario]]]:
    """Systems by name, each with its scenarios that stream.

    Raises:
        InputError: a system does not have the protocol with windows.
    """
    found = {}
    for name in names:
        system = load_system(name)
        if not any(scenario.online for scenario in system.scenarios):
            what = f"{name} does not have the protocol with windows"
            raise InputError(what, "--agents", "use hmdposer, lgsik or a run of theirs")
        found[name] = system, [scenario for scenario in system.scenarios if scenario.plain]
    return found


def main() -> None:
    """Print the table and draw the picture.

    Raises:
        InputError: motions or agents cannot be used.
    """
    args = tyro.cli(Args)
    at_least(1, max_clips=args.max_clips)
    systems = systems_of(args.agents)
    motions = at_sensor_rate(load_recordings(args.motions), args.max_clips)
    count = 0
    print(f"| agent | scenario | {' | '.join(f'frame {n}' for n in SHOWN)} |")
    print("|" + "---|" * (len(SHOWN) + 2))
    with figure_file(PICTURE, 8.0, 4.0) as figure:
        axis = figure.subplots()
        for number, (name, (system, plain)) in enumerate(systems.items()):
            for scenario, style in zip(plain, ("-", "--", ":"), strict=True):
                errors, count = by_frame(system, scenario, motions)
                cells = " | ".join(f"{errors[n - 1]:.2f}" for n in SHOWN)
                print(f"| {name} | {scenario.name} | {cells} |", flush=True)
                label = f"{name}, {scenario.name}"
                axis.plot(np.arange(1, WINDOW + 1), errors, f"C{number}{style}", label=label)
        axis.set_xlabel("Frame in the window")
        axis.set_ylabel("MPJPE (cm)")
        axis.set_xlim(1, WINDOW)
        axis.set_ylim(bottom=0.0)
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8)
    print(f"{count} windows of {len(motions)} clips; {PICTURE}")


if __name__ == "__main__":
    raise SystemExit(guarded(main))
