"""Options of the training of torque policies."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from typing_extensions import Doc

from envs.objects import OBJECTS
from envs.randomisation import Randomisation
from envs.starts import Starts
from envs.terrain import TERRAINS
from questsim.modes import one_of

LogName = Literal["tensorboard", "wandb", "trackio", "csv"]
"""Where curves go beside the CSV file; ``csv`` for nowhere else."""
Pick = Literal["cpu", "paper", "smoke"]
"""Names of presets."""


@dataclass(frozen=True)
class TrainArgs:
    """Train a policy that drives the avatar by torques."""

    out: Path
    """Folder of the run: record, checkpoints, TensorBoard logs."""
    motions: str = "synthetic"
    """Motions to learn: synthetic, a dataset (bandai-namco-2:train), a library, file or folder."""
    preset: Pick = "cpu"
    """cpu: learns on two cores; paper: as published; smoke: a test of two minutes."""
    stage: Literal["all", "teacher", "student", "finetune", "ppo"] = "all"
    """Train only this stage, with the whole time budget."""
    minutes: float | None = None
    """Total time budget, including earlier parts of a resumed run; by default the preset's."""
    steps: int | None = None
    """Environment steps of each stage, instead of the preset's limit."""
    resume: bool = False
    """Resume the run in --out."""
    teacher: Path | None = None
    """A teacher for the student stage: a folder or a shipped name; by default the run's own."""
    specialists: tuple[str, ...] = ()
    """With --stage student: teachers to ask instead of --teacher for clips of some kinds, each as
    FOLDER:KIND+KIND; kinds may be patterns (runs/steps:backwards+side-*), and their variations
    belong to them. FOLDER alone is asked for the clips that it follows better than --teacher and
    the others do."""
    start: Path | None = None
    """A teacher, by folder or shipped name, whose weights initialise the new teacher; with --stage
    student or finetune, a policy (a run, a stage, a shipped name) to train further."""
    estimates: str | None = None
    """Libraries that questsim estimate made from --motions, separated by commas. With --stage
    student or finetune, trains a tracker that observes these estimates and the true motions; its
    teacher observes, and its reward scores, the true motions."""
    sensors: str = "H+2C"
    """Sensor set that the policy observes."""
    future_frames: int = 6
    """Number of future sensor frames that it observes (0 to 6)."""
    body: str | None = None
    """A body of your own instead of our avatar: a TOML file, or gymnasium-humanoid; see
    docs/body.md."""
    heights: tuple[float, float] | None = None
    """Statures in metres to train with; by default each motion's own."""
    own_proportions: bool = False
    """Give each motion's avatar the proportions of its performer, not only the stature."""
    proportions: float = 0.0
    """Draw proportions for the avatars: standard deviation of the logarithms of arms, legs, trunk
    and widths, 0 to 0.15, e.g. 0.06."""
    observe_proportions: bool = False
    """Let the policy observe the avatar's proportions beside its stature."""
    mirrored: bool = False
    """Also train on the mirror image of every clip."""
    vary: float = 0.0
    """Share of random variations of --motions among the clips, 0 to 0.95 (docs/motion.md). Rare
    kinds of motion are varied more often."""
    redraw: int | None = None
    """With --vary: environment steps between draws of variations; by default 5 million."""
    env: Annotated[
        str | None,
        Doc(
            f"Training terrain: {one_of(TERRAINS)}, or rough:amplitude_m=0.06; by default flat. "
            "With --start, a policy is trained further on it."
        ),
    ] = None
    pushes: tuple[float, float] | None = None
    """Push the avatars at the chest for 0.2 s every 1 to 4 s, in random directions, with a force
    between these two values in newtons."""
    objects: Annotated[
        tuple[str, ...],
        Doc(
            f"Objects on the clips' paths, to stumble over or kick: {', '.join(OBJECTS)}, or e.g. "
            "chair:aside_m=5. Clips that sit get a chair under them."
        ),
    ] = ()
    randomisation: Randomisation = field(default_factory=Randomisation)
    """Domain randomisation across the simulations."""
    starts: Starts = field(default_factory=Starts)
    """Initial state of episodes; by default the motion's own state."""
    start_estimates: str | None = None
    """Libraries that questsim estimate made of --motions, separated by commas, in whose states the
    share --starts.estimate of the episodes begins; with --estimates it is the observed one."""
    hold_out: str = ""
    """Styles, separated by commas, to hold out from training and evaluate on."""
    validation: str | None = None
    """Motions on which checkpoints are compared, as --motions; by default some training clips."""
    envs: int | None = None
    """Number of parallel simulations; by default the preset's."""
    threads: int = 2
    """Threads of physics and networks; with --workers of each worker."""
    workers: int = 0
    """Ray workers that share the simulations (docs/scaling.md); 0 for none."""
    ray: str | None = None
    """Address of a Ray cluster for --workers, by default one of this machine alone."""
    gradients: Literal["learner", "workers"] = "learner"
    """With --workers: where PPO's gradients are computed. By one learner from the rollouts of all
    workers, or by each worker from its own rollout, then averaged (docs/scaling.md)."""
    log: LogName = "tensorboard"
    """Where curves go, beside a CSV file: tensorboard, Weights & Biases, trackio, or csv for
    nowhere else."""
    seed: int = 0
    """Seed of all random numbers."""
    set: tuple[str, ...] = ()
    """Change values of the preset, e.g. stages.teacher.learning.desired_kl=0.06."""
