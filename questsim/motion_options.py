"""Options of the commands ``questsim motions ...``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class ExportMotionsArgs:
    """Write motions for other programs, one file per motion."""

    spec: tyro.conf.Positional[str]
    """A dataset (with :train or :test), library, file, folder, or synthetic."""
    out: Path
    """The folder for the files."""
    format: str = "bvh"
    """bvh, glb, npz (as AMASS) or csv."""
    skeleton: str | None = None
    """Skeleton of BVH files: joints (the 22 joints as recorded) or avatar (the 16 links of the
    retargeted clip). GLB and CSV always contain the avatar, npz the joints."""
    seed: int = 0
    """Seed of the embedded motions."""


@dataclass
class ImportArgs:
    """Read motion files, check them, retarget them to the avatar, write a library."""

    paths: tyro.conf.Positional[tuple[str, ...]]
    """BVH, ASF/AMC, DeepMimic or AMASS .npz files, libraries, or folders or zips of these."""
    out: str
    """The library to write, LIBRARY.npz."""
    units: Literal["m", "cm", "mm", "inch", "cmu", "dm"] | None = None
    """Units of the files; detected if not given (cmu: inches times 0.45)."""
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None
    """Up axis of the files; detected if not given."""
    fps: float | None = None
    """True frame rate; that of the files if not given."""
    mapping: str | None = None
    """A mapping file (TOML) for a skeleton that is not recognised."""
    height: float | None = None
    """The subject's height in metres, to which the skeleton is scaled."""
    smpl: str | None = None
    """A SMPL model (.npz) that gives AMASS files the subject's own skeleton."""
    licence: str = ""
    """Licence of the files, kept in the library."""
    mirrored: bool = False
    """Add a mirrored copy of each motion."""
    accept: bool = False
    """Accept files that fail the physical checks."""
    strict: bool = False
    """Write no library if any file cannot be used; by default such files are skipped and named."""
    explain: bool = False
    """Print how each file was read: joints with reasons, units, axes, feet, retargeting errors."""
    workers: int = 0
    """Ray workers that share the files (docs/scaling.md); 0 for the cores of this machine."""
    ray: str | None = None
    """Address of a Ray cluster for --workers, whose nodes find the files at the same paths."""


@dataclass(frozen=True)
class ChainArgs:
    """Join clips as a user performs them: standing still, going over to each, from rest to rest."""

    spec: tyro.conf.Positional[str]
    """Motions to join: a dataset (with :train), library, file, folder, or synthetic."""
    out: Path
    """The library to write, LIBRARY.npz."""
    count: int = 100
    """How many chains."""
    each: int = 2
    """Clips of a chain."""
    seed: int = 0
    """Random seed; the same motions and seed give the same chains."""


@dataclass
class MappingArgs:
    """Write a mapping file with the joints that are recognised; fill in and correct the rest."""

    path: tyro.conf.Positional[str]
    """A motion file of the skeleton."""
    out: str
    """The mapping file to write, RIG.toml."""


@dataclass
class FetchArgs:
    """Download a public dataset and verify every clip of it."""

    name: tyro.conf.Positional[str]
    """The dataset, e.g. bandai-namco-2."""
    mirror: str | None = None
    """A zip file or URL with the same layout as the public archive, to use instead of it."""


@dataclass
class ListMotionsArgs:
    """List the contents of a motion argument; without one, the datasets and the embedded kinds."""

    spec: tyro.conf.Positional[str] = ""
    """A dataset (with :train or :test), library, file, folder, or synthetic."""
    clips: Annotated[bool, tyro.conf.arg(aliases=["-c"])] = False
    """List each clip."""


@dataclass(frozen=True)
class ShowArgs:
    """Draw a clip: a contact sheet PNG, one of its feet close up, and an MP4."""

    clip: Annotated[str, tyro.conf.Positional]
    """A clip's name in --motions, or a library, BVH or npz file."""
    motions: str = "synthetic"
    """Where to look the name up: synthetic, a dataset, a library file or a folder."""
    out: Path = Path("shown")
    """The folder for the PNG and the MP4."""
    video: bool = True
    """Whether to make the MP4."""
    columns: int = 8
    """Pictures in a row of the contact sheet."""
    width: int = 640
    """Width of the video in pixels."""
    height: int = 480
    """Height of the video in pixels."""
    stride: int = 1
    """Film every n-th frame; the video keeps its speed."""


@dataclass(frozen=True)
class VaryArgs:
    """Vary motions randomly in speed, posture, stance, path and arm movement."""

    spec: tyro.conf.Positional[str]
    """Motions to vary: a dataset (with :train), library, file, folder, or synthetic."""
    out: Path
    """The library to write, LIBRARY.npz."""
    count: int = 1000
    """How many variations."""
    seed: int = 0
    """Random seed; the same motions and seed give the same variations."""
    first: int = 0
    """Number of the first variation, to continue after an earlier library of this seed."""
    workers: int = 0
    """Ray workers that share the variations (docs/scaling.md); 0 for none."""
    ray: str | None = None
    """Address of a Ray cluster for --workers, by default one of this machine alone."""
