"""Options of ``questsim replay`` and ``questsim recordings show``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agents.resolve import DEFAULT_POLICY, AgentName

CALIBRATION_S = 3.0
"""Default length in s of the calibration at the start of a recording without one."""


@dataclass(frozen=True)
class FollowArgs:
    """Options of the recording, the agent and the user."""

    file: Annotated[Path, tyro.conf.Positional]
    """The recording: this project's .jsonl.gz, iwer's .json, a .csv with --convention, or
    synthetic for the shipped one."""
    agent: AgentName = DEFAULT_POLICY
    sensors: str | None = None
    """Sensor set, e.g. H+2C or H; by default the agent's own."""
    convention: str | None = None
    """Axes of a CSV file: openxr, steamvr, unity, unreal or questsim."""
    height: float | None = None
    """Stature of the user in metres, by default from the calibration. With it, a calibration in the
    file is not used."""
    pose: str = "hanging"
    """The user's pose during the calibration: hanging or a-pose."""
    calibrate: float = CALIBRATION_S
    """Calibrate on this many seconds at the start, unless the file has a calibration; 0 for none,
    which needs --height."""
    assist: float = 0.0
    """Largest assisting force in N on the avatar."""


@dataclass(frozen=True)
class ReplayArgs(FollowArgs):
    """Let the avatar follow a recording; print its scores."""

    out: Path | None = None
    """Write the scores (.json), a film (.mp4) or the avatar's motion (.bvh, .glb, .npz, .csv)."""


@dataclass(frozen=True)
class ShowRecordingArgs(FollowArgs):
    """Describe a recording, replay it and plot signals and contacts."""

    out: Path = Path("shown")
    """The folder for the PNG and the scores."""
