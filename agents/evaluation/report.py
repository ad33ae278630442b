"""Output of an evaluation: the printed table, the report and the video."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from agents.agent import Agent
from agents.evaluation.options import EvaluateArgs
from agents.policy.policy_agent import PolicyAgent
from agents.run_folder import data_record, versions
from envs.config import EnvConfig
from envs.terrain import height_field
from questsim.evaluation_report import format_table, write_report
from questsim.metrics import Rollout, evaluate
from questsim.motion.clip import Clip
from questsim.motion.kinematics import clip_from_qpos
from questsim.motion.motion import Motion

T = TypeVar("T", Clip, Motion, Rollout)
FILMED_CLIPS = 4
"""Number of clips in a video if none are named."""


def evaluation_context(
    name: str,
    agent: Agent | None,
    motions: str,
    clips: Sequence[Clip],
    config: EnvConfig | dict[str, Any],
    threads: int,
) -> dict[str, Any]:
    """The report's record of the evaluated agent, motions and configuration.

    Args:
        name: the agent's name as given on the command line.
        agent: the agent; None for a kinematic system.
        motions: the ``--motions`` argument that ``clips`` come from.
        clips: the clips that were followed.
        config: the environment, or the devices of a kinematic system.
        threads: threads of physics and networks.
    """
    return {
        "agent": name,
        "training": agent.card.get("training", {}) if isinstance(agent, PolicyAgent) else {},
        "config": config,
        "data": data_record(motions, clips),
        "versions": versions(),
        "threads": threads,
    }


def report(args: EvaluateArgs, rollouts: list[Rollout], context: dict[str, Any]) -> int:
    """Print the table and write the files that ``args`` request; returns the exit code."""
    if args.out is None:
        print(format_table(evaluate(rollouts)))
        return 0
    print(format_table(write_report(rollouts, args.out, context)))
    print(f"written to {args.out}")
    if args.save_motion is not None:
        save_motions(rollouts, args.out / "motions", args.save_motion)
    if args.video:
        config = context["config"]
        ground = config.terrain if isinstance(config, EnvConfig) else None
        shown = clips_in_video(args, rollouts)
        count = len(args.video_clips) or FILMED_CLIPS
        _film(shown, args.out / "rollouts.mp4", ground, count)
    return 0


def save_motions(rollouts: Sequence[Rollout], folder: Path, kind: str) -> None:
    """Write the avatar's motions in a file format of ``questsim.exporting``."""
    # Imported here: other evaluations do not need the file writers.
    from questsim.exporting import safe_names, write_clip

    folder.mkdir(exist_ok=True)
    names = safe_names([rollout.name for rollout in rollouts])
    for rollout, name in zip(rollouts, names, strict=True):
        write_clip(folder / f"{name}.{kind.lower()}", performed(rollout))
    print(f"{len(rollouts)} motions in {folder}")


def performed(rollout: Rollout) -> Clip:
    """The avatar's motion as a clip."""
    root = (rollout.link_position[:, 0], rollout.link_quat[:, 0])
    qpos = np.concatenate([*root, rollout.joint_angles], axis=-1)
    about = {"kind": rollout.kind, "style": rollout.style, "licence": rollout.reference.licence}
    body = rollout.reference.proportions
    return clip_from_qpos(rollout.name, qpos, rollout.height_m, body, **about)


def clips_in_video(args: EvaluateArgs, clips: list[T]) -> list[T]:
    """The clips, motions or rollouts named by ``--video-clips``; without names, all of them.

    Raises:
        InputError: no clip has one of the names.
    """
    if not args.video_clips:
        return clips
    from questsim.viewing.films import chosen_by_name

    return chosen_by_name(clips, args.video_clips, "--video-clips")


def _film(rollouts: list[Rollout], path: Path, terrain: Any, count: int) -> None:
    """Write the video, or print one line saying why it could not be written."""
    from questsim.viewing.films import rollout_video
    from questsim.viewing.gl import NoGLError

    try:
        ground = None if terrain is None else height_field(terrain)
        print(f"written to {rollout_video(rollouts, path, max_clips=count, ground=ground)}")
    except NoGLError as error:
        print(f"video skipped: {error}", file=sys.stderr)
