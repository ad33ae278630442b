"""Run an agent on clips in the environment it needs, and record every frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np

from agents.agent import Agent
from agents.evaluation.assisted import AssistUse
from agents.evaluation.follow import evaluation_sim, follow
from agents.evaluation.mapping import Mapper
from envs.config import MAX_ERROR_M, EnvConfig
from envs.core import BatchSim
from envs.objects import shapes_of
from envs.options import config_from
from envs.terrain import TERRAINS
from questsim.errors import InputError
from questsim.metrics import Rollout
from questsim.motion.clip import FPS, Clip
from questsim.objects import ObjectTrack
from questsim.skeleton import NUM_LINKS

BATCH_CLIPS = 64
"""Clips simulated together, of similar length: a batch takes as long as its longest clip."""


@dataclass(frozen=True)
class _Batch:
    """The arguments of ``roll_out`` for one batch, with the bound of its assist in N."""

    agent: Agent
    clips: list[Clip]
    config: EnvConfig
    threads: int
    shown: list[Clip] | None
    assist_n: float | None
    begin_at: dict[str, Clip] | None
    seed: int


def env_config(
    agent: Agent,
    env_id: str | None = None,
    height_m: float | None = None,
    body: str | None = None,
) -> EnvConfig:
    """Configuration of the environment that an agent needs, or of ``env_id`` if given.

    Args:
        agent: its ``needs`` give sensors, future frames and body.
        env_id: a registered environment; its options replace the agent's.
        height_m: stature of all avatars.
        body: description of a body of the user's own; None for the agent's.

    Raises:
        InputError: no such id, or its options do not fit the agent.
    """
    options: dict[str, Any] = {
        "sensors": agent.needs.sensors,
        "future_frames": agent.needs.future_frames,
        "privileged": agent.needs.privileged,
        "body_preset": agent.needs.body_preset,
        "observe_proportions": agent.needs.observe_proportions,
        "body": agent.needs.body if body is None else body,
    }
    if env_id is not None:
        known = sorted(i for i in gym.registry if i.startswith("QuestSim"))
        if env_id not in known:
            what, fix = f"there is no environment {env_id!r}", f"choose from {', '.join(known)}"
            if env_id.partition(":")[0] in TERRAINS:  # as train.py's --env
                fix = f"write --terrain {env_id}, or {fix}"
            raise InputError(what, "--env", fix)
        options |= {"sensors": EnvConfig().sensors} | gym.spec(env_id).kwargs
    heights = None if height_m is None else (height_m, height_m)
    return config_from({**options, "heights": heights, "fixed_start": True})


def roll_out(
    agent: Agent,
    clips: Sequence[Clip],
    config: EnvConfig,
    threads: int = 1,
    shown: Sequence[Clip] | None = None,
    assist: AssistUse | None = None,
    begin_at: Mapping[str, Clip] | None = None,
    seed: int = 0,
    mapper: Mapper = map,
) -> list[Rollout]:
    """Run an agent on clips, in batches of ``BATCH_CLIPS``.

    Args:
        agent: any agent.
        clips: the references.
        config: with ``fixed_start``.
        threads: physics threads.
        shown: clips that the agent observes instead of ``clips``, see ``BatchSim``.
        assist: applies an assisting force; None for physics without one.
        begin_at: estimates in which episodes begin, see ``BatchSim``.
        seed: of the device noise and of places on a terrain.
        mapper: runs the batches, here or on workers, with the same bits.

    Returns:
        One rollout per clip, in the order of ``clips``.

    Raises:
        InputError: a clip is shorter than the future window, or the agent does not fit.
    """
    parts = batches_of(clips, BATCH_CLIPS)
    jobs = [
        _Batch(
            agent,
            [clips[i] for i in part],
            config,
            threads,
            None if shown is None else [shown[i] for i in part],
            None if assist is None else assist.bound_n,
            None if begin_at is None else {clips[i].name: begin_at[clips[i].name] for i in part},
            seed,
        )
        for part in parts
    ]
    rollouts: dict[int, Rollout] = {}
    for part, (rolled, used) in zip(parts, mapper(_roll_out_batch, jobs), strict=True):
        rollouts.update(zip(part, rolled, strict=True))
        if assist is not None and used is not None:
            assist.add(used)
    return [rollouts[i] for i in range(len(clips))]


def batches_of(clips: Sequence[Clip], size: int) -> list[list[int]]:
    """Numbers of the clips in batches of at most ``size``, the shortest clips first."""
    order = sorted(range(len(clips)), key=lambda i: len(clips[i]))
    return [order[first : first + size] for first in range(0, len(order), size)]


class Recorder:
    """Records every quantity that metrics need, at every step of a batch.

    Args:
        sim: the simulation, one avatar per clip.
        frames: number of frames of the longest clip.
    """

    def __init__(self, sim: BatchSim, frames: int) -> None:
        self._sim = sim
        n = sim.num_envs
        self.position = np.zeros((frames, n, NUM_LINKS, 3), np.float32)
        self.quat = np.zeros((frames, n, NUM_LINKS, 4), np.float32)
        self.angles = np.zeros((frames, n, len(sim.avatar.dofs)), np.float32)
        self.root = np.zeros((frames, n, 7), np.float32)
        self.clearance = np.zeros((frames, n, 2), np.float32)
        self.force = np.zeros((frames, n, 2), np.float32)
        self.objects = np.zeros((frames, *sim.objects.pose.shape), np.float32)
        self.count = np.zeros(n, np.int64)
        self._at = 0

    def __call__(self, keep: np.ndarray) -> None:
        """Record the present state of the avatars selected by ``keep`` ``(n,)`` bool."""
        sim, at = self._sim, self._at
        links = sim.link_positions, sim.link_quats
        self.position[at], self.quat[at] = sim.avatar.our_links(*links, sim.heights)
        self.angles[at] = sim.joint_angles
        self.root[at] = sim.qpos[:, :7]
        self.clearance[at] = sim.foot_clearance
        self.force[at] = sim.contact_force[..., 2]
        self.objects[at] = sim.objects.pose
        self.count += keep
        self._at += 1

    def objects_of(self, i: int) -> tuple[ObjectTrack, ...]:
        """The objects near avatar ``i`` in the recorded frames."""
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


def _as_ours(sim: BatchSim, clip: Clip) -> Clip:
    """The clip of another body with the links of our avatar, which metrics compare."""
    if sim.avatar.own is None:
        return clip
    position, quat = sim.avatar.our_links(clip.link_position, clip.link_quat, clip.height_m)
    return replace(clip, link_position=position, link_quat=quat)


def _roll_out_batch(job: _Batch) -> tuple[list[Rollout], AssistUse | None]:
    """The rollouts of a batch, and how much of the assist it used."""
    clips, config = job.clips, job.config
    assist = None if job.assist_n is None else AssistUse(job.assist_n)
    if assist is not None:  # an avatar that has lost its user may still be upright at the end
        config = replace(config, max_error_m=MAX_ERROR_M)
    sim = evaluation_sim(clips, config, job.threads, job.seed, job.shown, job.begin_at)
    try:
        job.agent.bind(sim)
        recorder = Recorder(sim, max(len(clip) for clip in clips))
        followed = follow(job.agent, sim, clips, recorder, assist)
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
                reference=_as_ours(sim, sim.placed_clip(i, clip)),
                link_position=recorder.position[:frames, i],
                link_quat=recorder.quat[:frames, i],
                joint_angles=recorder.angles[:frames, i],
                foot_clearance=recorder.clearance[:frames, i],
                contact_force=recorder.force[:frames, i],
                fell=bool(followed.fell[i]),
                seconds_simulated=followed.frames[i] / FPS,
                seconds_wall=followed.seconds * float(followed.frames[i]) / steps,
                objects=recorder.objects_of(i),
                body=job.config.body,
                root=None if job.config.body is None else recorder.root[:frames, i],
            )
        )
    return rollouts, None if assist is None else assist.only_counts()
