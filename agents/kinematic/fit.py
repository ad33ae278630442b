"""One stage of a kinematic system's training: gradient steps, evaluations and checkpoints."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from agents.kinematic.learning import Learning, Task, rate_at
from agents.kinematic.team import Descent, Nobody, Team
from agents.policy.checkpoint import load_resume
from agents.training.loggers import LogName, training_logger
from agents.training.monitor import Display
from agents.training.stage import Budget, Stopper
from questsim.errors import InputError

LOG_EVERY = 20


@dataclass
class Fit:
    """A module, the task of a stage, and the folder of its checkpoints.

    Attributes:
        name: name of the stage.
        module: all networks of the system; the task says which are trained.
        task: batches, loss and validation.
        learning: optimiser and intervals.
        folder: gets ``last/``, ``best/`` and ``tensorboard/``.
        budget: limits of time and of gradient steps.
        save: writes a checkpoint folder with the training record and the state for resuming.
        record: saved in the checkpoint in addition to steps and figures.
        seed: seed of all random numbers.
        log: where curves go; see ``training_logger``.
        team: workers that share the batches; ``task`` draws this process's part.
    """

    name: str
    module: nn.Module
    task: Task
    learning: Learning
    folder: Path
    budget: Budget
    save: Callable[[Path, dict[str, Any], dict[str, Any] | None], None]
    record: dict[str, Any]
    seed: int
    log: LogName = "tensorboard"
    team: Team = field(default_factory=Nobody)
    steps: int = 0
    best_cm: float = math.inf
    history: list[dict[str, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._descent = Descent(self.module, self.task, self.learning)
        self._rng = np.random.default_rng(self.seed)
        self._count_before = self.team.count

    def resume(self) -> None:
        """Continue from the last checkpoint: steps, networks, optimiser and random states.

        Another number of workers may continue it; it then draws other batches.
        """
        state = load_resume(self.folder / "last")
        self.module.load_state_dict(state["module"])
        self._descent.optimiser.load_state_dict(_int_keys(state["optimiser"]))
        self._rng.bit_generator.state = _rng_state(state["random"])
        torch.set_rng_state(state["torch_random"])
        self.steps, self.budget.spent = state["steps"], state["seconds"]
        self.best_cm, self.history = state["best_cm"], state["history"]
        self._count_before = state.get("workers", self.team.count)

    def run(self, display: Display, stopper: Stopper) -> None:
        """Train until the budget is used or a stop is requested.

        Raises:
            InputError: a loss is not finite; the last checkpoint is kept.
        """
        budget = self.budget
        if budget.progress(self.steps) >= 1 and self._is_evaluated():
            return
        logger = training_logger(self.folder / "tensorboard", self.log, self.record)
        if self._count_before != self.team.count:
            display.say(
                f"{self.name}: another number of workers ({self._count_before} before, now "
                f"{self.team.count}): it draws other windows; weights, optimiser and steps continue"
            )
        if not self.history:
            self._evaluate(logger, display)
        self.team.sync(self._descent)
        began, count = time.perf_counter(), 0
        while not stopper.requested and budget.progress(self.steps) < 1:
            figures = self._step(budget.progress(self.steps))
            count += 1
            if self.steps % LOG_EVERY == 0:
                rate = count / max(time.perf_counter() - began, 1e-9)
                self._log(logger, figures | {"time/steps_per_second": rate}, "training")
                self._show(display, figures, rate)
            if self.steps % self.learning.evaluate_every == 0:
                self._evaluate(logger, display)
                self._save_last()
                self.team.sync(self._descent)  # processors of other kinds round differently
        if not stopper.requested and not self._is_evaluated():
            self._evaluate(logger, display)
        self._save_last()
        logger.close()

    def _step(self, progress: float) -> dict[str, float]:
        errors = [entry["error_cm"] for entry in self.history]
        rate = rate_at(self.learning, progress, self.steps, errors)
        self.team.begin(self._descent, rate, self.steps)
        loss, figures = self._descent.gradients(self._rng)
        loss = self.team.average(self._descent, loss)
        if not bool(torch.isfinite(loss)):
            raise InputError(
                f"loss is not finite at step {self.steps}", self.name, "lower learning_rate"
            )
        self._descent.step(rate)
        self.steps += 1
        return {"loss": float(loss), **figures}

    def _is_evaluated(self) -> bool:
        return bool(self.history) and self.history[-1]["steps"] == self.steps

    def _evaluate(self, logger: Any, display: Display) -> None:
        self.module.eval()
        with torch.no_grad():
            figures = {name: round(value, 6) for name, value in self.task.validate().items()}
        self._log(logger, figures, "evaluation")
        minutes = round(self.budget.elapsed / 60, 2)
        self.history.append({"steps": self.steps, "minutes": minutes, **figures})
        better = figures["error_cm"] < self.best_cm
        if better:
            self.best_cm = figures["error_cm"]
            self.save(self.folder / "best", self._card(), None)
        display.say(
            f"{self.name}: {self.steps} steps, {minutes:.1f} min: error "
            f"{figures['error_cm']:.2f} cm" + (" (best)" if better else "")
        )

    @staticmethod
    def _not_prefixed(name: str, prefix: str) -> str:
        return name if "/" in name else f"{prefix}/{name}"

    def _log(self, logger: Any, figures: dict[str, float], prefix: str) -> None:
        for name, value in figures.items():
            logger.record(self._not_prefixed(name, prefix), value)
        logger.record("time/total_timesteps", self.steps)
        logger.dump(self.steps)

    def _show(self, display: Display, figures: dict[str, float], rate: float) -> None:
        text = (
            f"{self.steps} steps  {rate:.1f}/s  loss {figures['loss']:.4f}  "
            f"error {self.history[-1]['error_cm']:.2f} cm"
        )
        budget = self.budget
        display.show(self.name, budget.progress(self.steps), text, budget.left(self.steps))

    def _card(self) -> dict[str, Any]:
        return self.record | {
            "stage": self.name,
            "steps": self.steps,
            "minutes": round(self.budget.elapsed / 60, 2),
            "evaluation": self.history[-1] if self.history else {},
        }

    def _save_last(self) -> None:
        state = {
            "module": self.module.state_dict(),
            "optimiser": self._descent.optimiser.state_dict(),
            "random": _plain_rng(self._rng),
            "torch_random": torch.get_rng_state(),
            "steps": self.steps,
            "workers": self.team.count,
            "seconds": self.budget.elapsed,
            "best_cm": self.best_cm,
            "history": self.history,
        }
        self.save(self.folder / "last", self._card(), state)


def _plain_rng(rng: np.random.Generator) -> dict[str, Any]:
    """PCG64's state with its two long integers as text, which every file format can store."""
    state = rng.bit_generator.state
    return {**state, "state": {key: str(value) for key, value in state["state"].items()}}


def _rng_state(plain: dict[str, Any]) -> dict[str, Any]:
    return {**plain, "state": {key: int(value) for key, value in plain["state"].items()}}


def _int_keys(state: dict[str, Any]) -> dict[str, Any]:
    return {**state, "state": {int(key): value for key, value in state["state"].items()}}
