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
    tally = _Tally(len(clips))
    began = time.perf_counter()
    sim.reset()
    agent.reset(len(clips))
    if record is not None:
        record(tally.active)
    if assist is not None:
        assist.begin(sim)
    while tally.running.any():
        if assist is not None:
            assist.apply()
        sim.step(agent.act(sim.observation))
        if assist is not None:
            assist.count(tally.active, tally.running)
        good = tally.add(sim)
        if record is not None:
            record(good)
        tally.end(sim, to_the_end=assist is not None)
    return Followed(
        frames=tally.frames,
        fell=tally.fell,
        total_reward=tally.reward,
        length=np.array([len(clip) - 1 for clip in clips]),
        kinds=tuple(clip.kind for clip in clips),
        mean_error_m=tally.error / tally.frames,
        seconds=time.perf_counter() - began,
    )


class _Tally:
    """Counts of ``C`` clips while they are followed, ``(C,)`` each.

    Attributes:
        frames, reward, error: sums over the steps in which a clip was active.
        fell: the avatar fell, or lost its user.
        active: still followed.
        running: still simulated.
    """

    def __init__(self, count: int) -> None:
        self.frames = np.zeros(count, np.int64)
        self.reward, self.error = np.zeros(count), np.zeros(count)
        self.fell, self.active = np.zeros(count, bool), np.ones(count, bool)
        self.running = self.active.copy()

    def add(self, sim: BatchSim) -> np.ndarray:
        """Add a step; returns the active clips whose values are finite: only these are summed."""
        good = self.active & ~sim.unstable
        self.reward[good] += sim.reward[good]
        self.error[good] += sim.error[good]
        self.frames[self.active] += 1
        return good

    def end(self, sim: BatchSim, to_the_end: bool) -> None:
        """Stop clips that ended or whose avatar fell.

        With ``to_the_end`` those whose avatars have lost their users stay running.
        """
        lost = sim.fell | (sim.error > MAX_LINK_ERROR_M) if to_the_end else sim.fell
        self.fell |= self.active & lost
        self.active &= ~(lost | sim.ended)
        self.running &= ~(sim.fell | sim.ended) if to_the_end else self.active


def choose_clips(clips: Sequence[T], count: int) -> list[T]:
    """A fixed subset with all kinds of motion in proportion.

    Args:
        clips: clips or motions to choose from.
        count: largest size of the subset.
    """
    ordered = sorted(clips, key=lambda clip: (clip.kind, clip.style, clip.name))
    picks = np.unique(np.linspace(0, len(ordered) - 1, min(count, len(ordered))).astype(int))
    return [ordered[i] for i in picks]
