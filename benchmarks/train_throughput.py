"""PPO steps/s end to end: ours against stable-baselines3's PPO on SubprocVecEnv.

    python -m benchmarks.train_throughput [--json] [--envs 256] [--threads 2]

Same environment, networks (400-300-200), rollout length, minibatch and epochs on both sides. Ours
is the preset `cpu`: actor and critic in parallel, and bfloat16 products.
"""

from __future__ import annotations

from typing import Any

import torch
from stable_baselines3 import PPO
from torch import nn

from agents.policy.networks import TorquePolicy
from agents.policy.spec import Layout, PolicySpec, initial_gains
from agents.training.ppo import AdaptivePPO
from benchmarks.common import arguments, clips, median_rates, report
from benchmarks.env_throughput import forked
from envs import EnvConfig, QuestVecEnv

HIDDEN = (400, 300, 200)


def main() -> None:
    """Measure and print."""
    args = arguments(
        __doc__ or "", envs=256, threads=2, steps=16, minibatch=1024, epochs=4, repeats=3
    )
    motions = clips()
    options = {
        "n_steps": args.steps,
        "batch_size": args.minibatch,
        "n_epochs": args.epochs,
        "seed": 0,
    }
    subproc = forked(motions, args.envs)
    networks = {"net_arch": {"pi": list(HIDDEN), "vf": list(HIDDEN)}, "activation_fn": nn.ELU}
    reference = PPO("MlpPolicy", subproc, device="cpu", policy_kwargs=networks, **options)
    env = QuestVecEnv(motions, EnvConfig(), num_envs=args.envs, num_threads=args.threads)
    ours = _ours(env, args.threads, options)
    rollout = args.envs * args.steps

    def our_rollout_and_update() -> None:
        torch.set_num_threads(1)  # ours splits its work into threads itself
        ours.iterate(lambda *_: None, 0.0)

    def their_rollout_and_update() -> None:
        torch.set_num_threads(args.threads)
        reference.learn(rollout, reset_num_timesteps=False)

    # Our first rollout only fits the normaliser; both warm up in the first round.
    rates = median_rates(
        {"ours": our_rollout_and_update, "sb3_subproc": their_rollout_and_update},
        {"ours": rollout, "sb3_subproc": rollout},
        args.repeats,
    )
    subproc.close()
    report(
        {
            "envs": args.envs,
            "threads": args.threads,
            "ours_steps_per_s": rates["ours"],
            "sb3_subproc_steps_per_s": rates["sb3_subproc"],
            "ratio_to_sb3_subproc": rates["ours"] / rates["sb3_subproc"],
        },
        args.json,
    )


def _ours(env: QuestVecEnv, threads: int, options: dict[str, Any]) -> AdaptivePPO:
    return AdaptivePPO(
        TorquePolicy,
        env,
        bfloat16=True,
        threads=threads,
        policy_kwargs={
            "spec": PolicySpec(hidden=HIDDEN, activation="elu"),
            "layout": Layout.of(env.layout),
            "gains": initial_gains(env.torque_limits, env.damping),
        },
        **options,
    )


if __name__ == "__main__":
    main()
