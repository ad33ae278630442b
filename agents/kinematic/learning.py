"""What all trainings of kinematic systems are told, and what a stage of one has to supply."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import Tensor, nn

from agents.kinematic.data import MotionBank


@dataclass(frozen=True)
class Learning:
    """How one stage learns.

    Attributes:
        share: of the whole time budget.
        optimiser: ``adam`` or ``adamw``.
        learning_rate: at first; it falls along a cosine over the budget ...
        final_rate: ... to this share of it.
        warm_up: gradient steps over which it first rises from nothing.
        batch: windows, or single poses, a gradient step.
        window: frames of a window.
        clip: largest norm of the gradient; None for any.
        bfloat16: whether the networks' products while training are of that precision: about twice
            as fast on processors that know it.
        evaluate_every: gradient steps between evaluations.
        steps: gradient steps after which the stage ends even if there is time.
    """

    share: float = 1.0
    optimiser: str = "adamw"
    learning_rate: float = 1e-3
    final_rate: float = 0.05
    warm_up: int = 0
    batch: int = 64
    window: int = 40
    clip: float | None = 1.0
    bfloat16: bool = False
    evaluate_every: int = 500
    steps: int | None = None


@dataclass(frozen=True)
class Config:
    """A preset of one kinematic agent.

    Attributes:
        spec: sizes of its networks, and what it does at run time.
        stages: in the order of training.
        minutes: of a training, by default.
        validation: fixed windows that checkpoints are compared by.
    """

    spec: Any
    stages: dict[str, Learning]
    minutes: float = 60.0
    validation: int = 64


@dataclass
class Task:
    """One stage of a training.

    Attributes:
        trained: the parameters it changes.
        draw: a batch, all random numbers from the generator given.
        loss: of a batch, and figures to write down.
        validate: figures of the fixed set; ``error_cm`` is what checkpoints are compared by.
    """

    trained: Sequence[nn.Parameter]
    draw: Callable[[np.random.Generator], Any]
    loss: Callable[[Any], tuple[Tensor, dict[str, float]]]
    validate: Callable[[], dict[str, float]]


TaskMaker = Callable[[nn.Module, str, Learning, MotionBank, int], Task]
"""Network, name of the stage, how it learns, motions, number of fixed windows."""
