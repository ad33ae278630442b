"""Output of a running training: curves and a progress line."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from agents.evaluation.follow import Followed
from agents.training.loggers import LogName, training_logger


class Monitor:
    """Accumulates statistics between log points and writes them as curves.

    Args:
        env: the training environment; its ``reward_terms`` are read after each step, its
            ``unstable_count`` at each log point.
        folder: folder of TensorBoard's files and of ``progress-1.csv`` with the same curves.
        log, config: see ``training_logger``.
    """

    def __init__(
        self,
        env: Any,
        folder: Path,
        log: LogName = "tensorboard",
        config: Mapping[str, Any] | None = None,
    ) -> None:
        self._env = env
        self._logger = training_logger(folder, log, config)
        self._begin()
        self.reward = 0.0

    def _begin(self) -> None:
        self._since = time.perf_counter()
        self._steps = 0
        self._reward, self._terms = 0.0, np.zeros(self._env.reward_terms.shape[1])
        self._lengths: list[int] = []
        self._ended: Counter[str] = Counter()
        self._fallen: Counter[str] = Counter()

    def observe(self, rewards: np.ndarray, dones: np.ndarray, infos: list[dict[str, Any]]) -> None:
        """Record one step: rewards and dones ``(n,)``, infos of ended episodes."""
        self._steps += len(rewards)
        self._reward += float(rewards.sum())
        self._terms += self._env.reward_terms.sum(0)
        for i in np.flatnonzero(dones):
            info = infos[i]
            self._lengths.append(info["episode"]["l"])
            self._ended[info["kind"]] += 1
            self._fallen[info["kind"]] += bool(info["fell"])

    def write(self, step: int, figures: dict[str, float]) -> float:
        """Write the statistics since the last call; returns environment steps per second."""
        rate = self._steps / max(time.perf_counter() - self._since, 1e-9)
        self.reward = self._reward / max(self._steps, 1)
        record, names = self._logger.record, self._env.reward_names
        record("rollout/reward", self.reward)
        for name, value in zip(names, self._terms / max(self._steps, 1), strict=True):
            record(f"reward/{name}", float(value))
        if self._lengths:
            record("rollout/episode_frames", float(np.mean(self._lengths)))
            record("rollout/fell", sum(self._fallen.values()) / sum(self._ended.values()))
        for kind, ended in self._ended.items():
            record(f"falls/{kind or 'unknown'}", self._fallen[kind] / ended)
        record("rollout/unstable_count", self._env.unstable_count)
        record("time/steps_per_second", rate)
        record("time/total_timesteps", step)
        for name, value in figures.items():
            record(name, value)
        self._logger.dump(step)
        self._begin()
        return rate

    def write_evaluation(self, step: int, followed: Followed) -> None:
        """Write the result of an evaluation on the fixed set."""
        for name, value in evaluation_figures(followed).items():
            self._logger.record(f"evaluation/{name}", value)
        self._logger.record("time/total_timesteps", step)
        self._logger.dump(step)

    def close(self) -> None:
        """Close the files."""
        self._logger.close()


def evaluation_figures(followed: Followed) -> dict[str, float]:
    """Figures of an evaluation: overall, and the share tracked for each kind of motion."""
    figures = {
        "score": followed.score,
        "tracked": followed.tracked,
        "link_error_cm": followed.error_cm,
    }
    for kind in sorted(set(followed.kinds)):
        these = np.array([k == kind for k in followed.kinds])
        figures[f"tracked_{kind or 'unknown'}"] = float(1.0 - followed.fell[these].mean())
    return {name: round(float(value), 4) for name, value in figures.items()}


class Display:
    """A progress bar on a terminal; elsewhere one line per evaluation."""

    def __init__(self) -> None:
        self._console = Console()
        self._bar = Progress(
            TextColumn("[bold]{task.description:8}"),
            BarColumn(bar_width=20),
            TextColumn("{task.fields[text]}"),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._task = self._bar.add_task("", total=1.0, text="")

    def __enter__(self) -> Display:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def update(
        self,
        stage: str,
        progress: float,
        steps: int,
        rate: float,
        left_s: float,
        reward: float,
        tracked: float,
    ) -> None:
        """Redraw: used share of the budget, steps and steps/s, seconds left, clips tracked."""
        text = (
            f"{steps / 1e6:.2f} M steps  {rate / 1e3:.1f} k/s  reward {reward:.3f}  "
            f"tracked {100 * tracked:.0f} %"
        )
        self.show(stage, progress, text, left_s)

    def show(self, stage: str, progress: float, text: str, left_s: float) -> None:
        """Redraw with the given text: used share of the budget, seconds left."""
        left = f"{int(left_s // 60)}:{int(left_s % 60):02d} left" if np.isfinite(left_s) else ""
        self._bar.update(
            self._task, description=stage, completed=min(progress, 1.0), text=f"{text}  {left}"
        )

    def say(self, line: str) -> None:
        """Print a line above the bar."""
        self._console.print(line, highlight=False, soft_wrap=True)
