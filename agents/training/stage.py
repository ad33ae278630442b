"""One training stage: iterations, evaluations and checkpoints until the budget is used."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from agents.agent import Needs
from agents.evaluation.follow import Followed
from agents.policy.average import KEPT
from agents.policy.checkpoint import load_resume, save_policy, unpack
from agents.policy.policy_agent import PolicyAgent
from agents.training.cluster import with_rates_of
from agents.training.learner import Learner
from agents.training.loggers import LogName
from agents.training.monitor import Display, Monitor, evaluation_figures
from agents.training.ray_session import HeadLostError
from agents.training.shared_update import LearningPool


@dataclass
class Budget:
    """Limits of a stage: wall time, environment steps or both; the first one reached ends it.

    Attributes:
        seconds: None for no limit; time before a resume counts.
        steps: None for no limit.
        spent: seconds spent in earlier runs.
    """

    seconds: float | None
    steps: int | None
    spent: float = 0.0
    _began: float = field(default_factory=time.perf_counter)

    @property
    def elapsed(self) -> float:
        """Seconds spent so far, including earlier runs."""
        return self.spent + time.perf_counter() - self._began

    def progress(self, steps: int) -> float:
        """Share used after ``steps`` environment steps; the stage ends at 1."""
        shares = [0.0]
        if self.seconds is not None:
            shares.append(self.elapsed / self.seconds if self.seconds > 0 else 1.0)
        if self.steps is not None:
            shares.append(steps / max(self.steps, 1))
        return max(shares)

    def left(self, steps: int) -> float:
        """Estimated seconds left."""
        progress = self.progress(steps)
        return self.elapsed * (1 - progress) / progress if progress > 0 else float("inf")


class Stopper:
    """Turns the first Ctrl-C (or SIGTERM) into a stop request; the second one interrupts."""

    def __init__(self) -> None:
        self.requested = False

    def _request(self, *_: object) -> None:
        self.requested = True
        signal.signal(signal.SIGINT, signal.default_int_handler)

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Install the signal handlers, if called in the main thread."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = {s: signal.signal(s, self._request) for s in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


@dataclass
class Stage:
    """A learner, its environment and the folder of its checkpoints.

    Attributes:
        name: ``teacher``, ``student``, ``finetune`` or ``ppo``.
        learner: PPO or DAgger.
        env: the training VecEnv.
        needs: the environment that the policy needs.
        folder: gets ``last/``, ``best/`` and ``tensorboard/``.
        budget: time and step limits.
        validate: runs an agent on the fixed set of clips.
        evaluate_every: environment steps between evaluations.
        record: saved in the checkpoint in addition to steps and figures.
        must_improve: whether only a policy better than the first one counts as best.
        before_iteration: called with the learner's steps; for schedules.
        beside: additional state saved with the learner's, for resuming.
        log: where curves go; see ``training_logger``.
        settings: shown beside the curves, in addition to ``record``.
        keep: whether every evaluated policy is kept; see ``agents/policy/average.py``.
    """

    name: str
    learner: Learner
    env: Any
    needs: Needs
    folder: Path
    budget: Budget
    validate: Callable[[PolicyAgent], Followed]
    evaluate_every: int
    record: dict[str, Any]
    must_improve: bool = False
    before_iteration: Callable[[int], None] | None = None
    beside: dict[str, Any] = field(default_factory=dict)
    log: LogName = "tensorboard"
    settings: dict[str, Any] = field(default_factory=dict)
    keep: bool = False
    best_score: float = -1.0
    history: list[dict[str, float]] = field(default_factory=list)

    def resume(self) -> str | None:
        """Go on from the last checkpoint: steps, networks, optimiser, sampler, random states.

        The avatars go on with their episodes, so that PPO ends with the bits of a run that was
        not interrupted; with another number of workers new ones begin.

        Returns:
            What differs from an uninterrupted run, if anything.
        """
        state = load_resume(self.folder / "last")
        self.learner.load_state_dict(state["learner"])
        saved = unpack(state["env"])
        differs = _differs(saved, self.env)
        self.env.set_state(with_rates_of(saved, self.env) if differs else saved)
        self.budget.spent = state["seconds"]
        self.best_score, self.history = state["best_score"], state["history"]
        torch.set_rng_state(state["torch_random"])
        if differs is None:
            return None
        return f"{differs}: new episodes begin, so the bits are not those of an uninterrupted run"

    def run(self, display: Display, stopper: Stopper) -> None:
        """Train until the budget is used or a stop is requested.

        Raises:
            TrainingError: a loss or reward is not finite; the last checkpoint is kept.
            HeadLostError: the Ray cluster died; a checkpoint of this moment is written.
        """
        learner, budget = self.learner, self.budget
        if budget.progress(learner.num_timesteps) >= 1 and self._is_evaluated():
            return
        monitor = Monitor(self.env, self.folder / "tensorboard", self.log, self._config())
        if not self.history:
            self._evaluate(monitor, display)
            self._save_last()
        due = self._next_evaluation()
        while not stopper.requested and budget.progress(learner.num_timesteps) < 1:
            if self.before_iteration is not None:
                self.before_iteration(learner.num_timesteps)
            progress = budget.progress(learner.num_timesteps)
            try:
                figures = learner.iterate(monitor.observe, progress)
            except HeadLostError:  # the learner still has the state after the last rollout
                self._save_last()
                raise
            rate = monitor.write(learner.num_timesteps, figures)
            self._show(display, rate, monitor.reward)
            if learner.num_timesteps >= due:
                self._evaluate(monitor, display)
                self._save_last()
                due = self._next_evaluation()
        if not stopper.requested and not self._is_evaluated():
            self._evaluate(monitor, display)
        self._save_last()
        monitor.close()

    def _config(self) -> dict[str, Any]:
        run = {"stage": self.name, "num_envs": self.env.num_envs}
        return self.record | run | self.settings

    def _is_evaluated(self) -> bool:
        return bool(self.history) and self.history[-1]["steps"] == self.learner.num_timesteps

    def _next_evaluation(self) -> int:
        return (self.learner.num_timesteps // self.evaluate_every + 1) * self.evaluate_every

    def _show(self, display: Display, rate: float, reward: float) -> None:
        steps, budget = self.learner.num_timesteps, self.budget
        display.update(
            self.name,
            budget.progress(steps),
            steps,
            rate,
            budget.left(steps),
            reward,
            self.history[-1]["tracked"],
        )

    def _evaluate(self, monitor: Monitor, display: Display) -> None:
        first = not self.history
        learner = self.learner
        followed = self.validate(PolicyAgent(learner.policy, self.needs, self.name))
        monitor.write_evaluation(learner.num_timesteps, followed)
        figures = evaluation_figures(followed)
        minutes = round(self.budget.elapsed / 60, 2)
        self.history.append({"steps": learner.num_timesteps, "minutes": minutes, **figures})
        better = followed.score > self.best_score and np.isfinite(followed.score)
        if better:
            self.best_score = followed.score
        best = better and not (first and self.must_improve)
        display.say(
            f"{self.name}: {learner.num_timesteps / 1e6:.2f} M steps, {minutes:.1f} min: "
            f"tracked {100 * followed.tracked:.0f} %, score {followed.score:.3f}, "
            f"link error {followed.error_cm:.1f} cm" + (" (best)" if best else "")
        )
        if best:
            save_policy(self.folder / "best", learner.policy, self.needs, self._card())
        if self.keep:
            kept = self.folder / KEPT / f"{learner.num_timesteps:012d}"
            save_policy(kept, learner.policy, self.needs, self._card())

    def _card(self) -> dict[str, Any]:
        return self.record | {
            "stage": self.name,
            "steps": self.learner.num_timesteps,
            "minutes": round(self.budget.elapsed / 60, 2),
            "evaluation": self.history[-1] if self.history else {},
        }

    def _save_last(self) -> None:
        state = {
            "learner": self.learner.state_dict(),
            "env": self.env.get_state(),
            "seconds": self.budget.elapsed,
            "best_score": self.best_score,
            "history": self.history,
            "torch_random": torch.get_rng_state(),
            **self.beside,
        }
        save_policy(self.folder / "last", self.learner.policy, self.needs, self._card(), state)


def _differs(saved: dict[str, Any], env: Any) -> str | None:
    """How the workers of a saved environment differ from those of ``env``, in words."""
    parts = saved.get("workers", ())
    if len(parts) != getattr(env, "count", 0):
        return "another number of workers"
    if parts and ("order" in parts[0]) != isinstance(env, LearningPool):
        return "gradients are computed elsewhere"
    return None
