"""Build the learner of a stage, with a new policy or from an earlier one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from agents.policy.balance import OUTPUTS
from agents.policy.checkpoint import find_policy, find_teacher, load_critic, load_policy
from agents.policy.networks import TorquePolicy
from agents.policy.policy_agent import PolicyAgent, check_body, new_policy
from agents.policy.spec import Layout, noise_by_joint
from agents.policy.stepping import start_gains
from agents.training.dagger import Dagger, DaggerConfig
from agents.training.learner import Learner
from agents.training.ppo import AdaptivePPO
from agents.training.presets import PPOConfig, StageConfig
from agents.training.specialists import OPTION, Teachers, load_teacher, read_specialist
from envs import QuestVecEnv
from questsim.bodies import OwnBody
from questsim.errors import InputError
from questsim.skeleton import NUM_DOFS

if TYPE_CHECKING:
    from agents.training.cluster import ActorPool
    from agents.training.options import TrainArgs


def make_learner(
    name: str,
    args: TrainArgs,
    config: StageConfig,
    env: QuestVecEnv | ActorPool,
    seed: int,
    say: Callable[[str], None],
) -> Learner:
    """The learner of a stage, before its first step.

    Args:
        name: name of the stage.
        args: options of the training; they say where to find teacher, student and start.
        config: the stage's preset.
        env: the training environment.
        seed: seed of all its random numbers.
        say: is called with lines for the user.

    Raises:
        InputError: a policy that it builds on is missing or does not fit.
    """
    if isinstance(config.learning, DaggerConfig):
        return _student(args, config, config.learning, env, seed, say)
    learner = make_ppo(config, config.learning, env, seed, args.threads)
    if name == "teacher" and args.start is not None:
        _begin_with(learner.policy, args.start, env.config.body)
    if name == "finetune":
        start = args.start or args.out / "student"
        copy_actor(_starting_policy(start, env), learner.policy, start)
        noise = _noise(config.learning, env)
        learner.policy.log_std.data.copy_(torch.as_tensor(np.log(noise)))
    return learner


def _noise(ppo: PPOConfig, env: QuestVecEnv | ActorPool) -> np.ndarray:
    """Standard deviation of the exploration noise of each hinge."""
    strong = env.avatar.strong
    return noise_by_joint(strong, ppo.noise_legs_and_trunk, ppo.noise_arms_and_neck)


def make_ppo(
    config: StageConfig, ppo: PPOConfig, env: QuestVecEnv | ActorPool, seed: int, threads: int = 1
) -> AdaptivePPO:
    """PPO with a new policy for ``env``."""
    noise = _noise(ppo, env)
    return AdaptivePPO(
        TorquePolicy,
        env,
        desired_kl=ppo.desired_kl,
        final_kl=ppo.final_kl,
        reward_scale=ppo.reward_scale,
        bfloat16=ppo.bfloat16,
        threads=threads,
        learning_rate=ppo.learning_rate,
        n_steps=ppo.rollout_steps,
        batch_size=min(ppo.minibatch, ppo.rollout_steps * env.num_envs),
        n_epochs=ppo.epochs,
        gamma=ppo.gamma,
        gae_lambda=ppo.gae_lambda,
        clip_range=ppo.clip,
        vf_coef=1.0,
        max_grad_norm=ppo.max_grad_norm,
        seed=seed,
        policy_kwargs={
            "spec": config.policy,
            "layout": Layout.of(env.layout),
            "gains": start_gains(config.policy.balance, env.torque_limits, env.damping),
            "noise": noise,
            "learn_noise": ppo.learn_noise,
            "critic_learning_rate": ppo.critic_learning_rate,
        },
    )


def _student(
    args: TrainArgs,
    config: StageConfig,
    learning: DaggerConfig,
    env: QuestVecEnv | ActorPool,
    seed: int,
    say: Callable[[str], None],
) -> Dagger:
    teacher = load_teacher(args.teacher or args.out / "teacher", env, "--teacher")
    sparse = Layout.of(env.layout).within(config.policy.actor_blocks)
    hinges = len(env.avatar.dofs)
    student = new_policy(config.policy, sparse, learning.learning_rate, hinges)
    # With several stages, --start initialises the teacher.
    if args.start is not None and args.stage == "student":
        copy_actor(_starting_policy(args.start, env), student, args.start)
    elif student.head is not None and teacher.policy.head is not None:
        # The student starts from the stiffness that the teacher learnt.
        learnt = teacher.policy.head.state_dict()
        if teacher.policy.spec.balance == "steps":  # other laws, other bounds of the gains
            learnt = {"log_gain": learnt["log_gain"]}
        student.head.load_state_dict(learnt, strict=False)
    student.log_std.data.copy_(teacher.policy.log_std.data)
    labels = _specialists(args, teacher, env, say)
    return Dagger(env, teacher, student, learning, seed, args.threads, labels)


def _specialists(
    args: TrainArgs,
    general: PolicyAgent,
    env: QuestVecEnv | ActorPool,
    say: Callable[[str], None],
) -> Teachers | None:
    if not args.specialists:
        return None
    assert isinstance(env, QuestVecEnv)  # with --workers they are refused before
    read = [read_specialist(text) for text in args.specialists]
    agents = [(load_teacher(s.where, env, OPTION), s.kinds) for s in read]
    teachers = Teachers(general, agents, env, args.threads)
    names = ["the general teacher", *(str(specialist.where) for specialist in read)]
    counts = zip(teachers.clips_of_each(), names, strict=True)
    say("teachers: " + ", ".join(f"{name} of {count} clips" for count, name in counts))
    return teachers


def _starting_policy(where: Path, env: QuestVecEnv | ActorPool) -> TorquePolicy:
    """A policy to train further, which fits ``env``."""
    start = load_policy(find_policy(where))
    start.bind(env)
    return start.policy


def _begin_with(policy: TorquePolicy, teacher: Path, body: OwnBody | None) -> None:
    """Copy the networks, critic included, and normalisers of another teacher.

    A policy that imitated teachers has no critic: the new one stays, and learns first
    (``critic_warmup_steps``).

    Raises:
        InputError: there is no such teacher, or its networks differ.
    """
    folder = find_teacher(teacher)
    loaded = load_policy(folder)
    check_body(loaded.name, loaded.needs.body, body)
    copy_actor(loaded.policy, policy, teacher)
    if loaded.card.get("training", {}).get("stage") != "student":
        load_critic(folder, policy)


def copy_actor(source: TorquePolicy, target: TorquePolicy, where: Path) -> None:
    """Copy the networks, normaliser and gains of ``source``, without critic, to ``target``.

    Args:
        source, target: policies.
        where: origin of the source, for messages.

    Raises:
        InputError: if their networks differ.
    """
    state = {k: v for k, v in source.state_dict().items() if not k.startswith("critic.")}
    fresh = ["critic."]
    if (source.spec.balance, target.spec.balance) == ("feet", "placement"):
        fresh.append("head.balance.placement.")
        _widen(state, target)
    elif source.spec.balance != target.spec.balance:  # its gains keep their start values
        fresh.append("head.balance.")
        state = {k: v for k, v in state.items() if not k.startswith("head.balance.")}
        _widen(state, target)
    try:
        missing, unexpected = target.load_state_dict(state, strict=False)
        fits = not unexpected and all(name.startswith(tuple(fresh)) for name in missing)
    except RuntimeError:  # the shapes differ
        fits = False
    if not fits:
        raise InputError("its networks do not fit this preset's", where, "see --start")


def _widen(state: dict[str, Tensor], target: TorquePolicy) -> None:
    """Extend an actor by the outputs for the target's balance that it lacks, with zeros."""
    outputs = NUM_DOFS + OUTPUTS.get(target.spec.balance, 0)
    last = f"actor.layers.{len(target.actor.layers) - 1}."
    for name in (last + "weight", last + "bias"):
        if name in state and len(state[name]) < outputs:
            rows = state[name].new_zeros(outputs - len(state[name]), *state[name].shape[1:])
            state[name] = torch.cat([state[name], rows])
