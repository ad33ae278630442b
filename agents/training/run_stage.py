"""One stage of a training: its clips, environment, learner, budget and validation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch

from agents.agent import Needs
from agents.evaluation.follow import Followed, evaluation_sim, follow, from_first_frames
from agents.policy.checkpoint import CARD_FILE
from agents.policy.policy_agent import PolicyAgent
from agents.run_folder import plain
from agents.training.cluster import ActorPool
from agents.training.dagger import DaggerConfig
from agents.training.fresh_motions import REDRAW_STEPS, FreshMotions, redrawing
from agents.training.learner import Learner
from agents.training.make_learner import make_environments, make_learner
from agents.training.monitor import Display
from agents.training.options import TrainArgs
from agents.training.ppo import AdaptivePPO
from agents.training.presets import PPOConfig, Preset, StageConfig
from agents.training.ray_session import ray_map
from agents.training.rollout_worker import BatchSpec
from agents.training.shared_update import LearningPool, announce
from agents.training.specialists import needs_of_teachers
from agents.training.stage import Budget, Stage, Stopper
from agents.training.training_clips import Pairs, split_validation, validation_clips
from envs.config import EnvConfig
from envs.objects import objects_named
from envs.pushes import Pushes
from envs.randomisation import Randomisation
from envs.sb3 import QuestVecEnv
from envs.starts import Starts
from envs.terrain import terrain_named
from questsim.bodies import OwnBody, read_body
from questsim.motion.clip import Clip

_PAUSE_S = (1.0, 4.0)
"""Seconds between pushes: long enough to recover from one before the next."""


@dataclass(frozen=True)
class Training:
    """What the stages of a training share.

    Attributes:
        args, preset: its options.
        clips: the motions.
        shown: pairs of a motion and its estimate by name, with ``--shown``.
        begin_at: estimates of first states by name, see ``BatchSim``.
        data: record of the motions.
    """

    args: TrainArgs
    preset: Preset
    clips: Sequence[Clip]
    shown: Pairs | None
    begin_at: dict[str, Clip] | None
    data: dict[str, Any]

    def config(self, name: str) -> StageConfig:
        """A stage's configuration."""
        config = self.preset.stages[name]
        if self.args.body is not None:  # the balance term is of our own legs
            config = replace(config, policy=replace(config.policy, balance="none"))
        return config

    def seed(self, name: str) -> int:
        """Each stage has its own random stream, whether it runs alone or after another."""
        return self.args.seed + 1000 * list(self.preset.stages).index(name)

    def split(self) -> tuple[list[Clip], list[Clip]]:
        """Clips to learn and clips for validation."""
        args, count = self.args, self.preset.validation_clips
        learnt, validation = split_validation(self.clips, args.hold_out, count)
        if args.validation is not None:
            validation = validation_clips(args, count)
        return learnt, validation

    def seen(self, part: Sequence[Clip]) -> list[Clip] | None:
        """The estimates of some clips, if there are any."""
        return None if self.shown is None else [self.shown[clip.name][1] for clip in part]

    def needs(self, config: StageConfig, body: OwnBody | None) -> Needs:
        """What a stage's policy observes."""
        return Needs(
            sensors=self.args.sensors,
            future_frames=self.args.future_frames,
            privileged="privileged" in config.policy.actor_blocks,
            body_preset=self.preset.body_preset,
            body=body,
            observe_proportions=self.args.observe_proportions,
        )

    def env_config(self, config: StageConfig) -> EnvConfig:
        """The environment of a stage; its observation suits the student and its teachers."""
        args, preset = self.args, self.preset
        teachers = needs_of_teachers(args) if isinstance(config.learning, DaggerConfig) else []
        blocks = config.policy.actor_blocks + config.policy.critic_blocks
        own = args.sensors, args.future_frames
        devices = [(t.sensors, t.future_frames) for t in teachers if not t.privileged]
        return EnvConfig(
            sensors=args.sensors,
            future_frames=args.future_frames,
            heights=args.heights,
            body_preset=preset.body_preset,
            reward=config.reward,
            privileged="privileged" in blocks or any(t.privileged for t in teachers),
            sampling="kind" if args.vary and config.sampling == "failure" else config.sampling,
            max_error_m=config.max_error_m,
            terrain=None if args.env is None else terrain_named(args.env, "--env"),
            pushes=None if args.pushes is None else Pushes(args.pushes, pause_s=_PAUSE_S),
            objects=objects_named(args.objects, "--objects"),
            randomisation=None if args.randomisation == Randomisation() else args.randomisation,
            starts=None if args.starts == Starts() else args.starts,
            body=None if args.body is None else read_body(args.body),
            proportions=args.proportions,
            observe_proportions=args.observe_proportions,
            teacher_devices=next((found for found in devices if found != own), None),
        )

    def budget(self, name: str) -> Budget:
        """The given time or steps; else the stage's share of the preset's time."""
        args, preset, config = self.args, self.preset, self.preset.stages[name]
        minutes = preset.minutes if args.minutes is None else args.minutes
        if args.steps is not None and args.minutes is None:
            minutes = None
        share = 1.0 if args.stage != "all" else config.share
        seconds = None if minutes is None else 60.0 * minutes * share
        return Budget(seconds, config.steps if args.steps is None else args.steps)

    def stage(
        self,
        name: str,
        learner: Learner,
        env: QuestVecEnv | ActorPool,
        body: OwnBody | None,
        validate: Callable[[PolicyAgent], Followed],
    ) -> Stage:
        """The loop of a stage that learns in ``env`` and keeps the policy that validates best."""
        args, config = self.args, self.config(name)
        return Stage(
            name=name,
            learner=learner,
            env=env,
            needs=self.needs(config, body),
            folder=args.out / name,
            budget=self.budget(name),
            validate=validate,
            evaluate_every=config.evaluate_every,
            record={
                "preset": args.preset, "seed": args.seed, "threads": args.threads, **self.data
            },
            must_improve=name == "finetune",
            before_iteration=_schedule(config, learner),
            log=args.log,
            settings=plain(config),
            keep=config.keep_checkpoints,
        )  # fmt: skip


