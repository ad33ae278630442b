"""``evaluate.py``: evaluate an agent on clips, run the worlds table or scorecard, or compare."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any

import torch

from agents.comparison.options import CompareArgs
from agents.evaluation.assisted import AssistUse
from agents.evaluation.follow import choose_clips
from agents.evaluation.groups import by_group, check_conditions, format_groups, grouped_clips
from agents.evaluation.options import Begin, ByGroupArgs, EvaluateArgs, ScorecardArgs, WorldsArgs
from agents.evaluation.report import clips_in_video, evaluation_context, report
from agents.evaluation.rollout import env_config, roll_out
from agents.evaluation.scorecard import format_scorecard, scorecard
from agents.evaluation.seeds import check_random, format_spread, seeded, spread
from agents.evaluation.worlds import format_worlds, run_worlds, write_worlds
from agents.loading import load_agent
from agents.resolve import ESTIMATE_TRACKER, Resolved, resolve
from agents.training.ray_session import ray_map
from agents.training.watched import beside_ray
from envs.config import EnvConfig
from envs.objects import objects_named
from envs.randomisation import REAL_DEVICES
from envs.starts import WHOLLY
from envs.terrain import terrain_named
from questsim.errors import InputError, at_least, each_once, usable_seed
from questsim.evaluation_report import check_writable
from questsim.exporting.formats import check_format
from questsim.motion.clip import Clip

_OF_PHYSICS = (
    "env",
    "height",
    "own_proportions",
    "terrain",
    "objects",
    "begin",
    "noise",
    "unscaled",
    "body",
    "seeds",
)
"""Environment options, which do not apply to a kinematic system."""


@beside_ray
def evaluate(args: EvaluateArgs) -> int:
    """Run an evaluation, print its table and write its report; returns the exit code.

    Raises:
        InputError: an agent, motions or a folder cannot be used.
    """
    from questsim.motion.spec import check_own_proportions, check_seed, load_motions

    at_least(1, threads=args.threads, max_clips=args.max_clips, seeds=args.seeds)
    usable_seed(args.seed)
    _check_outputs(args)
    check_seed(args.motions, args.seed)
    found = resolve(args.agent)
    _refuse_unused(args, ("sensors",) if found.torques else _OF_PHYSICS)
    if args.out is not None:
        check_writable(args.out)
    torch.set_num_threads(args.threads)
    if not found.torques:
        return _evaluate_system(args, found)
    agent = load_agent(found)
    config = _config_of(args, env_config(agent, args.env, args.height, args.body))
    _refuse_own_body(args, config)
    check_random(agent, config, args.seeds)
    if args.seeds > 1 and args.assist is not None:
        raise InputError("does not go with --seeds", "--assist", "give one of them")
    if args.own_proportions:
        check_own_proportions(args.motions)
    clips = load_motions(args.motions, seed=args.seed, own_proportions=args.own_proportions)
    if args.max_clips is not None:
        clips = choose_clips(clips, args.max_clips)
    clips_in_video(args, clips)  # refuses unknown names before the evaluation
    assist = None if args.assist is None else AssistUse(args.assist)
    clips, begin_at = _begun(clips, args.begin)
    with ray_map(args.workers, args.ray, args.threads) as mapper:
        runs = [
            roll_out(
                seeded(agent, seed), clips, config, args.threads, None, assist, begin_at, seed,
                mapper,
            )
            for seed in range(args.seeds)
        ]  # fmt: skip
    context = evaluation_context(args.agent, agent, args.motions, clips, config, args.threads)
    context |= _assisted(assist)
    if args.seeds > 1:
        context["seeds"] = spread(runs)
        print(format_spread(context["seeds"], args.seeds))
    return report(args, runs[0], context)


def _check_outputs(args: EvaluateArgs) -> None:
    """Refuse files that have no folder, and clips of a video without a video."""
    if args.video_clips and not args.video:
        raise InputError("needs a video", "--video-clips", "add --video")
    if args.video and args.out is None:
        raise InputError("needs a folder", "--video", "add --out DIR")
    if args.save_motion is not None:
        check_format(args.save_motion, "--save-motion")
        if args.out is None:
            raise InputError("needs a folder", "--save-motion", "add --out DIR")


def _assisted(assist: AssistUse | None) -> dict[str, Any]:
    """Print the use of the assist and return it for the report; empty without assist."""
    if assist is None:
        return {}
    print(assist.line())
    return {"assist": assist.figures()}


def _refuse_unused(args: EvaluateArgs, options: Sequence[str]) -> None:
    """Refuse options that this agent does not use."""
    plain = {field.name: field.default for field in fields(EvaluateArgs)}
    for option in options:
        if getattr(args, option) != plain[option]:
            flag = f"--{option.replace('_', '-')}"
            raise InputError(f"does not go with {args.agent}", flag, "leave it out")


_OF_OUR_AVATAR = {
    "assist": "its forces are made for our avatar's legs and trunk",
    "save_motion": "these files have our avatar's skeleton",
    "own_proportions": "the body keeps its own proportions",
}
"""Options that a body of the user's own does not have, each with the reason."""


