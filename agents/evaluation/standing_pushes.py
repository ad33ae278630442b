"""Rows of the worlds table: pushes from every direction on a standing avatar."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from agents.agent import Agent
from envs.config import EnvConfig
from envs.core import BatchSim
from questsim.motion.clip import FPS, Clip
from questsim.statistics import interval

DIRECTIONS = 16
NEAR_M = 0.10
"""Largest mean link error in metres ..."""
AFTER_S = 3.0
"""... this long after the push."""
_BEGIN_S, _FOR_S = 1.0, 0.2
BARS: dict[int, float] = {60: 1.0, 100: 0.95, 150: 0.75}
"""Least success by force in newtons."""
_NEVER_LOST_M = 1e6


def standing_rows(agent: Agent, config: EnvConfig, threads: int = 1) -> list[dict[str, Any]]:
    """Rows in the format of ``worlds.run_worlds``, on the embedded standing clip.

    Args:
        agent: any agent.
        config: the environment it needs.
        threads: physics threads.
    """
    clip = long_standing_clip()
    rows = []
    for force_n, bar in BARS.items():
        near = pushed(agent, clip, config, float(force_n), threads)
        success = float(near.mean())
        rows.append(
            {
                "name": f"standing_push_{force_n}n",
                "label": f"{force_n} N for 0.2 s while standing, within 10 cm 3 s later",
                "clips": DIRECTIONS,
                "succeeded": int(near.sum()),
                "success": round(success, 4),
                "interval": rounded(interval(near.astype(float))),
                "bar": bar,
                "reached": success >= bar,
                "settings": {"push": {"clips": DIRECTIONS, "succeeded": int(near.sum())}},
                "by_group": {"standing": round(success, 4)},
            }
        )
    return rows


def rounded(ends: tuple[float, float] | None) -> list[float] | None:
    """An interval for a record."""
    return None if ends is None else [round(end, 4) for end in ends]


def long_standing_clip() -> Clip:
    """An embedded clip of standing, long enough for push and recovery."""
    from questsim.motion.spec import load_motions

    needed_s = _BEGIN_S + _FOR_S + AFTER_S
    return next(c for c in load_motions("synthetic:stand") if c.duration > needed_s + 0.1)


def pushed(
    agent: Agent, clip: Clip, config: EnvConfig, force_n: float, threads: int = 1
) -> np.ndarray:
    """Push the chest in 16 directions; ``(16,)`` bool, whether the avatar recovered.

    Args:
        agent: any agent.
        clip: a standing clip, long enough for push and recovery.
        config: the environment that the agent needs.
        force_n: push force in N.
        threads: physics threads.
    """
    clips: Sequence[Clip] = [replace(clip, name=f"{clip.name}-{i}") for i in range(DIRECTIONS)]
    config = replace(config, fixed_start=True, max_error_m=_NEVER_LOST_M, pushes=None)
    sim = BatchSim(clips, config, DIRECTIONS, 0, threads)
    try:
        agent.bind(sim)
        sim.reset()
        agent.reset(DIRECTIONS)
        failed = np.zeros(DIRECTIONS, bool)
        for frame in range(round((_BEGIN_S + _FOR_S + AFTER_S) * FPS)):
            if frame == round(_BEGIN_S * FPS):
                for i in range(DIRECTIONS):
                    turn = 2.0 * np.pi * i / DIRECTIONS
                    force = force_n * np.array([np.cos(turn), np.sin(turn), 0.0])
                    sim.pusher.push(i, force, _FOR_S)
            sim.step(agent.act(sim.observation))
            failed |= sim.unstable
        return (sim.error < NEAR_M) & ~failed
    finally:
        sim.close()
