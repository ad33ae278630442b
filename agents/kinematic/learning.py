"""Settings of the training of kinematic systems, and the interface of its stages."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from agents.kinematic.data import MotionBank
from questsim.errors import InputError, within

OPTIMISERS = ("adam", "adamw")
SCHEDULES = ("cosine", "step", "halving", "plateau")


@dataclass(frozen=True)
class Learning:
    """Settings of one stage.

    Attributes:
        share: share of the whole time budget.
        optimiser: one of ``OPTIMISERS``.
        learning_rate: initial learning rate; see ``rate_at``.
        schedule: one of ``SCHEDULES``, see ``rate_at``.
        final_rate: factor on the rate at the end of a cosine, or at each step or plateau.
        warm_up: gradient steps over which the rate first rises from 0.
        batch: windows, or single poses, per gradient step.
        window: frames per window.
        clip: largest norm of the gradient; None for no limit.
        bfloat16: whether training uses bfloat16 products: about twice as fast on processors with
            native support.
        evaluate_every: gradient steps between evaluations.
        steps: largest number of gradient steps of the stage.
        epochs: published number of passes over the data: the budget without --minutes and --steps.
        stride: frames between the windows of a pass; 0 for one window of each motion.
        kind_power: how often kinds of motion are drawn; see ``data.MotionBank``.
        weights: weights of loss terms by name: HMD-Poser's terms, ``continuity`` in DragPoser's
            ``vae``, ``keep`` in SparsePoser's ``ik``; by default the published ones.
        noise: errors of the devices (``training_faults``); DragPoser learns from poses alone.
    """

    share: float = 1.0
    optimiser: str = "adamw"
    learning_rate: float = 1e-3
    schedule: str = "cosine"
    final_rate: float = 0.05
    warm_up: int = 0
    batch: int = 64
    window: int = 40
    clip: float | None = 1.0
    bfloat16: bool = False
    evaluate_every: int = 500
    steps: int | None = None
    epochs: int | None = None
    stride: int = 0
    kind_power: float = 1.0
    weights: dict[str, float] = field(default_factory=dict)
    noise: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, known in (("optimiser", OPTIMISERS), ("schedule", SCHEDULES)):
            if getattr(self, name) not in known:
                what = f"{name} is {getattr(self, name)!r}, not one of {', '.join(known)}"
                raise InputError(what, "a stage")
        within("a stage", 0.0, 1.0, share=self.share, learning_rate=self.learning_rate)
        within("a stage", 0.0, 1.0, final_rate=self.final_rate, kind_power=self.kind_power)


STEP_AT = 0.75
"""HMD-Poser's learning rate falls after 300 of 400 epochs."""
HALVED_EVERY = 60_000
"""Gradient steps after which AvatarPoser's learning rate is halved, again and again."""
PATIENCE, GAIN = 5, 1e-4
"""LGSIK-Poser's rate falls after more than ``PATIENCE`` evaluations whose error is not lower by the
share ``GAIN``."""


def rate_at(learning: Learning, progress: float, steps: int, errors: Sequence[float]) -> float:
    """The learning rate of a gradient step.

    ``cosine`` falls over the whole budget. ``step`` falls once, at three quarters of it
    (HMD-Poser). ``halving`` falls every ``HALVED_EVERY`` steps (AvatarPoser). ``plateau`` falls
    each time that six evaluations in a row are no better than the best one before (LGSIK-Poser:
    PyTorch's ReduceLROnPlateau with a patience of 5).

    Args:
        learning: settings with the schedule.
        progress: used share of the budget.
        steps: gradient steps so far.
        errors: errors of all evaluations so far.
    """
    if learning.schedule == "cosine":
        share = 0.5 * (1 + math.cos(math.pi * min(progress, 1.0)))
        factor = learning.final_rate + (1 - learning.final_rate) * share
    elif learning.schedule == "step":
        factor = 1.0 if progress < STEP_AT else learning.final_rate
    elif learning.schedule == "halving":
        factor = learning.final_rate ** (steps // HALVED_EVERY)
    else:
        factor = learning.final_rate ** _plateaus(errors)
    warm = min(1.0, (steps + 1) / max(learning.warm_up, 1))
    return learning.learning_rate * factor * warm


def _plateaus(errors: Sequence[float]) -> int:
    """How often errors did not improve for more than ``PATIENCE`` evaluations."""
    best, waited, found = math.inf, 0, 0
    for error in errors:
        better = error < best * (1.0 - GAIN)
        best, waited = (error, 0) if better else (best, waited + 1)
        if waited > PATIENCE:
            found, waited = found + 1, 0
    return found


@dataclass(frozen=True)
class Config:
    """A preset of one kinematic agent.

    Attributes:
        spec: sizes of its networks and run-time settings.
        stages: settings by stage, in the order of training.
        minutes: default time budget of a training; stages with ``epochs`` ignore it.
        validation: number of fixed windows for comparing checkpoints.
    """

    spec: Any
    stages: dict[str, Learning]
    minutes: float = 60.0
    validation: int = 64


@dataclass
class Task:
    """One stage of a training.

    Attributes:
        trained: the parameters that it trains.
        draw: draws a batch with the given random generator.
        loss: loss of a batch, and figures to log.
        validate: figures on the fixed set; ``error_cm`` selects the best checkpoint.
    """

    trained: Sequence[nn.Parameter]
    draw: Callable[[np.random.Generator], Any]
    loss: Callable[[Any], tuple[Tensor, dict[str, float]]]
    validate: Callable[[], dict[str, float]]


def begin_at_rest(layer: nn.Module) -> None:
    """Let a last layer of 6D rotations begin with the pose at rest: every joint unturned."""
    assert isinstance(layer, nn.Linear)
    layer.bias.data.copy_(torch.tensor([1.0, 0, 0, 0, 1, 0]).repeat(len(layer.bias) // 6))


TaskMaker = Callable[[nn.Module, str, Learning, MotionBank, int], Task]
"""Makes a task from network, stage name, settings, motions and number of fixed windows."""
