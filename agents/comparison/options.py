"""Options of the comparison, and of ``questsim ablations``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from typing_extensions import Doc

from agents.kinematic.options import Noise
from agents.resolve import ANY_AGENT

Start = Literal["estimate", "first-estimate", "user", "standing"]
"""States in which avatars with physics begin."""

Slow = Literal["avatars", "starts", "noise", "options"]
"""Rows that take more time than kinematic systems that stream exact signals."""


@dataclass(frozen=True, kw_only=True)
class CompareArgs:
    """Compare kinematic systems and policies on the same frames."""

    agents: Annotated[
        tuple[str, ...],
        Doc(f"Agents to compare, by default all shipped ones. Each is {ANY_AGENT}."),
    ] = ()
    motions: str = "synthetic"
    """Motions to reconstruct: synthetic, a dataset, a library, file or folder."""
    sensors: str | None = None
    """Use only this sensor set, e.g. H+2C or 6T; by default every set that an agent supports."""
    out: Path
    """Folder for tables, figures and the film. The same command continues a stopped comparison."""
    starts: tuple[Start, ...] = ("estimate",)
    """States in which avatars with physics begin, a row each: the kinematic system's estimate
    (HMD-Poser's for policies) after 0.2 s, when the avatar then begins, its first estimate, the
    user's own state, or standing. The film has the first of these."""
    noise: tuple[Noise, ...] = ()
    """Rows of every agent with noisy devices, too: white (5 mm, 0.02 rad), mounts (off by up to 3
    cm and 10 degrees), latency (83 ms), dropouts (up to 0.5 s), or all of these."""
    cards: bool = False
    """Also write the figures into the cards of the shipped agents."""
    video: bool = False
    """Also write a film of all agents side by side."""
    video_clips: tuple[str, ...] = ()
    """Names of the clips in the film; by default some of different kinds."""
    max_clips: int | None = None
    """Reconstruct only this many motions, of all kinds."""
    fewer_clips: int | None = None
    """Use only this many of the clips, of all kinds, in the rows of --fewer-rows."""
    fewer_rows: tuple[Slow, ...] = ("avatars", "noise", "options")
    """With --fewer-clips: avatars with physics, or only their --starts after the first, noisy
    devices, options of a system (also windows of 40 frames and faulty trackers). All other rows are
    kinematic systems that stream exact signals, which take the least time."""
    windows: bool = False
    """Also estimate each frame from its last 40 frames alone (LGSIK-Poser's online protocol)."""
    finished: bool = False
    """Compute no more clips: write tables and figures of the rows that are complete in --out."""
    times: bool = True
    """Measure the milliseconds per frame; leave them out while other programs use the processor."""
    threads: int = 2
    """Number of parallel processes, and of threads of physics; the figures are the same."""
    workers: int = 0
    """Ray workers that share the clips (docs/scaling.md); 0 for none."""
    ray: str | None = None
    """Address of a Ray cluster for --workers, by default one of this machine alone."""
    seed: int = 0
    """Seed of device faults and of the embedded motions."""


@dataclass(frozen=True)
class AblationsArgs:
    """Train a system, or QuestSim, and variants that lack one part each, and compare them."""

    agent: str = ""
    """A kinematic system with variants, or questsim for the torque policy."""
    motions: str = "synthetic"
    """Motions to learn: synthetic, a dataset (bandai-namco-2:train), a library, file or folder."""
    test: str = "synthetic"
    """Motions to reconstruct; others than --motions show how the variants generalise."""
    out: Path | None = None
    """Folder of the table, with one subfolder per run."""
    minutes: float | None = None
    """Time for each training."""
    steps: int | None = None
    """Gradient steps of each stage of each training, instead of or in addition to --minutes."""
    preset: Literal["cpu", "paper", "smoke"] = "cpu"
    """Network sizes and training settings, as in train.py."""
    stage: Literal["all", "teacher", "student", "ppo"] = "all"
    """With --agent questsim: train only this stage, as in train.py."""
    teacher: Path | None = None
    """With --stage student: the teacher of all variants, a folder or a shipped name."""
    variants: tuple[str, ...] = ()
    """Run only these variants; by default all."""
    max_clips: int | None = None
    """Reconstruct at most this many motions, of all kinds."""
    resume: bool = False
    """Resume in --out; finished variants are skipped."""
    threads: int = 2
    """Threads for the networks."""
    workers: int = 0
    """Ray workers, each of which trains and scores one variant at a time; 0 for none."""
    ray: str | None = None
    """Address of a Ray cluster for --workers, by default one of this machine alone."""
    seed: int = 0
    """Seed of all random numbers, the same for all variants."""
    seeds: int = 1
    """Train the full system with this many seeds: --seed, --seed + 1 and so on."""
    hold_out: str = ""
    """Train the full system also without these styles, separated by commas, and score all variants
    also on the test motions of these styles alone."""
    set: tuple[str, ...] = ()
    """Change values of the preset for all variants, e.g. stages.network.batch=16."""
