"""Run an agent on a batch of clips, each from its first frame to its last."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from agents.agent import Agent
from agents.evaluation.assisted import AssistUse
from envs.config import EnvConfig
from envs.core import BatchSim
from questsim.metrics import MAX_LINK_ERROR_M
from questsim.motion.clip import Clip
from questsim.motion.motion import Motion

T = TypeVar("T", Clip, Motion)


@dataclass(frozen=True)
class Followed:
    """Results of ``C`` clips.

    Attributes:
        frames: ``(C,)`` steps until the fall or the end.
        fell: ``(C,)`` bool.
        total_reward: ``(C,)`` sum of rewards over ``frames``.
        length: ``(C,)`` steps in the clip.
        kinds: kind of motion of each clip.
        mean_error_m: ``(C,)`` mean link error over ``frames`` in metres.
        seconds: wall time of the whole batch.
    """

    frames: np.ndarray
    fell: np.ndarray
    total_reward: np.ndarray
    length: np.ndarray
    kinds: tuple[str, ...]
    mean_error_m: np.ndarray
    seconds: float

    @property
    def tracked(self) -> float:
        """Share of clips followed to the end."""
        return float(1.0 - self.fell.mean())

    @property
    def score(self) -> float:
        """Mean reward per reference frame, zero after a fall: combines survival and accuracy."""
        return float((self.total_reward / self.length).mean())

    @property
    def error_cm(self) -> float:
        """Mean link error in cm over all frames before the falls."""
        return float(100.0 * (self.mean_error_m * self.frames).sum() / self.frames.sum())


def evaluation_sim(
    clips: Sequence[Clip],
    config: EnvConfig,
    threads: int = 1,
    seed: int = 0,
    shown: Sequence[Clip] | None = None,
    begin_at: Mapping[str, Clip] | None = None,
) -> BatchSim:
    """One simulation per clip, each starting at its clip's first frame.

    Args:
        clips: the references.
        config: with ``fixed_start``.
        threads: physics threads.
        seed: seed of the device noise, if any.
        shown: clips that the agent observes instead of ``clips``, see ``BatchSim``.
        begin_at: estimates in which episodes begin, see ``BatchSim``.
    """
    return BatchSim(clips, config, len(clips), seed, threads, shown, begin_at)


def from_first_frames(config: EnvConfig) -> EnvConfig:
    """A training's conditions, from each clip's first frame, without starts in estimates."""
    starts = None if config.starts is None else replace(config.starts, estimate=0.0)
    limit = EnvConfig().max_error_m
    return replace(config, fixed_start=True, max_error_m=limit, starts=starts)


def follow(
    agent: Agent,
    sim: BatchSim,
    clips: Sequence[Clip],
    record: Callable[[np.ndarray], None] | None = None,
    assist: AssistUse | None = None,
) -> Followed:
    """Play every clip from its first frame until the agent falls or the clip ends.

    Args:
        agent: bound to ``sim``.
        sim: from ``evaluation_sim``.
        clips: the clips of ``sim``.
        record: called after reset and after each step with ``(C,)`` bool: avatars that had not
            finished before that step, whose state is to be recorded.
        assist: applies an assisting force, and watches every clip to its end; None for physics
            without one.
    """
    count = len(clips)
    length = np.array([len(clip) - 1 for clip in clips])
    frames, total, error = np.zeros(count, np.int64), np.zeros(count), np.zeros(count)
    fell, active = np.zeros(count, bool), np.ones(count, bool)
    running = active.copy()
    began = time.perf_counter()
    sim.reset()
    agent.reset(count)
    if record is not None:
        record(active)
    if assist is not None:
        assist.begin(sim)
    while running.any():
        if assist is not None:
            assist.apply()
        sim.step(agent.act(sim.observation))
        if assist is not None:
            assist.count(active, running)
        # Non-finite values are left out of sums and recordings.
        good = active & ~sim.unstable
        total[good] += sim.reward[good]
        error[good] += sim.error[good]
        frames[active] += 1
        if record is not None:
            record(good)
        lost = sim.fell if assist is None else sim.fell | (sim.error > MAX_LINK_ERROR_M)
        fell |= active & lost
        active &= ~(lost | sim.ended)
        running &= active if assist is None else ~(sim.fell | sim.ended)
    return Followed(
        frames=frames,
        fell=fell,
        total_reward=total,
        length=length,
        kinds=tuple(clip.kind for clip in clips),
        mean_error_m=error / frames,
        seconds=time.perf_counter() - began,
    )


def choose_clips(clips: Sequence[T], count: int) -> list[T]:
    """A fixed subset with all kinds of motion in proportion.

    Args:
        clips: clips or motions to choose from.
        count: largest size of the subset.
    """
    ordered = sorted(clips, key=lambda clip: (clip.kind, clip.style, clip.name))
    picks = np.unique(np.linspace(0, len(ordered) - 1, min(count, len(ordered))).astype(int))
    return [ordered[i] for i in picks]
