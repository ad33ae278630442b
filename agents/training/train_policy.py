"""Training of torque policies from the command line: options, record, stages, resuming."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any

import torch

from agents.overrides import refuse_repeated, with_overrides
from agents.policy.checkpoint import find_policy, read_card
from agents.resolve import from_anywhere
from agents.run_folder import (
    RunRecord,
    check_same_run,
    data_record,
    only_training,
    read_run,
    refuse_existing,
)
from agents.training.fresh_motions import check_share
from agents.training.loggers import check_logger
from agents.training.memory import memory_bytes, memory_warning
from agents.training.monitor import Display
from agents.training.options import TrainArgs
from agents.training.presets import PRESETS, PPOConfig, Preset, preset_of
from agents.training.ray_session import ray_cluster
from agents.training.run_stage import Training, run_stage
from agents.training.specialists import check_kinds, check_teachers, read_specialist
from agents.training.stage import Stopper
from agents.training.start_estimates import start_estimates
from agents.training.start_from import with_networks_of_start
from agents.training.training_clips import estimate_pairs, load_clips
from agents.training.watched import beside_ray
from questsim.errors import INTERRUPTED, InputError, at_least, usable_seed

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
    """Run a training; returns the exit code.

    Raises:
        InputError: for options, motions or a run folder that cannot be used.
    """
    at_least(0, workers=args.workers)  # before another process starts
    _refuse_unused(args)
    return train_here(args)


@beside_ray
def train_here(args: TrainArgs) -> int:
    """See ``train``.

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
    at_least(0, minutes=args.minutes)
    usable_seed(args.seed)
    refuse_repeated(args.set)
    preset = with_overrides(preset_of(args.preset, args.estimates is not None), args.set)
    names = _stage_names(args, preset)
    if args.resume:
        read_run(args.out)
    else:
        refuse_existing(args.out)
    check_teachers(args, names)
    preset = with_networks_of_start(preset, args, names)
    clips = load_clips(args)
    check_share(args.vary, args.redraw, clips)
    if not args.vary:  # patterns may be for variations alone
        check_kinds([read_specialist(text).kinds for text in args.specialists], clips)
    shown = estimate_pairs(args, clips)
    begin_at = start_estimates(args, clips, shown)
    if shown is None:
        data = data_record(args.motions, clips)
    else:
        clips = [truth for truth, _ in shown.values()]
        data = data_record(args.motions, [seen for _, seen in shown.values()])
    if args.resume:
        check_same_run(read_run(args.out), args, data, MAY_DIFFER_ON_RESUME, args.out)

    training = Training(args, preset, clips, shown, begin_at, data)
    record = RunRecord(args.out, args, preset, data, lambda: shipped_behind(args))
    torch.set_num_threads(1)  # the learners use their own workers; see workers.py
    stopper = Stopper()
    folder, cluster = only_training(args.out), _cluster(args)
    with folder, cluster, Display() as display, stopper.listening():
        display.say(f"preset {args.preset}: {preset.expect}")
        frames, processes = sum(len(clip) for clip in clips), 1 + args.workers
        if warning := memory_warning(frames, args.vary, processes, memory_bytes()):
            display.say(warning)
        for name in names:
            run_stage(training, name, display, stopper, record.begin)
            if stopper.requested:
                display.say(f"stopped; continue with --resume --out {args.out}")
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
    if args.pushes is not None and not any(args.pushes):
        what = "has no effect: a force of 0 N pushes nobody"
        raise InputError(what, "--pushes", "give newtons, or leave it out")
    if args.specialists and args.workers:
        raise InputError("does not go with --workers", "--specialists", "leave one out")
    _refuse_unused_details(args)


def _refuse_unused_details(args: TrainArgs) -> None:
    """Refuse sizes of errors and faults that no episode has.

    Raises:
        InputError: naming the option.
    """
    starts, devices = args.starts, args.randomisation
    errors = ("lean_m", "speed_m_s", "place_m", "lift_m", "joints_rad")
    for group, options, used, names, needed in (
        ("starts", starts, starts.disturbed > 0.0, errors, "disturbed"),
        ("randomisation", devices, max(devices.dropout) > 0.0, ("dropout_frames",), "dropout"),
        ("randomisation", devices, devices.recentres, ("recentre_s",), "recentre-m"),
    ):
        plain = type(options)()
        for name in () if used else names:
            if getattr(options, name) != getattr(plain, name):
                option, fix = name.replace("_", "-"), f"add --{group}.{needed}, or leave it out"
                raise InputError("has no effect", f"--{group}.{option}", fix)


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

    A tracker of estimates is scored on the estimates, which are the motions that it observes, other
    policies on their validation motions. The page shows only the avatar: a policy of another body
    is filmed instead.
    """
    out, motions = args.out, args.estimates or args.validation or "synthetic"
    try:
        score = f"questsim evaluate --agent {out} --motions {motions} --out {out}/scores"
        trained = f"trained: {find_policy(out)}\n"
        if args.body is not None:
            return f"{trained}score and film it: {score} --video"
        return f"{trained}score it: {score}\nwatch it: questsim play {out}"
    except InputError:  # fine-tuning saves only a policy better than its start
        return f"no better than its start yet; continue with --resume --out {out}"


def _stage_names(args: TrainArgs, preset: Preset) -> list[str]:
    if args.stage == "all":
        names = [name for name, stage in preset.stages.items() if stage.share > 0]
        if not names:
            fix = "give one of them more"
            raise InputError("no stage has a share of the time", "--set stages.*.share", fix)
        return names
    if args.stage not in preset.stages:
        raise InputError(
            f"preset {args.preset} has no stage {args.stage!r}",
            "--stage",
            f"it has {', '.join(preset.stages)}",
        )
    return [args.stage]
