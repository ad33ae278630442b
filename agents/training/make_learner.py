"""Build the environments of a stage and its learner, with a new policy or from an earlier one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from agents.policy.checkpoint import find_policy, find_teacher, load_policy
from agents.policy.networks import TorquePolicy
from agents.policy.policy_agent import PolicyAgent, check_body, new_policy
from agents.policy.spec import Layout
from agents.training.cluster import ActorPool
from agents.training.dagger import Dagger, DaggerConfig
from agents.training.fewer_devices import with_devices
from agents.training.learner import Learner
from agents.training.make_ppo import exploration_noise, make_ppo
from agents.training.ppo import AdaptivePPO
from agents.training.presets import PPOConfig, StageConfig
from agents.training.rollout_worker import BatchSpec
from agents.training.shared_update import LearningPool, make_shared_ppo
from agents.training.specialists import OPTION, Teachers, load_teacher, read_specialist
from agents.training.start_from import copy_actor, copy_head, take_critic
from envs import QuestVecEnv

if TYPE_CHECKING:
    from agents.training.options import TrainArgs


def make_environments(
    batch: BatchSpec, args: TrainArgs, config: StageConfig
) -> QuestVecEnv | ActorPool:
    """The simulations of a stage, in this process or in those of the workers."""
    if args.workers == 0:
        return batch.make()
    shares = args.gradients == "workers" and isinstance(config.learning, PPOConfig)
    return (LearningPool if shares else ActorPool)(batch, args.workers)


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
    learner = _ppo(config, config.learning, env, seed, args.threads)
    if name == "teacher" and args.start is not None:
        folder = find_teacher(args.start)
        start = load_policy(folder)
        check_body(start.name, start.needs.body, env.config.body)
        copy_actor(start.policy, learner.policy, args.start)
        take_critic(folder, learner.policy, config.learning, say)
    if name == "finetune":
        student = args.start or args.out / "student"
        copy_actor(_policy_for(student, env), learner.policy, student)
        noise = exploration_noise(config.learning, env)
        learner.policy.log_std.data.copy_(torch.as_tensor(np.log(noise)))
    return learner


def _ppo(
    config: StageConfig, ppo: PPOConfig, env: QuestVecEnv | ActorPool, seed: int, threads: int
) -> AdaptivePPO:
    if isinstance(env, LearningPool):
        return make_shared_ppo(config, ppo, env, seed, threads)
    return make_ppo(config, ppo, env, seed, threads)


def _student(
    args: TrainArgs,
    config: StageConfig,
    learning: DaggerConfig,
    env: QuestVecEnv | ActorPool,
    seed: int,
    say: Callable[[str], None],
) -> Dagger:
    teacher = load_teacher(args.teacher or args.out / "teacher", env, "--teacher")
    sparse = Layout.of(env.layout).within(config.policy.read_blocks)
    hinges = len(env.avatar.dofs)
    student = new_policy(config.policy, sparse, learning.learning_rate, hinges)
    # With several stages, --start initialises the teacher.
    if args.start is not None and args.stage == "student":
        copy_actor(_policy_for(args.start, env), student, args.start)
    else:
        copy_head(teacher.policy, student)
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


def _policy_for(where: Path, env: QuestVecEnv | ActorPool) -> TorquePolicy:
    """A policy to train further, which fits ``env``."""
    start = load_policy(find_policy(where))
    start = with_devices(start, env.config.sensors, env.config.future_frames)
    start.bind(env)
    return start.policy
