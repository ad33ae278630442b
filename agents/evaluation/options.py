"""Options of the evaluations of one agent: one dataclass per job."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from typing_extensions import Doc

from agents.resolve import DEFAULT_POLICY, AgentName, TorqueAgentName
from envs.objects import OBJECTS
from envs.terrain import TERRAINS
from questsim.modes import one_of

Begin = Literal["reference", "still", "standing", "estimate", "first-estimate"]
CONDITIONS = ("reference", "still", "standing", "noise")
"""Conditions of ``ByGroupArgs``."""


@dataclass(frozen=True)
class _FollowArgs:
    """What every evaluation needs: an agent and clips to follow."""

    agent: AgentName = DEFAULT_POLICY
    motions: str = "synthetic"
    """What to follow: synthetic, a dataset (bandai-namco-2:test), a library, file or folder."""
    max_clips: int | None = None
    """Follow only this many clips, of all kinds of motion."""
    threads: int = 2
    """Threads of physics and networks."""
    seed: int = 0
    """Seed of the embedded motions."""
    workers: int = 0
    """Ray workers that share the clips, each with --threads threads; 0 for none."""
    ray: str | None = None
    """Address of a Ray cluster for --workers, by default one of this machine alone."""


@dataclass(frozen=True)
class EvaluateArgs(_FollowArgs):
    """Run an agent on clips from their first frame and score it."""

    env: str | None = None
    """Environment id (see questsim envs); by default the one the agent needs."""
    body: str | None = None
    """A body of your own instead of our avatar: a TOML file (docs/body.md), or gymnasium-humanoid;
    by default the one that the policy was trained for."""
    height: float | None = None
    """Scale avatar, clips and device signals to this stature in metres; by default each motion's
    own. For an avatar of another stature than its user see --unscaled."""
    own_proportions: bool = False
    """Give each motion's avatar the proportions of its performer, not only the stature."""
    unscaled: float = 0.0
    """Stature in metres of the avatar minus its user's; device signals are not scaled then."""
    terrain: Annotated[
        str | None,
        Doc(f"Ground instead of the environment's own: {one_of(TERRAINS)}, or rough:seed=3."),
    ] = None
    objects: Annotated[
        tuple[str, ...],
        Doc(f"Objects on the clips' paths: {', '.join(OBJECTS)}, or e.g. ball:mass_kg=1."),
    ] = ()
    begin: Begin = "reference"
    """Initial state of the avatar: the user's pose and velocity; the user's pose, at rest; standing
    upright at the user's position, at rest; HMD-Poser's estimate after 0.2 s, when the avatar then
    begins; or its first estimate."""
    noise: bool = False
    """Simulate real devices: noise of 5 mm and 1 degree, mounting errors up to 3 cm and 10 degrees,
    latency jitter up to 2 frames, dropouts of up to half a second every few seconds."""
    seeds: int = 1
    """Repeat with this many seeds of device noise, terrain or the random agent; reports mean and
    standard deviation. The clips stay the same."""
    sensors: str | None = None
    """Sensor set of a kinematic system by name, e.g. H+2C or 6T; by default the set of its first
    comparison scenario."""
    assist: float | None = None
    """Largest assisting force in N for an avatar about to fall or fall behind. Reports its use and
    how many avatars stay upright; 0 reports the latter without a force."""
    out: Path | None = None
    """Folder for metrics.json, clips.csv and plots."""
    video: bool = False
    """Also write a video of the avatar beside the reference."""
    video_clips: tuple[str, ...] = ()
    """Names of the clips in the video; by default four of different kinds."""
    save_motion: str | None = None
    """Also write the avatar's motion on each clip into OUT/motions, as bvh, glb, npz or csv."""


@dataclass(frozen=True, kw_only=True)
class WorldsArgs(_FollowArgs):
    """Let an agent follow clips in the worlds table: rough ground, slopes, pushes, a ball."""

    agent: TorqueAgentName = DEFAULT_POLICY
    out: Path
    """Folder for worlds.json."""
    seed: int = 0
    """Seed of the embedded motions and of the worlds."""


@dataclass(frozen=True, kw_only=True)
class ScorecardArgs(_FollowArgs):
    """Evaluate a policy and its variants at all heights against the project's bars."""

    agent: str = DEFAULT_POLICY
    """The name of a shipped policy; others are called after it, e.g. NAME-headset."""
    out: Path | None = None
    """Folder for scorecard.json and a report of each trial. A trial that is already there, of the
    same policy, motions and versions, is not evaluated again."""
    rows: tuple[str, ...] = ()
    """Only these trials, e.g. h2c standing noise; an unknown name lists them all."""
    extra: str | None = None
    """More motions that no stage was trained on, with a row of their own."""


@dataclass(frozen=True, kw_only=True)
class ByGroupArgs(_FollowArgs):
    """Count the clips that a policy completes in each group of motions, under several conditions.

    Groups are the entries of a mixture file, or the kinds of motion.
    """

    agent: TorqueAgentName = DEFAULT_POLICY
    under: tuple[str, ...] = ("reference", "standing", "noise")
    """Conditions: begun in the user's state (reference), in the user's pose at rest (still) or
    standing at the user's position; or with the device errors of --noise."""
    out: Path | None = None
    """Folder for groups.json and a report of each condition."""
