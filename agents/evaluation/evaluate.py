"""Evaluation from the command line: every clip from its first frame, a table, a report."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import torch

from agents.agent import Agent
from agents.evaluation.follow import choose_clips
from agents.evaluation.rollout import env_config, roll_out
from agents.loading import load_agent
from agents.policy.policy_agent import PolicyAgent
from agents.run_folder import data_record, versions
from envs.config import EnvConfig
from envs.objects import objects_named
from envs.terrain import height_field, terrain_named
from questsim.errors import InputError, at_least
from questsim.evaluation_report import check_writable, format_table, write_report
from questsim.metrics import Rollout
from questsim.metrics import evaluate as score
from questsim.motion.clip import Clip
from questsim.motion.motion import Motion

T = TypeVar("T", Clip, Motion, Rollout)
FILMED_CLIPS = 4
"""Clips in a video where none are named."""


@dataclass(frozen=True)
class EvaluateArgs:
    """Let an agent follow clips from their first frame and score it."""

    agent: str = "questsim"
    """A policy folder, a run folder, a shipped policy's name, zero or random; or a kinematic
    system with physics behind it, e.g. hmdposer+physics."""
    motions: str = "synthetic"
    """What to follow: synthetic, a dataset (bandai-namco-2:test), a library, file or folder."""
    env: str | None = None
    """Environment id (see questsim envs); by default what the agent needs."""
    height: float | None = None
    """Stature in metres to scale avatar and clips to; by default the motions' own."""
    avatar_height: float | None = None
    """Stature in metres of the avatar, if it is not its user's: the devices are scaled to it."""
    terrain: str | None = None
    """Ground to walk on, e.g. rough or rough:amplitude_m=0.08, instead of the environment's."""
    objects: tuple[str, ...] = ()
    """Things on the clips' paths: ball, box, hurdle, chair."""
    worlds: bool = False
    """Run the worlds table instead: rough ground, slopes, pushes, ...; writes worlds.json."""
    out: Path | None = None
    """Folder for metrics.json, clips.csv and plots."""
    video: bool = False
    """Also write a video of avatar beside reference; with --compare, of all agents side by side."""
    video_clips: tuple[str, ...] = ()
    """Names of the clips that the video shows; by default four of different kinds."""
    scorecard: bool = False
    """Evaluate the agent and its shipped variants at all heights against the project's bars."""
    max_clips: int | None = None
    """Follow only this many clips, of all kinds of motion."""
    threads: int = 2
    """Threads of physics and networks."""
    seed: int = 0
    """Of the embedded motions."""
    compare: bool = False
    """Compare kinematic systems (--agents) instead, on the same frames."""
    agents: tuple[str, ...] = ()
    """With --compare: systems, each a name (ik), checkpoint folder or run folder, with or without
    +physics after it; and policies. By default all that are shipped."""
    sensors: str | None = None
    """With --compare: only with this set of sensors, e.g. H+2C or 6T; by default with all that an
    agent can use."""


def evaluate(args: EvaluateArgs) -> int:
    """Run an evaluation, print its table and write its report; returns the exit code.

    Raises:
        InputError: for an agent, motions or a folder that cannot be used.
    """
    from questsim.motion.spec import load_motions

    if args.video_clips and not args.video:
        raise InputError("there is no video to show them", "--video-clips", "add --video")
    if args.compare:
        from agents.comparison.compare import compare

        return compare(
            args.agents, args.motions, args.out, args.max_clips, args.threads, args.seed,
            args.sensors, args.video, args.video_clips,
        )  # fmt: skip
    at_least(1, threads=args.threads, max_clips=args.max_clips)
    at_least(0, seed=args.seed)
    if args.video and args.out is None:
        raise InputError("a video needs a folder", "--video", "add --out DIR")
    if args.worlds:
        _check_worlds(args)
    if args.out is not None:
        check_writable(args.out)
    torch.set_num_threads(args.threads)
    if args.scorecard:
        from agents.evaluation.scorecard import format_scorecard, scorecard

        card = scorecard(args.agent, args.motions, args.out, args.max_clips, args.threads)
        print(format_scorecard(card))
        return 0
    if args.agent.endswith("+physics"):
        return _physics(args)
    agent = load_agent(args.agent)
    height = args.height if args.avatar_height is None else args.avatar_height
    config = env_config(agent, args.env, height)
    if args.terrain is not None:
        config = replace(config, terrain=terrain_named(args.terrain, "--terrain"))
    if args.objects:
        config = replace(config, objects=objects_named(args.objects, "--objects"))
    clips = load_motions(args.motions, seed=args.seed)
    if args.worlds:
        return _worlds(args, agent, clips, config)
    if args.max_clips is not None:
        clips = choose_clips(clips, args.max_clips)
    _filmed(args, clips)
    return _report(args, agent, clips, config, roll_out(agent, clips, config, args.threads))