def _refuse_own_body(args: EvaluateArgs, config: EnvConfig) -> None:
    """Refuse options that only our avatar has."""
    for option, reason in _OF_OUR_AVATAR.items():
        given = getattr(args, option)
        if config.body is not None and given is not None and given is not False:
            raise InputError(
                f"does not go with a body of your own: {reason}",
                f"--{option.replace('_', '-')}",
                "leave it out",
            )


def _config_of(args: EvaluateArgs, config: EnvConfig) -> EnvConfig:
    """The environment with the requested terrain, objects, initial state and devices."""
    if args.terrain is not None:
        config = replace(config, terrain=terrain_named(args.terrain, "--terrain"))
    if args.objects:
        config = replace(config, objects=objects_named(args.objects, "--objects"))
    if args.noise:
        config = replace(config, randomisation=REAL_DEVICES)
    return replace(config, starts=WHOLLY[args.begin], unscaled_m=args.unscaled)


def _begun(clips: Sequence[Clip], begin: Begin) -> tuple[list[Clip], dict[str, Clip] | None]:
    """The clips from the moment at which avatars begin, and the estimates in which they do."""
    if not begin.endswith("estimate"):
        return list(clips), None
    # Imported here: this loads a kinematic system, which other evaluations do not need.
    from agents.kinematic.first_answers import begun_in_estimates

    return begun_in_estimates(clips, begin)


def _evaluate_system(args: EvaluateArgs, found: Resolved) -> int:
    """Evaluate a kinematic system, with or without physics, on its device signals."""
    # Imported here: this loads all systems, which an evaluation of a policy does not need.
    from agents.kinematic.estimates import Job, at_sensor_rate, scenario_with
    from agents.kinematic.evaluate import estimated_rollouts, simulated_rollouts
    from agents.kinematic.processes import process_map
    from questsim.motion.spec import load_recordings

    scenario = scenario_with(found, args.sensors)
    behind = found.kind == "physics"
    if args.assist is not None and not behind:
        what = f"{args.agent} has no physics and cannot be assisted"
        raise InputError(what, "--assist", "leave it out")
    motions = at_sensor_rate(load_recordings(args.motions, seed=args.seed), args.max_clips)
    clips_in_video(args, motions)
    jobs = [Job(found.base, scenario, motion) for motion in motions]
    assist = None if args.assist is None else AssistUse(args.assist)
    with process_map(args.threads, args.workers, args.ray) as mapper:
        if behind:
            physics = mapper if args.workers else map
            rollouts = simulated_rollouts(jobs, args.threads, assist, mapper, physics)
        else:
            rollouts = estimated_rollouts(jobs, mapper)
    clips = [rollout.reference for rollout in rollouts]
    tracker = load_agent(ESTIMATE_TRACKER) if behind else None
    given = {"physics": False, "devices": list(scenario.devices)}
    config = given if tracker is None else env_config(tracker)
    context = evaluation_context(args.agent, tracker, args.motions, clips, config, args.threads)
    extra = _assisted(assist) if behind else {"training": found.training}
    return report(args, rollouts, context | extra)


