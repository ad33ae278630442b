"""Options of the evaluations of one agent, a dataclass a job."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from agents.resolve import DEFAULT_POLICY

Begin = Literal["reference", "still", "standing"]


@dataclass(frozen=True)
class EvaluateArgs:
    """Let an agent follow clips from their first frame and score it."""

    agent: str = DEFAULT_POLICY
    """A run, stage or checkpoint folder; the name of a shipped policy or kinematic system; ik, zero
    or random; package.module:Class of your own; a kinematic system and +physics, e.g.
    hmdposer+physics."""
    motions: str = "synthetic"
    """What to follow: synthetic, a dataset (bandai-namco-2:test), a library, file or folder."""
    env: str | None = None
    """Environment id (see questsim envs); by default what the agent needs."""
    height: float | None = None
    """Stature in metres to scale avatar and clips to; by default the motions' own."""
    avatar_height: float | None = None
    """Stature in metres of the avatar, if it is not its user's: the devices are scaled to it."""
    terrain: str | None = None
    """Ground to walk on, e.g. rough or rough:amplitude_m=0.08, instead of the environment's."""
    objects: tuple[str, ...] = ()
    """Objects on the clips' paths: ball, box, hurdle, chair."""
    begin: Begin = "reference"
    """How the avatar begins: in the user's own state; in the user's pose, at rest; or standing
    upright, at rest, where the user is."""
    noise: bool = False
    """Devices as real ones are: 5 mm and 1 degree of noise, mounted up to 3 cm and 10 degrees off,
    silent for up to half a second every few seconds."""
    sensors: str | None = None
    """The devices of a kinematic system, a set by name, e.g. H+2C or 6T; by default the first that
    it is compared with."""
    assist: float = 0.0
    """Greatest force in N that may help an avatar that is about to be lost; its use is reported."""
    out: Path | None = None
    """Folder for metrics.json, clips.csv and plots."""
    video: bool = False
    """Also write a video of avatar beside reference."""
    video_clips: tuple[str, ...] = ()
    """Names of the clips that the video shows; by default four of different kinds."""
    save_motion: str | None = None
    """Also write what the avatar did on each clip into OUT/motions: bvh, glb, npz or csv."""
    max_clips: int | None = None
    """Follow only this many clips, of all kinds of motion."""
    threads: int = 2
    """Threads of physics and networks."""
    seed: int = 0
    """Of the embedded motions."""


@dataclass(frozen=True, kw_only=True)
class WorldsArgs:
    """Let an agent follow clips in the worlds table: rough ground, slopes, pushes, a ball."""

    agent: str = DEFAULT_POLICY
    """A run, stage or checkpoint folder, the name of a shipped policy, zero, random, or
    package.module:Class of your own."""
    motions: str = "synthetic"
    """What to follow: synthetic, a dataset (bandai-namco-2:test), a library, file or folder."""
    out: Path
    """Folder for worlds.json."""
    max_clips: int | None = None
    """Follow only this many clips, of all kinds of motion."""
    threads: int = 2
    """Threads of physics and networks."""
    seed: int = 0
    """Of the embedded motions, and of the worlds."""


@dataclass(frozen=True, kw_only=True)
class ScorecardArgs:
    """Evaluate a policy and its variants at all heights against the project's bars."""

    agent: str = DEFAULT_POLICY
    """The name of a shipped policy; others are called after it, e.g. NAME-headset."""
    motions: str = "synthetic"
    """What to follow: synthetic, a dataset (bandai-namco-2:test), a library, file or folder."""
    out: Path | None = None
    """Folder for scorecard.json and a report of each trial."""
    max_clips: int | None = None
    """Follow only this many clips, of all kinds of motion."""
    threads: int = 2
    """Threads of physics and networks."""
    seed: int = 0
    """Of the embedded motions."""
