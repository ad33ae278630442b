"""Training of kinematic systems from the command line: ``train.py --agent SYSTEM``."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import Any

import torch
from torch import nn

from agents.kinematic.data import MotionBank, motions_record
from agents.kinematic.fit import Fit
from agents.kinematic.learning import Config, Learning
from agents.kinematic.options import TrainSystemArgs
from agents.kinematic.registry import AGENTS
from agents.kinematic.store import (
    CARD_FILE,
    find_system,
    load_module,
    read_system_card,
    save_system,
)
from agents.kinematic.team import Nobody, RayTeam, SharedStage, Team, part_of
from agents.overrides import refuse_repeated, with_overrides
from agents.resolve import from_anywhere
from agents.run_folder import (
    RunRecord,
    check_same_run,
    only_training,
    read_run,
    refuse_existing,
)
from agents.training.hold_out import without_styles
from agents.training.loggers import check_logger
from agents.training.monitor import Display
from agents.training.ray_session import check_workers, ray_cluster
from agents.training.stage import Budget, Stopper
from agents.training.watched import beside_ray
from questsim.errors import INTERRUPTED, InputError, at_least, one_of_these, usable_seed
from questsim.motion.motion import Motion

MAY_DIFFER_ON_RESUME = {
    "motions",
    "validation",
    "minutes",
    "steps",
    "resume",
    "threads",
    "out",
    "set",
    "log",
    "ray",
    "workers",
}


@beside_ray
def train_system(args: TrainSystemArgs) -> int:
    """Run a training of ``args.agent``; returns the exit code.

    Raises:
        InputError: options, motions or a run folder cannot be used.
    """
    args = replace(args, start=from_anywhere(args.start))
    check_logger(args.log)
    at_least(1, threads=args.threads, steps=args.steps)
    at_least(0, minutes=args.minutes)
    usable_seed(args.seed)
    if args.validation is not None and args.hold_out:
        raise InputError("does not go with --hold-out", "--validation", "leave one out")
    cluster = _cluster(args)
    if args.agent not in AGENTS:
        raise InputError(f"there is no {args.agent!r}", "--agent", one_of_these(args.agent, AGENTS))
    entry = AGENTS[args.agent]
    refuse_repeated(args.set)
    config = entry.needed(with_overrides(entry.presets[args.preset], args.set))
    if args.resume:
        read_run(args.out)
    else:
        refuse_existing(args.out)
    motions, held, data = _motions(args)
    if args.resume:
        check_same_run(read_run(args.out), args, data, MAY_DIFFER_ON_RESUME, args.out)
    torch.set_num_threads(args.threads)
    torch.manual_seed(args.seed)
    module = entry.build(config.spec)
    behind = shipped_start(args.start)
    if args.start is not None:
        begin_with(module, args.start, args.agent)
    record = RunRecord(args.out, args, config, data, lambda: behind)
    stopper, banks = Stopper(), {}
    with only_training(args.out), cluster, Display() as display, stopper.listening():
        for name in config.stages:
            fit = _fit(name, args, config, module, (motions, held), banks, data)
            record.begin()
            try:
                fit.run(display, stopper)
            finally:
                if isinstance(fit.team, RayTeam):
                    fit.team.close()
            if stopper.requested:
                display.say(f"stopped; continue with --resume --out {args.out}")
                return INTERRUPTED
            best = args.out / name / "best"
            module.load_state_dict(load_module(best)[0].state_dict())
        display.say(f"trained: {find_system(args.out)}")
    return 0


def _motions(args: TrainSystemArgs) -> tuple[Sequence[Motion], Sequence[Motion], dict[str, Any]]:
    """Motions to learn, those held out, and the record of the data."""
    from questsim.motion.spec import load_recordings

    motions, held = without_styles(load_recordings(args.motions, seed=args.seed), args.hold_out)
    data = motions_record(args.motions, motions)
    if args.validation is None:
        return motions, held, data | ({"hold_out": args.hold_out} if held else {})
    held = load_recordings(args.validation, seed=args.seed)
    return motions, held, data | {"validation": motions_record(args.validation, held)}


def _cluster(args: TrainSystemArgs) -> AbstractContextManager[None]:
    """The Ray cluster of ``--workers``, if any."""
    if args.workers == 0:
        check_workers(args.workers, args.ray)
        return nullcontext()
    at_least(2, workers=args.workers)
    return ray_cluster(args.ray, (args.workers - 1) * args.threads)


def begin_with(module: nn.Module, start: Path, agent: str) -> None:
    """Load the weights and normalisers of a trained system into a module.

    Args:
        module: the agent's networks.
        start: a checkpoint, stage or run folder, or a shipped name.
        agent: its name in the registry.

    Raises:
        InputError: there is no such system, or its agent or sizes differ.
    """
    found, card = load_module(find_system(start))
    if card["agent"] != agent:
        raise InputError(f"{start} is of the family {card['agent']}, not {agent}", "--start")
    try:
        module.load_state_dict(found.state_dict())
    except RuntimeError:
        raise InputError(
            f"{start} has networks of other sizes", "--start", "use its --preset and --set"
        ) from None


def shipped_start(start: Path | None) -> dict[str, Any]:
    """Training record of the shipped system named by ``--start``, for the run's record."""
    if start is None:
        return {}
    training = read_system_card(find_system(start)).get("training") or {}
    # A run folder has its own record.
    return {"start": training} if "stages" in training else {}