def run_stage(
    training: Training,
    name: str,
    display: Display,
    stopper: Stopper,
    begin: Callable[[], None],
) -> None:
    """Train one stage until its budget is spent or the user stops it.

    Args:
        training: what the stages share.
        name: the stage, as in the preset.
        display: shows the progress.
        stopper: says when the user wants to stop.
        begin: called when all options and motions have been accepted, before the first step.

    Raises:
        InputError: options or motions do not go with this stage.
    """
    args, config = training.args, training.config(name)
    env_config, seed = training.env_config(config), training.seed(name)
    learnt, validation = training.split()
    torch.manual_seed(seed)
    fresh = FreshMotions(learnt, args.vary, args.redraw or REDRAW_STEPS, seed)
    draw = fresh.last(args.out / name / "last") if args.resume else 0
    batch = _batch(training, env_config, fresh, draw, training.seen(learnt))
    env = make_environments(batch, args, config)
    first = from_first_frames(env_config)
    sim = evaluation_sim(validation, first, args.threads, shown=training.seen(validation))

    def validate(agent: PolicyAgent) -> Followed:
        agent.bind(sim)
        return follow(agent, sim, validation)

    try:
        learner = make_learner(name, args, config, env, seed, display.say)
        if isinstance(env, LearningPool) and isinstance(config.learning, PPOConfig):
            display.say(announce(config.learning, env))
        stage = training.stage(name, learner, env, env_config.body, validate)
        if args.vary:
            mapper = env.map if isinstance(env, ActorPool) else map
            redraw = redrawing(fresh, env, learner, draw, stage.beside, mapper)
            stage.before_iteration = _both(stage.before_iteration, redraw)
        resumes = args.resume and (stage.folder / "last" / CARD_FILE).exists()
        if resumes and (notice := stage.resume()) is not None:
            display.say(notice)
        begin()
        stage.run(display, stopper)
    finally:
        sim.close()
        env.close()


def _batch(
    training: Training,
    config: EnvConfig,
    fresh: FreshMotions,
    draw: int,
    shown: list[Clip] | None,
) -> BatchSpec:
    """The simulations of a stage, with the clips of the given draw of variations."""
    args = training.args
    with ray_map(args.workers if args.vary else 0, args.ray if args.vary else None) as mapper:
        clips = fresh.at(draw, mapper)
    count = training.preset.num_envs if args.envs is None else args.envs
    seed = fresh.seed + draw
    return BatchSpec(clips, config, count, seed, args.threads, shown, training.begin_at)


def _both(first: Callable[[int], None] | None, second: Callable[[int], None]) -> Any:
    """Call both functions in order, before an iteration."""

    def call(steps: int) -> None:
        if first is not None:
            first(steps)
        second(steps)

    return call


def _schedule(config: StageConfig, learner: Learner) -> Any:
    """Keeps the actor fixed while a new critic is trained."""
    if not isinstance(learner, AdaptivePPO) or not isinstance(config.learning, PPOConfig):
        return None
    warmup = config.learning.critic_warmup_steps

    def freeze(ppo: AdaptivePPO, steps: int) -> None:
        ppo.actor_frozen = steps < warmup

    return partial(freeze, learner) if warmup else None
