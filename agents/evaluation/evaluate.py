"""Evaluation from the command line: every clip from its first frame, a table, a report."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import gymnasium as gym
import numpy as np
import torch

from agents.agent import Agent, PolicyAgent, load_agent
from agents.evaluation.follow import choose_clips, evaluation_sim, follow
from agents.run_folder import data_record, versions
from envs.config import EnvConfig, config_from
from envs.core import BatchSim
from envs.objects import objects_named, shapes_of
from envs.terrain import height_field, terrain_named
from questsim.errors import InputError, at_least
from questsim.evaluation_report import check_writable, format_table, write_report
from questsim.metrics import Rollout
from questsim.metrics import evaluate as score
from questsim.motion.clip import FPS, Clip
from questsim.motion.motion import Motion
from questsim.objects import ObjectTrack
from questsim.skeleton import NUM_DOFS, NUM_LINKS

T = TypeVar("T", Clip, Motion, Rollout)
FILMED_CLIPS = 4
"""Clips in a video where none are named."""
BATCH_CLIPS = 320
"""At most this many clips are simulated at once: recordings of more would fill the memory."""


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


def env_config(agent: Agent, env_id: str | None = None, height_m: float | None = None) -> EnvConfig:
    """The environment that an agent needs, from an id if one is given.

    Args:
        agent: says which sensors, future frames and body it was made for.
        env_id: a registered environment; its options replace the agent's.
        height_m: stature of all avatars.

    Raises:
        InputError: there is no such id, or its options do not suit.
    """
    options: dict[str, Any] = {
        "sensors": agent.needs.sensors,
        "future_frames": agent.needs.future_frames,
        "privileged": agent.needs.privileged,
        "body_preset": agent.needs.body_preset,
    }
    if env_id is not None:
        known = sorted(i for i in gym.registry if i.startswith("QuestSim"))
        if env_id not in known:
            raise InputError(f"there is no environment {env_id!r}", "--env", ", ".join(known))
        options |= {"sensors": EnvConfig().sensors} | gym.spec(env_id).kwargs
    heights = None if height_m is None else (height_m, height_m)
    return config_from({**options, "heights": heights, "fixed_start": True})


def roll_out(
    agent: Agent,
    clips: Sequence[Clip],
    config: EnvConfig,
    threads: int = 1,
    shown: Sequence[Clip] | None = None,
) -> list[Rollout]:
    """Let an agent follow clips, in as few batches as the memory allows.

    Args:
        agent: any.
        clips: what to follow.
        config: with ``fixed_start``.
        threads: of the physics.
        shown: what the agent sees in place of the clips, see ``BatchSim``.

    Returns:
        One rollout a clip, in their order.

    Raises:
        InputError: a clip is shorter than the future window, or the agent does not fit.
    """
    # Clips of similar length together: a batch takes as long as its longest.
    order = sorted(range(len(clips)), key=lambda i: len(clips[i]))
    rollouts: dict[int, Rollout] = {}
    for first in range(0, len(order), BATCH_CLIPS):
        part = order[first : first + BATCH_CLIPS]
        batch = [clips[i] for i in part]
        seen = None if shown is None else [shown[i] for i in part]
        rolled = _roll_out_batch(agent, batch, config, threads, seen)
        rollouts.update(zip(part, rolled, strict=True))
    return [rollouts[i] for i in range(len(clips))]


class Recorder:
    """Keeps what metrics need of every step of a batch.

    Args:
        sim: the simulation, one avatar a clip.
        frames: of the longest clip.
    """

    def __init__(self, sim: BatchSim, frames: int) -> None:
        self._sim = sim
        n = sim.num_envs
        self.position = np.zeros((frames, n, NUM_LINKS, 3), np.float32)
        self.quat = np.zeros((frames, n, NUM_LINKS, 4), np.float32)
        self.angles = np.zeros((frames, n, NUM_DOFS), np.float32)
        self.clearance = np.zeros((frames, n, 2), np.float32)
        self.force = np.zeros((frames, n, 2), np.float32)
        self.objects = np.zeros((frames, *sim.objects.pose.shape), np.float32)
        self.count = np.zeros(n, np.int64)
        self._at = 0

    def __call__(self, keep: np.ndarray) -> None:
        """Take in the present state; ``keep`` ``(n,)`` says whose counts as a frame."""
        sim, at = self._sim, self._at
        self.position[at] = sim.link_positions
        self.quat[at] = sim.link_quats
        self.angles[at] = sim.joint_angles
        self.clearance[at] = sim.foot_clearance
        self.force[at] = sim.contact_force[..., 2]
        self.objects[at] = sim.objects.pose
        self.count += keep
        self._at += 1

    def objects_of(self, i: int) -> tuple[ObjectTrack, ...]:
        """The objects beside avatar ``i`` in the frames that were kept."""
        frames, objects = int(self.count[i]), self._sim.config.objects
        height = float(self._sim.heights[i])
        return tuple(
            ObjectTrack(
                shapes_of(obj, height),
                self.objects[:frames, i, number, :3],
                self.objects[:frames, i, number, 3:],
            )
            for number, obj in enumerate(objects)
        )


def _roll_out_batch(
    agent: Agent, clips: list[Clip], config: EnvConfig, threads: int, shown: list[Clip] | None
) -> list[Rollout]:
    sim = evaluation_sim(clips, config, threads, shown=shown)
    try:
        agent.bind(sim)
        recorder = Recorder(sim, max(len(clip) for clip in clips))
        followed = follow(agent, sim, clips, recorder)
    finally:
        sim.close()
    steps = int(followed.frames.sum())
    rollouts = []
    for i, clip in enumerate(clips):
        frames = int(recorder.count[i])
        height = float(sim.heights[i])
        rollouts.append(
            Rollout(
                name=clip.name,
                kind=clip.kind,
                style=clip.style,
                height_m=height,
                fps=FPS,
                reference=sim.placed_clip(i, clip),
                link_position=recorder.position[:frames, i],
                link_quat=recorder.quat[:frames, i],
                joint_angles=recorder.angles[:frames, i],
                foot_clearance=recorder.clearance[:frames, i],
                contact_force=recorder.force[:frames, i],
                fell=bool(followed.fell[i]),
                seconds_simulated=followed.frames[i] / FPS,
                seconds_wall=followed.seconds * float(followed.frames[i]) / steps,
                objects=recorder.objects_of(i),
            )
        )
    return rollouts


def _film(rollouts: list[Rollout], path: Path, config: EnvConfig, count: int) -> None:
    """Write the video, or say in one line why there is none."""
    from questsim.viewing.films import rollout_video
    from questsim.viewing.gl import NoGLError

    try:
        ground = None if config.terrain is None else height_field(config.terrain)
        print(f"written to {rollout_video(rollouts, path, max_clips=count, ground=ground)}")
    except NoGLError as error:
        print(f"video skipped: {error}", file=sys.stderr)
