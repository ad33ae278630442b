"""Training from the command line: stages, budgets, resuming."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch

from agents.agent import Needs
from agents.evaluation.follow import Followed, evaluation_sim, follow, from_first_frames
from agents.overrides import with_overrides
from agents.policy.checkpoint import CARD_FILE, find_policy, read_card
from agents.policy.policy_agent import PolicyAgent
from agents.resolve import from_anywhere
from agents.run_folder import (
    RECORD,
    check_same_run,
    data_record,
    note_resume,
    only_training,
    plain,
    read_run,
    refuse_existing,
    start_run,
)
from agents.training.cluster import ActorPool
from agents.training.dagger import DaggerConfig
from agents.training.fresh_motions import REDRAW_STEPS, FreshMotions, check_share, redrawing
from agents.training.learner import Learner
from agents.training.loggers import check_logger
from agents.training.make_learner import make_environments, make_learner
from agents.training.monitor import Display
from agents.training.options import TrainArgs
from agents.training.ppo import AdaptivePPO
from agents.training.presets import PRESETS, PPOConfig, Preset, StageConfig, shown_estimates
from agents.training.ray_session import ray_cluster, ray_map, ray_runs
from agents.training.rollout_worker import BatchSpec
from agents.training.shared_update import LearningPool, announce
from agents.training.specialists import needs_of_teachers, read_specialist
from agents.training.stage import Budget, Stage, Stopper
from agents.training.start_estimates import start_estimates
from agents.training.training_clips import (
    Pairs,
    estimate_pairs,
    load_clips,
    split_validation,
    validation_clips,
)
from agents.training.watched import watched
from envs.config import EnvConfig
from envs.objects import objects_named
from envs.pushes import Pushes
from envs.randomisation import Randomisation
from envs.starts import Starts
from envs.terrain import terrain_named
from questsim.bodies import OwnBody, read_body
from questsim.errors import INTERRUPTED, InputError, at_least
from questsim.motion.clip import Clip

_PAUSE_S = (1.0, 4.0)
"""Seconds between pushes: long enough to recover from one before the next."""
MAY_DIFFER_ON_RESUME = {
    "motions",  # compared by the hash of their contents
    "minutes",
    "steps",
    "resume",
    "stage",
    "threads",
    "workers",
    "ray",
    "gradients",
    "log",
    "out",
    "teacher",
    "specialists",
    "set",
    "start",
}


def train(args: TrainArgs) -> int:
    """See ``train_here``; with ``--workers`` in a process of its own."""
    at_least(0, workers=args.workers)  # before that process starts
    _refuse_unused(args)
    if args.workers and not ray_runs():
        return watched(train_here, args)
    return train_here(args)


def train_here(args: TrainArgs) -> int:
    """Run a training; returns the exit code.

    Raises:
        InputError: for options, motions or a run folder that cannot be used.
    """
    args = replace(
        args,
        teacher=from_anywhere(args.teacher),
        start=from_anywhere(args.start),
        specialists=tuple(str(read_specialist(text)) for text in args.specialists),
    )
    check_logger(args.log)
    at_least(1, threads=args.threads, envs=args.envs, steps=args.steps, redraw=args.redraw)
    at_least(0, minutes=args.minutes, seed=args.seed)
    preset = with_overrides(PRESETS[args.preset], args.set)
    names = _stage_names(args, preset)
    if args.resume:
        read_run(args.out)
    else:
        refuse_existing(args.out)
    clips = load_clips(args)
    check_share(args.vary, args.redraw, clips)
    shown, begin_at = estimate_pairs(args, clips), start_estimates(args, clips)
    if shown is None:
        data = data_record(args.motions, clips)
    else:
        clips = [truth for truth, _ in shown.values()]
        data = data_record(args.motions, [seen for _, seen in shown.values()])
    if args.resume:
        check_same_run(read_run(args.out), args, data, MAY_DIFFER_ON_RESUME, args.out)

    def begin() -> None:
        # Written only now: refused options or motions must not leave a run behind.
        if not (args.out / RECORD).exists():
            start_run(args.out, args, preset, data, shipped_behind(args))
        elif not noted:
            note_resume(args.out, args, preset, shipped_behind(args))
        noted.append(True)

    noted: list[bool] = []

    training = _Training(args, preset, clips, shown, begin_at, data)
    torch.set_num_threads(1)  # the learners use their own workers; see workers.py
    stopper = Stopper()
    folder, cluster = only_training(args.out), _cluster(args)
    with folder, cluster, Display() as display, stopper.listening():
        display.say(f"preset {args.preset}: {preset.expect}")
        for name in names:
            _run_stage(training, name, display, stopper, begin)
            if stopper.requested:
                display.say(f"stopped; go on with --resume --out {args.out}")
                return INTERRUPTED
        display.say(_outcome(args))
    return 0


def _refuse_unused(args: TrainArgs) -> None:
    """Refuse other policies that no stage of the training uses.

    Raises:
        InputError: naming the option.
    """
    names = _stage_names(args, PRESETS[args.preset])
    given = {"teacher": args.teacher, "start": args.start, "specialists": args.specialists}
    users = {
        "teacher": {"student"},
        "specialists": {"student"},
        "start": {"teacher", "student", "finetune"},
    }
    for option, value in given.items():
        if value and not users[option] & set(names):
            stage = f"--stage {args.stage}" if args.stage != "all" else f"--preset {args.preset}"
            raise InputError(f"does not go with {stage}", f"--{option}", "leave it out")
    learning = [PRESETS[args.preset].stages[name].learning for name in names]
    if args.gradients == "workers" and not args.workers:
        raise InputError("needs --workers", "--gradients workers", "add --workers N")
    if args.gradients == "workers" and not any(isinstance(each, PPOConfig) for each in learning):
        fix = "leave it out: DAgger has one learner, whose work does not grow with the avatars"
        raise InputError("none of the stages learns by PPO", "--gradients workers", fix)
    if args.teacher and "teacher" in names:
        what = "does not go with --stage all, whose student learns from the teacher trained before"
        raise InputError(what, "--teacher", "add --stage student")
    if args.specialists and args.workers:
        raise InputError("does not go with --workers", "--specialists", "leave one out")


def shipped_behind(args: TrainArgs) -> dict[str, Any]:
    """Training records of the shipped policies from which a training starts or learns.

    Keys are ``start``, ``teacher``, and the text of each specialist.
    """
    named = {"start": args.start, "teacher": args.teacher}
    named |= {text: read_specialist(text).where for text in args.specialists}
    found = {option: find_policy(name) for option, name in named.items() if name is not None}
    cards = {option: read_card(folder).get("training", {}) for option, folder in found.items()}
    # A run folder has its own record.
    return {option: training for option, training in cards.items() if "stages" in training}


def _cluster(args: TrainArgs) -> AbstractContextManager[None]:
    """The Ray cluster of ``--workers``, if any."""
    at_least(0, workers=args.workers)
    if args.workers:
        return ray_cluster(args.ray, args.workers * args.threads)
    if args.ray is not None:
        raise InputError("needs --workers", "--ray", "add --workers N")
    return nullcontext()


def _outcome(args: TrainArgs) -> str:
    """Where the policy is, if the training saved one, and how to score and watch it.

    A tracker of estimates is scored on the estimates, which are the motions that it observes.
    """
    out, motions = args.out, "synthetic" if args.estimates is None else args.estimates
    try:
        return (
            f"trained: {find_policy(out)}\n"
            f"score it: questsim evaluate --agent {out} --motions {motions} --out {out}/scores\n"
            f"watch it: questsim play {out}"
        )
    except InputError:  # fine-tuning saves only a policy better than its start
        return f"no better than its start yet; go on with --resume --out {out}"


def _stage_names(args: TrainArgs, preset: Preset) -> list[str]:
    if args.stage == "all":
        return [name for name, stage in preset.stages.items() if stage.share > 0]
    if args.stage not in preset.stages:
        raise InputError(
            f"preset {args.preset} has no stage {args.stage!r}",
            "--stage",
            f"it has {', '.join(preset.stages)}",
        )
    return [args.stage]


@dataclass(frozen=True)
class _Training:
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
        if self.shown is not None:
            config = shown_estimates(name, config)
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


def _run_stage(
    training: _Training,
    name: str,
    display: Display,
    stopper: Stopper,
    begin: Callable[[], None],
) -> None:
    args, preset, config = training.args, training.preset, training.config(name)
    env_config, seed = _env_config(args, preset, config), training.seed(name)
    learnt, validation = training.split()
    torch.manual_seed(seed)
    fresh = FreshMotions(learnt, args.vary, args.redraw or REDRAW_STEPS, seed)
    draw = fresh.last(args.out / name / "last") if args.resume else 0
    with ray_map(args.workers if args.vary else 0, args.ray if args.vary else None) as mapper:
        clips, shown = fresh.at(draw, mapper), training.seen(learnt)
    count = preset.num_envs if args.envs is None else args.envs
    batch = BatchSpec(
        clips, env_config, count, seed + draw, args.threads, shown, training.begin_at
    )  # fmt: skip
    env = make_environments(batch, args, config)
    first = from_first_frames(env_config)
    sim = evaluation_sim(validation, first, args.threads, shown=training.seen(validation))

    def validate(agent: PolicyAgent) -> Followed:
        agent.bind(sim)
        return follow(agent, sim, validation)

    record = {"preset": args.preset, "seed": args.seed, "threads": args.threads, **training.data}
    try:
        learner = make_learner(name, args, config, env, seed, display.say)
        if isinstance(env, LearningPool) and isinstance(config.learning, PPOConfig):
            display.say(announce(config.learning, env))
        stage = Stage(
            name=name,
            learner=learner,
            env=env,
            needs=training.needs(config, env_config.body),
            folder=args.out / name,
            budget=_budget(name, args, preset),
            validate=validate,
            evaluate_every=config.evaluate_every,
            record=record,
            must_improve=name == "finetune",
            before_iteration=_schedule(config, learner),
            log=args.log,
            settings=plain(config),
            keep=config.keep_checkpoints,
        )
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


def _env_config(args: TrainArgs, preset: Preset, config: StageConfig) -> EnvConfig:
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


def _budget(name: str, args: TrainArgs, preset: Preset) -> Budget:
    config = preset.stages[name]
    minutes = preset.minutes if args.minutes is None else args.minutes
    if args.steps is not None and args.minutes is None:
        minutes = None
    share = 1.0 if args.stage != "all" else config.share
    seconds = None if minutes is None else 60.0 * minutes * share
    return Budget(seconds, config.steps if args.steps is None else args.steps)


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
