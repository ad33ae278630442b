"""Profile of a training: shares of one iteration of the teacher and of the student.

    python -m benchmarks.train_profile [--json] [--envs 256] [--threads 2] [--iterations 10]

The parts are timed from outside, in a separate run; the rest is `other`.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch

from agents.agent import Needs
from agents.policy.checkpoint import save_policy
from agents.training.make_learner import make_learner
from agents.training.options import TrainArgs
from agents.training.presets import PRESETS
from benchmarks.common import arguments, clips, report, seconds
from envs import EnvConfig, QuestVecEnv

PARTS = {
    "teacher": {
        "physics": ("env.sim._physics", "step"),
        "observe_and_score": ("env.sim", "_after_step"),
        "restart_episodes": ("env", "_end_episodes"),
        "update": ("learner", "_optimise"),
        "values": ("learner", "_estimate_values"),
        "normaliser": ("learner.policy", "update_norm"),
    },
    "student": {
        "physics": ("env.sim._physics", "step"),
        "observe_and_score": ("env.sim", "_after_step"),
        "restart_episodes": ("env", "_end_episodes"),
        "update": ("learner", "_learn"),
    },
}
"""For each stage the timed parts: the object and the name of its method."""


class Clock:
    """Adds up the wall time of methods."""

    def __init__(self) -> None:
        self.spent: defaultdict[str, float] = defaultdict(float)

    def watch(self, part: str, owner: Any, method: str) -> None:
        """Time every call of a method of ``owner`` from now on, as ``part``."""
        call: Callable[..., Any] = getattr(owner, method)

        def timed(*args: Any, **kwargs: Any) -> Any:
            began = time.perf_counter()
            try:
                return call(*args, **kwargs)
            finally:
                self.spent[part] += time.perf_counter() - began

        setattr(owner, method, timed)


def profile(stage: str, args: Any, teacher: Path | None) -> tuple[dict[str, float], Any]:
    """Time shares of the parts of ``stage``'s iterations, its steps/s, and the learner."""
    config = PRESETS["cpu"].stages[stage]
    env_config = EnvConfig(
        reward=config.reward, privileged=True, sampling="failure", max_error_m=config.max_error_m
    )
    env = QuestVecEnv(clips(), env_config, args.envs, 0, args.threads)
    options = TrainArgs(out=Path(), threads=args.threads, teacher=teacher)
    learner = make_learner(stage, options, config, env, 0, print)
    for _ in range(2):  # the first iteration only measures observations, the second compiles
        learner.iterate(lambda *_: None, 0.0)
    clock = Clock()
    for part, (owner, method) in PARTS[stage].items():
        target: Any = {"env": env, "learner": learner}[owner.split(".")[0]]
        for name in owner.split(".")[1:]:
            target = getattr(target, name)
        clock.watch(part, target, method)
    steps = learner.num_timesteps

    def work() -> None:
        for _ in range(args.iterations):
            learner.iterate(lambda *_: None, 0.0)

    whole = seconds(work)
    env.close()
    shares = {part: clock.spent[part] / whole for part in PARTS[stage]}
    shares["other"] = 1.0 - sum(shares.values())
    rate = (learner.num_timesteps - steps) / whole
    return {f"{stage}_{part}": share for part, share in shares.items()} | {
        f"{stage}_steps_per_s": rate
    }, learner


def main() -> None:
    """Measure and print."""
    args = arguments(__doc__ or "", envs=256, threads=2, iterations=10)
    torch.set_num_threads(1)
    figures, teacher = profile("teacher", args, None)
    with TemporaryDirectory() as folder:
        save_policy(Path(folder) / "teacher", teacher.policy, Needs(privileged=True), {})
        student, _ = profile("student", args, Path(folder) / "teacher")
    report({"envs": args.envs, "threads": args.threads} | figures | student, args.json)


if __name__ == "__main__":
    main()