def _fit(
    name: str,
    args: TrainSystemArgs,
    config: Config,
    module: nn.Module,
    motions: tuple[Sequence[Motion], Sequence[Motion]],
    banks: dict[tuple[int, float], MotionBank],
    data: dict[str, Any],
) -> Fit:
    """One stage, resumed if ``args`` request it and a checkpoint exists.

    ``motions`` are those to learn and those held out.
    """
    learning = config.stages[name]
    drawn = learning.window, learning.kind_power
    if drawn not in banks:
        banks.clear()
        banks[drawn] = MotionBank(motions[0], learning.window, motions[1], learning.kind_power)
    stages = list(config.stages)
    # Each stage has its own random stream, whether or not the stage before was resumed.
    seed = args.seed + 1000 * stages.index(name)
    torch.manual_seed(seed)
    part = part_of(learning, max(args.workers, 1))
    bank, validation = banks[drawn], config.validation
    task = AGENTS[args.agent].task(module, name, part, bank, validation)
    team: Team = Nobody()
    if args.workers:
        about = (args.agent, config.spec, name, part, validation, seed, args.threads)
        team = RayTeam(SharedStage(*about, *motions), args.workers)

    def save(folder: Path, training: dict[str, Any], resume: dict[str, Any] | None) -> None:
        save_system(folder, module, args.agent, config.spec, training, resume)

    fit = Fit(
        name=name,
        module=module,
        task=task,
        learning=learning,
        folder=args.out / name,
        budget=_budget(name, args, config, bank),
        save=save,
        record=_record(args, learning, data) | {"trained": stages[: stages.index(name) + 1]},
        seed=seed,
        log=args.log,
        team=team,
    )
    if args.resume and (fit.folder / "last" / CARD_FILE).exists():
        fit.resume()
    return fit


def _record(args: TrainSystemArgs, learning: Learning, data: dict[str, Any]) -> dict[str, Any]:
    """What a system's description says of its training."""
    record = {"preset": args.preset, "seed": args.seed, "threads": args.threads, **data}
    if args.start is not None:
        record["start"] = str(args.start)
    if any(learning.noise.values()):
        record["noise"] = learning.noise
    return record


def _budget(name: str, args: TrainSystemArgs, config: Config, bank: MotionBank) -> Budget:
    """The time or the steps that are given; else the published epochs, or the preset's time."""
    learning = config.stages[name]
    if args.minutes is None and args.steps is None and learning.epochs is not None:
        steps = ceil(learning.epochs * bank.windows(learning.stride) / learning.batch)
        return Budget(None, min(steps, learning.steps or steps))
    minutes = config.minutes if args.minutes is None else args.minutes
    if args.steps is not None and args.minutes is None:
        minutes = None
    seconds = None if minutes is None else 60.0 * minutes * learning.share
    return Budget(seconds, learning.steps if args.steps is None else args.steps)
