"""Environment steps/s of the VecEnv against bare physics and against SubprocVecEnv.

    python -m benchmarks.env_throughput [--json] [--envs 256] [--threads 2]

The bare batch has the same models and substeps and starts each round from the states the VecEnv
is in, so that both step the same contacts.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from mujoco import batch as mujoco_batch
from stable_baselines3.common.vec_env import SubprocVecEnv

from benchmarks.common import arguments, clips, median_rates, report, springs
from envs import EnvConfig, QuestEnv, QuestVecEnv
from questsim.motion.clip import Clip

_CURRENT = int(mujoco.mjtStage.mjSTAGE_VEL.value)


def main() -> None:
    """Measure and print."""
    args = arguments(__doc__ or "", envs=256, threads=2, steps=40, repeats=5)
    motions = clips()
    env = QuestVecEnv(motions, EnvConfig(), num_envs=args.envs, num_threads=args.threads)
    act = springs(env)
    obs = env.reset()
    bare = mujoco_batch.Batch(env.sim.batch.model, args.envs, nthread=args.threads, persistent=True)
    bare.set_models(list(env.sim.batch.models or []))
    action = act(obs)

    def step_env() -> None:
        nonlocal action
        for _ in range(args.steps):
            obs, _, _, _ = env.step(action)
            action = act(obs)

    def step_bare() -> None:
        bare.state[:] = env.sim.batch.state
        bare.forward(stage=_CURRENT)
        for _ in range(args.steps):
            bare.step(nstep=env.sim.substeps, stage=_CURRENT)

    subproc = SubprocVecEnv([single_env(motions) for _ in range(args.envs)], start_method="fork")
    state = {"obs": subproc.reset()}

    def step_subproc() -> None:
        for _ in range(max(args.steps // 10, 1)):
            state["obs"] = subproc.step(act(np.asarray(state["obs"])))[0]

    rates = median_rates(
        {"vecenv": step_env, "bare": step_bare, "subproc": step_subproc},
        {
            "vecenv": args.steps * args.envs,
            "bare": args.steps * args.envs,
            "subproc": max(args.steps // 10, 1) * args.envs,
        },
        args.repeats,
    )
    subproc.close()
    report(
        {
            "envs": args.envs,
            "threads": args.threads,
            "vecenv_steps_per_s": rates["vecenv"],
            "bare_steps_per_s": rates["bare"],
            "subproc_steps_per_s": rates["subproc"],
            "ratio_to_bare": rates["vecenv"] / rates["bare"],
            "ratio_to_subproc": rates["vecenv"] / rates["subproc"],
        },
        args.json,
    )


def single_env(motions: list[Clip]) -> Callable[[], QuestEnv]:
    """A maker of one environment, as SubprocVecEnv wants it."""
    return lambda: QuestEnv(motions, EnvConfig())


if __name__ == "__main__":
    main()
