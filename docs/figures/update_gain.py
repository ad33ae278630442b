"""How much of a PPO update other samples confirm, by the lambda of its advantages.

    python -m docs.figures.update_gain --policy questsim --motions bandai-namco-2:train

The policy plays without learning; its critic learns. Then copies of the policy are updated on some
rollouts, and the gain of each is measured on others: the mean of A(s, a) (mu_new - mu_old)
(a - mu_old) / sigma^2, the first order of the change of the return per step
(Kakade & Langford 2002), in standard deviations of A. A gain on the update's own samples alone is
noise that it has learnt by heart. docs/experiments.md has the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import torch
import tyro
from torch import Tensor

from agents.policy.checkpoint import find_policy, load_policy
from agents.policy.networks import TorquePolicy
from agents.training.make_ppo import make_ppo
from agents.training.ppo import AdaptivePPO, clipped_gain
from agents.training.presets import TRACKING_REWARD, PPOConfig, StageConfig, preset_of
from agents.training.start_from import copy_actor
from envs import QuestVecEnv
from envs.config import EnvConfig
from questsim.motion.spec import load_motions

JUDGE = 0.95
"""Lambda of the advantages that judge an update: nearly the returns, so little of the critic."""
LAST_STEPS = 16
"""Steps at the end of a rollout that do not judge: their advantages are mostly the critic's."""
CLIP = 0.2


@dataclass(frozen=True)
class Args:
    """Measure how much of PPO's updates of a policy other samples confirm."""

    policy: Path = Path("questsim")
    """The policy: a run, a stage or a shipped name."""
    motions: str = "synthetic"
    """Motions to play."""
    lambdas: tuple[float, ...] = (0.0, 0.3, 0.6, 0.9, 0.95)
    """Of the advantages that an update uses."""
    envs: int = 256
    """Simulations."""
    steps: int = 64
    """Steps of each simulation in a rollout."""
    warmup: int = 13
    """Rollouts from which only the critic learns."""
    update_on: int = 5
    """Rollouts of an update."""
    judge_on: int = 8
    """Rollouts that judge it."""
    rate: float = 6e-7
    """Adam's rate in the update; the tracker is a tenth as sensitive, so 6e-6."""
    minibatch: int = 8192
    """Samples of a gradient step."""
    epochs: int = 3
    """Passes over the samples of an update."""
    gamma: float = 0.98
    """Discount per step."""
    threads: int = 1
    """Threads."""
    seed: int = 0
    """Random seed."""


class Rollout(NamedTuple):
    """Steps ``(T, n)`` of all simulations; what the update needs of them."""

    inputs: tuple[Tensor, ...]
    means: Tensor
    actions: Tensor
    advantages: dict[float, Tensor]


class Samples(NamedTuple):
    """Rows of some rollouts, with advantages of one lambda."""

    inputs: tuple[Tensor, ...]
    means: Tensor
    actions: Tensor
    advantages: Tensor


def learner(args: Args) -> AdaptivePPO:
    """PPO that begins with the policy; its critic observes the reference, too."""
    start = load_policy(find_policy(args.policy))
    preset = preset_of("cpu").stages["teacher" if start.needs.privileged else "finetune"]
    spec = replace(start.policy.spec, critic_blocks=preset.policy.critic_blocks)
    assert isinstance(preset.learning, PPOConfig)
    ppo = replace(
        preset.learning,
        rollout_steps=args.steps,
        minibatch=4096,
        gamma=args.gamma,
        gae_lambda=JUDGE,
        noise_legs_and_trunk=0.08,
        noise_arms_and_neck=0.03,
    )
    config = EnvConfig(
        sensors=start.needs.sensors,
        future_frames=start.needs.future_frames,
        privileged=True,
        reward=TRACKING_REWARD,
        sampling="kind",
        max_error_m=0.4,
    )
    env = QuestVecEnv(
        load_motions(args.motions), config, args.envs, args.seed, num_threads=args.threads
    )
    stage = StageConfig(share=1.0, policy=spec, learning=ppo, reward=TRACKING_REWARD)
    made = make_ppo(stage, ppo, env, args.seed, args.threads)
    copy_actor(start.policy, made.policy, args.policy)
    made.actor_frozen = True
    return made