@beside_ray
def evaluate_worlds(args: WorldsArgs) -> int:
    """Run the worlds table, print it and write worlds.json; returns the exit code.

    Raises:
        InputError: an agent, motions or a folder cannot be used.
    """
    from questsim.motion.spec import load_motions

    at_least(1, threads=args.threads, max_clips=args.max_clips)
    usable_seed(args.seed)
    check_writable(args.out)
    torch.set_num_threads(args.threads)
    agent = load_agent(args.agent)
    config = env_config(agent)
    clips = load_motions(args.motions, seed=args.seed)
    with ray_map(args.workers, args.ray, args.threads) as mapper:
        table = run_worlds(agent, clips, config, args.threads, args.max_clips, args.seed, mapper)
    print(format_worlds(table))
    context = evaluation_context(args.agent, agent, args.motions, clips, config, args.threads)
    print(f"written to {write_worlds(table, args.out, context)}")
    return 0


@beside_ray
def evaluate_scorecard(args: ScorecardArgs) -> int:
    """Compare a policy and its variants with the bars, print the table; returns the exit code.

    Raises:
        InputError: one of the policies, the motions or a folder cannot be used.
    """
    from questsim.motion.spec import check_seed

    at_least(1, threads=args.threads, max_clips=args.max_clips)
    usable_seed(args.seed)
    each_once(rows=args.rows)
    check_seed((args.motions, *((args.extra,) if args.extra else ())), args.seed)
    if args.out is not None:
        check_writable(args.out)
    torch.set_num_threads(args.threads)
    with ray_map(args.workers, args.ray, args.threads) as mapper:
        card = scorecard(
            args.agent, args.motions, args.out, args.max_clips, args.threads, args.seed, args.rows,
            args.extra, partial(_begun, begin="estimate"), mapper=mapper,
        )  # fmt: skip
    print(format_scorecard(card))
    return 0


@beside_ray
def evaluate_by_group(args: ByGroupArgs) -> int:
    """Print the table of groups and conditions; returns the exit code.

    Raises:
        InputError: the policy, the motions, a condition or the folder cannot be used.
    """
    from questsim.motion.spec import check_seed

    at_least(1, threads=args.threads, max_clips=args.max_clips)
    usable_seed(args.seed)
    check_conditions(args.under)
    each_once(under=args.under)
    check_seed(args.motions, args.seed)
    if args.out is not None:
        check_writable(args.out)
    torch.set_num_threads(args.threads)
    agent = load_agent(args.agent)
    config = env_config(agent)
    clips, groups = grouped_clips(args.motions, args.seed, args.max_clips)
    about = evaluation_context(args.agent, agent, args.motions, clips, config, args.threads)
    with ray_map(args.workers, args.ray, args.threads) as mapper:
        found = by_group(
            agent, clips, groups, config, args.under, args.threads, mapper, args.out, about
        )
    print(format_groups(found))
    if args.out is not None:
        print(f"written to {args.out}")
    return 0


@beside_ray
def evaluate_comparison(args: CompareArgs) -> int:
    """See ``agents.comparison.compare``; returns the exit code.

    Raises:
        InputError: there is nothing to compare, or an argument cannot be used.
    """
    from agents.comparison.compare import compare
    from agents.shipping.cards import rewrite_cards

    code = compare(args)
    if args.cards and code == 0:
        for path in rewrite_cards(args.out / "comparison.json"):
            print(f"written to {path}")
    return code
