"""Options of the training of torque policies."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from envs.randomisation import Randomisation
from envs.starts import Starts

Pick = Literal["cpu", "paper", "smoke"]
"""Names of presets."""


@dataclass(frozen=True)
class TrainArgs:
    """Train a policy that drives the avatar by torques."""

    out: Path
    """Folder of the run: record, checkpoints, TensorBoard logs."""
    motions: str = "synthetic"
    """What to learn: synthetic, a dataset (bandai-namco-2:train), a library, file or folder."""
    preset: Pick = "cpu"
    """What learns on two cores, what was published, or a test of two minutes."""
    stage: Literal["all", "teacher", "student", "finetune", "ppo"] = "all"
    """One stage alone, with the whole time for itself."""
    minutes: float | None = None
    """Time for everything, earlier parts of a resumed run included; by default the preset's."""
    steps: int | None = None
    """Environment steps of each stage, instead of the preset's limit."""
    resume: bool = False
    """Go on with the run in --out."""
    teacher: Path | None = None
    """A teacher for the student stage: a folder or a shipped name; by default the run's own."""
    start: Path | None = None
    """A teacher, by folder or shipped name, whose weights the teacher begins with; with --stage
    student or finetune, a policy (a run, a stage, a shipped name) that is trained further."""
    estimates: str | None = None
    """Libraries of questsim estimate, joined by commas, of --motions: what learns with --stage
    student or finetune is a tracker that is shown these, and what they are of, while its teacher
    sees, and its reward is for, what the users did."""
    sensors: str = "H+2C"
    """What the policy sees of the user."""
    future_frames: int = 6
    """How many frames ahead it sees the sensors (0 to 6)."""
    heights: tuple[float, float] | None = None
    """Statures in metres to train with, by default the motions' own."""
    mirrored: bool = False
    """Learn every clip mirrored as well."""
    vary: float = 0.0
    """Share of the clips that are random variations of --motions, 0 to 0.95 (docs/motion.md). With
    them kinds of motion of which there is little are drawn more often."""
    redraw: int | None = None
    """With --vary: environment steps after which there are other variations; 5 million."""
    env: str | None = None
    """Ground to learn on: rough, slope, stairs, course, mixed (flat, rough and sloping), ..., or
    rough:amplitude_m=0.06; flat by default. With --start a policy goes on there."""
    pushes: tuple[float, float] | None = None
    """Push the avatars every 1 to 4 s for 0.2 s at the chest, with this least and greatest force in
    newtons, in any direction."""
    objects: tuple[str, ...] = ()
    """Things on the clips' paths, to stumble over and to kick: ball, box, hurdle, chair."""
    randomisation: Randomisation = field(default_factory=Randomisation)
    """What differs between the simulations."""
    starts: Starts = field(default_factory=Starts)
    """How episodes begin; by default in the motion's own state."""
    hold_out: str = ""
    """Styles, joined by commas, that are not learnt from but evaluated on."""
    validation: str | None = None
    """Motions on which checkpoints are compared, as --motions; by default some of those learnt."""
    envs: int | None = None
    """Simulations in the batch, by default the preset's."""
    threads: int = 2
    """Threads of physics and networks."""
    seed: int = 0
    """Of everything that is random."""
    set: tuple[str, ...] = ()
    """Values of the preset to change, e.g. stages.teacher.learning.desired_kl=0.06."""
