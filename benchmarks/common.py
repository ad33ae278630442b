"""Shared code of the benchmarks: clips, interleaved timing, printing."""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any, NoReturn

import numpy as np

from envs import QuestVecEnv
from questsim.errors import BAD_INPUT
from questsim.motion.clip import Clip
from questsim.motion.synthesis.synthetic import synthetic_clips


class _Parser(argparse.ArgumentParser):
    """One whose errors are one line, as those of the other commands."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"error: {message}; see {self.prog} --help\n")


def arguments(
    description: str, texts: Mapping[str, str] | None = None, **defaults: int
) -> argparse.Namespace:
    """Options of a benchmark: ``--json``, texts and whole numbers with the given defaults."""
    parser = _Parser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    for name, text in (texts or {}).items():
        parser.add_argument(f"--{name}", default=text)
    for name, value in defaults.items():
        parser.add_argument(f"--{name}", type=int, default=value)
    return parser.parse_args()


def clips(count: int = 24) -> list[Clip]:
    """Synthetic clips: no download, identical on every machine."""
    return synthetic_clips()[:count]


def springs(env: QuestVecEnv) -> Callable[[np.ndarray], np.ndarray]:
    """Torques ``(n, 33)`` that hold the joints near zero, so that avatars do not just lie down."""
    gains = 4.0 * env.damping / 0.04 / env.torque_limits
    return lambda obs: (-gains * obs[:, env.layout["joint_angles"]]).astype(np.float32)


def seconds(work: Callable[[], Any]) -> float:
    """Wall time of one call."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def median_rates(
    works: Mapping[str, Callable[[], Any]], steps: Mapping[str, int], repeats: int
) -> dict[str, float]:
    """Median steps/s of each work, run in turn so that a change of clock affects all equally."""
    times: dict[str, list[float]] = {name: [] for name in works}
    for repeat in range(repeats + 1):
        for name, work in works.items():
            elapsed = seconds(work)
            if repeat:  # the first round warms caches and compiles
                times[name].append(elapsed)
    return {name: steps[name] / statistics.median(t) for name, t in times.items()}


def report(figures: Mapping[str, float | int], as_json: bool) -> None:
    """Print figures as JSON or as lines."""
    if as_json:
        print(json.dumps({k: round(float(v), 4) for k, v in figures.items()}))
        return
    width = max(map(len, figures))
    for name, value in figures.items():
        print(f"{name:<{width}}  {value:,.2f}" if value < 100 else f"{name:<{width}}  {value:,.0f}")