def play(ppo: AdaptivePPO, lambdas: Sequence[float], count: int) -> list[Rollout]:
    """Rollouts after which only the critic learns."""
    kept, buffer = [], ppo.rollout_buffer
    take, last = buffer.compute_advantages, {}

    def remember(values: Tensor) -> None:
        last["values"] = values.clone()
        take(values)

    buffer.compute_advantages = remember  # type: ignore[method-assign]
    for _ in range(count):
        ppo.iterate(lambda *_: True, 0.0)  # type: ignore[arg-type]
        advantages = {}
        for each in lambdas:
            buffer.gae_lambda = each
            take(last["values"])
            advantages[each] = buffer.advantages.clone()
        buffer.gae_lambda = JUDGE
        inputs = ppo.policy.action_inputs(buffer.flat_observations())
        shape = buffer.rewards.shape
        kept.append(
            Rollout(
                tuple(part.detach().clone().unflatten(0, shape) for part in inputs),
                buffer.means.clone(),
                buffer.actions.clone(),
                advantages,
            )
        )
    buffer.compute_advantages = take  # type: ignore[method-assign]
    return kept


def joined(rollouts: Sequence[Rollout], lam: float, without: int = 0) -> Samples:
    """Rows of rollouts, without their last steps; advantages have mean 0 and deviation 1."""
    until = slice(0, len(rollouts[0].means) - without)

    def rows(parts: Sequence[Tensor]) -> Tensor:
        return torch.cat([part[until].flatten(0, 1) for part in parts])

    advantages = torch.cat([each.advantages[lam][until].flatten() for each in rollouts])
    return Samples(
        tuple(rows(parts) for parts in zip(*(each.inputs for each in rollouts), strict=True)),
        rows([each.means for each in rollouts]),
        rows([each.actions for each in rollouts]),
        (advantages - advantages.mean()) / advantages.std(),
    )


def update(policy: TorquePolicy, samples: Samples, args: Args) -> None:
    """PPO's update by Adam, without its limit of the KL divergence."""
    std, parameters = policy.log_std.detach().exp(), policy.actor_parameters()
    adam = torch.optim.Adam(parameters, lr=args.rate, eps=1e-5)
    generator = torch.Generator().manual_seed(args.seed)
    for _ in range(args.epochs):
        order = torch.randperm(len(samples.means), generator=generator)
        for rows in order.split(args.minibatch):
            mean = policy.action_mean_of(*(part[rows] for part in samples.inputs))
            ratio = _log_ratio(mean, samples.means[rows], samples.actions[rows], std).exp()
            adam.zero_grad()
            (-clipped_gain(ratio, samples.advantages[rows], CLIP).mean()).backward()
            torch.nn.utils.clip_grad_norm_(parameters, 0.5)
            adam.step()


def _log_ratio(mean: Tensor, old: Tensor, actions: Tensor, std: Tensor) -> Tensor:
    return 0.5 * (((actions - old) / std).square() - ((actions - mean) / std).square()).sum(1)


@torch.no_grad()
def gain(policy: TorquePolicy, samples: Samples) -> tuple[float, float, float]:
    """KL divergence from the policy that played, the gain and its standard error."""
    std = policy.log_std.exp()
    moved = (policy.action_mean_of(*samples.inputs) - samples.means) / std
    each = (moved * (samples.actions - samples.means) / std).sum(1) * samples.advantages
    error = each.std().item() / len(each) ** 0.5
    return 0.5 * moved.square().sum(1).mean().item(), each.mean().item(), error


def main() -> None:
    """Print the gain of updates with advantages of several lambdas."""
    args = tyro.cli(Args)
    ppo = learner(args)
    play(ppo, (), args.warmup)
    rollouts = play(ppo, sorted({*args.lambdas, JUDGE}), args.update_on + args.judge_on)
    judges = joined(rollouts[args.update_on :], JUDGE, LAST_STEPS)
    before = deepcopy(ppo.policy.state_dict())
    print(f"{'lambda':>7} {'KL':>7} {'own samples':>12} {'other samples':>18}")
    for lam in args.lambdas:
        samples = joined(rollouts[: args.update_on], lam)
        update(ppo.policy, samples, args)
        own, (kl, others, error) = gain(ppo.policy, samples)[1], gain(ppo.policy, judges)
        print(f"{lam:7.2f} {kl:7.4f} {own:+12.4f} {others:+10.4f} ± {error:.4f}")
        ppo.policy.load_state_dict(before)


if __name__ == "__main__":
    main()
