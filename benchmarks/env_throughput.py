"""Environment steps/s of the VecEnv against bare physics and against SubprocVecEnv.

    python -m benchmarks.env_throughput [--json] [--envs 256] [--threads 2]

The bare batch has the same models and substeps. It makes each step from the VecEnv's state and with
the same torques, so that both compute the same contacts. Figures are medians of single steps.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import mujoco
import numpy as np
from mujoco import batch as mujoco_batch
from stable_baselines3.common.vec_env import SubprocVecEnv

from benchmarks.common import arguments, clips, report, springs
from envs import EnvConfig, QuestEnv, QuestVecEnv
from questsim.motion.clip import Clip

_CURRENT = int(mujoco.mjtStage.mjSTAGE_VEL.value)


def main() -> None:
    """Measure and print."""
    args = arguments(__doc__ or "", envs=256, threads=2, steps=200, subproc_steps=20)
    motions = clips()
    env = QuestVecEnv(motions, EnvConfig(), num_envs=args.envs, num_threads=args.threads)
    act = springs(env)
    vecenv, bare = side_by_side(env, act, args.steps)
    subproc = forked(motions, args.envs)
    obs = np.asarray(subproc.reset())
    times = []
    for _ in range(args.subproc_steps):
        action = act(obs)
        began = time.perf_counter()
        stepped = subproc.step(action)
        times.append(time.perf_counter() - began)
        obs = np.asarray(stepped[0])
    subproc.close()
    one = statistics.median(times)
    report(
        {
            "envs": args.envs,
            "threads": args.threads,
            "vecenv_steps_per_s": args.envs / vecenv,
            "bare_steps_per_s": args.envs / bare,
            "subproc_steps_per_s": args.envs / one,
            "ratio_to_bare": bare / vecenv,
            "ratio_to_subproc": one / vecenv,
        },
        args.json,
    )


def side_by_side(
    env: QuestVecEnv, act: Callable[[np.ndarray], np.ndarray], steps: int
) -> tuple[float, float]:
    """Median seconds of a step of the VecEnv, and of bare physics from the same states."""
    bare = mujoco_batch.Batch(
        env.sim.batch.model, env.num_envs, nthread=env.sim.batch.nthread, persistent=True
    )
    bare.set_models(list(env.sim.batch.models or []))
    torques = bare.bind("ctrl")
    times: dict[str, list[float]] = {"vecenv": [], "bare": []}
    obs = env.reset()
    for step in range(steps + 20):
        action = act(obs)
        bare.state[:] = env.sim.batch.state
        np.clip(action, -1.0, 1.0, out=torques)
        torques *= env.sim.torque_limits
        bare.forward(stage=_CURRENT)
        began = time.perf_counter()
        bare.step(nstep=env.sim.substeps, stage=_CURRENT)
        between = time.perf_counter()
        obs, _, _, _ = env.step(action)
        ended = time.perf_counter()
        if step >= 20:  # the first steps warm caches and compile
            times["bare"].append(between - began)
            times["vecenv"].append(ended - between)
    return statistics.median(times["vecenv"]), statistics.median(times["bare"])


def forked(motions: list[Clip], count: int) -> SubprocVecEnv:
    """A SubprocVecEnv of single environments, each in its own process."""

    def single() -> QuestEnv:
        return QuestEnv(motions, EnvConfig())

    warm = single()  # loops compiled before the fork are compiled once, not 256 times
    warm.reset()
    warm.step(warm.action_space.sample())
    return SubprocVecEnv([single] * count, start_method="fork")


if __name__ == "__main__":
    main()