def _physics(args: EvaluateArgs) -> int:
    """A kinematic system with physics behind it, on what its first scenario's devices report."""
    from agents.comparison.compare import chosen
    from agents.comparison.run import reference, suiting, workers
    from agents.kinematic.physics_behind import TRACKER, base_of, follow_poses
    from questsim.motion.spec import load_recordings

    for option in ("env", "height", "avatar_height", "terrain", "objects", "worlds", "scorecard"):
        if getattr(args, option):
            raise InputError(f"does not go with {args.agent}", f"--{option.replace('_', '-')}")
    scenario = suiting(args.agent, None)[0]
    motions = chosen(load_recordings(args.motions, seed=args.seed), args.max_clips)
    _filmed(args, motions)
    base = base_of(args.agent) or args.agent
    with workers(args.threads) as mapper:
        references = list(mapper(reference, [(base, scenario, motion, 0) for motion in motions]))
    rollouts = follow_poses(references, motions, args.threads)
    tracker = load_agent(TRACKER)
    clips = [rollout.reference for rollout in rollouts]
    return _report(args, tracker, clips, env_config(tracker), rollouts)


def _report(
    args: EvaluateArgs,
    agent: Agent,
    clips: Sequence[Clip],
    config: EnvConfig,
    rollouts: list[Rollout],
) -> int:
    if args.out is None:
        print(format_table(score(rollouts)))
        return 0
    context = evaluation_context(args.agent, agent, args.motions, clips, config, args.threads)
    print(format_table(write_report(rollouts, args.out, context)))
    print(f"written to {args.out}")
    if args.video:
        rollouts = _filmed(args, rollouts)
        _film(rollouts, args.out / "rollouts.mp4", config, len(args.video_clips) or FILMED_CLIPS)
    return 0


def _filmed(args: EvaluateArgs, clips: list[T]) -> list[T]:
    """Those that ``--video-clips`` names, or all to choose from.

    Raises:
        InputError: there is none of a name.
    """
    if not args.video_clips:
        return clips
    from questsim.viewing.films import named

    return named(clips, args.video_clips, "--video-clips")


def evaluation_context(
    name: str, agent: Agent, motions: str, clips: Sequence[Clip], config: EnvConfig, threads: int
) -> dict[str, Any]:
    """What was evaluated, for the report.

    Args:
        name: of the agent, as it was given.
        agent: itself.
        motions: the motion argument of ``clips``.
        clips: what was followed.
        config: where.
        threads: of physics and networks.
    """
    return {
        "agent": name,
        "training": agent.card.get("training", {}) if isinstance(agent, PolicyAgent) else {},
        "config": config,
        "data": data_record(motions, clips),
        "versions": versions(),
        "threads": threads,
    }


def _check_worlds(args: EvaluateArgs) -> None:
    """Refuse what the table sets itself, or does not make."""
    if args.out is None:
        raise InputError("the table needs a folder", "--worlds", "add --out DIR")
    for option in ("env", "height", "avatar_height", "terrain", "objects", "video"):
        if getattr(args, option):
            raise InputError("does not go with --worlds", f"--{option.replace('_', '-')}")


def _worlds(args: EvaluateArgs, agent: Agent, clips: Sequence[Clip], config: EnvConfig) -> int:
    from agents.evaluation.worlds import format_worlds, run_worlds, write_worlds

    assert args.out is not None
    table = run_worlds(agent, clips, config, args.threads, args.max_clips, args.seed)
    print(format_worlds(table))
    context = evaluation_context(args.agent, agent, args.motions, clips, config, args.threads)
    print(f"written to {write_worlds(table, args.out, context)}")
    return 0


def _film(rollouts: list[Rollout], path: Path, config: EnvConfig, count: int) -> None:
    """Write the video, or say in one line why there is none."""
    from questsim.viewing.films import rollout_video
    from questsim.viewing.gl import NoGLError

    try:
        ground = None if config.terrain is None else height_field(config.terrain)
        print(f"written to {rollout_video(rollouts, path, max_clips=count, ground=ground)}")
    except NoGLError as error:
        print(f"video skipped: {error}", file=sys.stderr)
