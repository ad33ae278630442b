"""Letting an agent follow clips from their first frame to the last, all at once."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from agents.agent import Agent
from agents.evaluation.assisted import AssistUse
from envs.config import EnvConfig
from envs.core import BatchSim
from questsim.motion.clip import Clip
from questsim.motion.motion import Motion

T = TypeVar("T", Clip, Motion)


@dataclass(frozen=True)
class Followed:
    """How each of ``C`` clips went.

    Attributes:
        frames: ``(C,)`` steps until the fall or the end.
        fell: ``(C,)`` bool.
        total_reward: ``(C,)`` sum of rewards until then.
        length: ``(C,)`` steps the clip has.
        kinds: kind of motion of each clip.
        mean_error_m: ``(C,)`` mean link error until then in metres.
        seconds: wall time of all.
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
        """Mean reward a frame of reference, zero after a fall: survival and accuracy in one."""
        return float((self.total_reward / self.length).mean())

    @property
    def error_cm(self) -> float:
        """Mean link error in cm over all frames until the falls."""
        return float(100.0 * (self.mean_error_m * self.frames).sum() / self.frames.sum())


def evaluation_sim(
    clips: Sequence[Clip],
    config: EnvConfig,
    threads: int = 1,
    seed: int = 0,
    shown: Sequence[Clip] | None = None,
) -> BatchSim:
    """One simulation a clip, each starting at its clip's first frame.

    Args:
        clips: what to follow.
        config: with ``fixed_start``.
        threads: of the physics.
        seed: of the devices' noise, if any.
        shown: what the agent sees in place of the clips, see ``BatchSim``.
    """
    return BatchSim(clips, config, len(clips), seed, threads, shown)


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
        clips: the same as there.
        record: called after reset and after each step with ``(C,)`` bool, which avatars were
            still being followed in that step (so their state is to be kept).
        assist: may help; None for honest physics.
    """
    count = len(clips)
    length = np.array([len(clip) - 1 for clip in clips])
    frames, total, error = np.zeros(count, np.int64), np.zeros(count), np.zeros(count)
    fell, active = np.zeros(count, bool), np.ones(count, bool)
    began = time.perf_counter()
    sim.reset()
    agent.reset(count)
    if record is not None:
        record(active)
    if assist is not None:
        assist.begin(sim)
    while active.any():
        if assist is not None:
            assist.apply(active)
        sim.step(agent.act(sim.observation))
        # What is not finite has no place in a sum, nor in a recording.
        good = active & ~sim.unstable
        total[good] += sim.reward[good]
        error[good] += sim.error[good]
        frames[active] += 1
        if record is not None:
            record(good)
        fell |= active & sim.fell
        active &= ~(sim.fell | sim.ended)
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
    """A fixed subset that has all kinds of motion in proportion.

    Args:
        clips: what there is, clips or motions.
        count: how many to take at most.
    """
    ordered = sorted(clips, key=lambda clip: (clip.kind, clip.style, clip.name))
    picks = np.unique(np.linspace(0, len(ordered) - 1, min(count, len(ordered))).astype(int))
    return [ordered[i] for i in picks]
