"""The worlds table: one agent on terrain, under pushes and with objects that the user lacks.

Avatars have the statures of the clips. The row for other heights scales the clips, and so the
device signals, to the avatar; the user's own height then cancels out.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.agent import Agent
from agents.evaluation.follow import choose_clips, evaluation_sim, follow
from agents.evaluation.mapping import Mapper
from agents.evaluation.rollout import batches_of
from agents.evaluation.standing_pushes import rounded, standing_rows
from agents.run_folder import plain
from envs.config import EnvConfig
from envs.core import BatchSim
from envs.objects import WorldObject
from envs.pushes import Pushes
from envs.terrain import Terrain
from questsim.errors import InputError
from questsim.files import whole_file
from questsim.motion.clip import FPS, Clip
from questsim.statistics import interval

SCHEMA, SCHEMA_VERSION = "questsim-worlds", 1
UP_SHARE = 0.5
"""An avatar is up if its pelvis height is above this share of the reference's pelvis height."""
BALL_MOVED_M = 0.1
RECOVERY_S = 3.0
_BATCH_CLIPS = 160
_SPEED_ENVS, _SPEED_STEPS = 64, 40
_NEVER_LOST_M = 1e6
PUSH = Pushes(force_n=(100.0, 100.0), duration_s=(0.2, 0.2), pause_s=(1.0, 1.0), count=1)
_PUSH_END_S = PUSH.pause_s[1] + PUSH.duration_s[1]
BALL = WorldObject("ball", ahead_s=(1.5, 2.5), aside_m=(0.1, 0.1))
"""Its lateral offset is one foot's breadth from the middle of the path, where a foot passes."""


@dataclass(frozen=True)
class World:
    """A row of the table: one or several settings, and the required success.

    Attributes:
        name: key in ``worlds.json``.
        label: for the table.
        bar: lowest success that passes; None for a row shown only for comparison.
        settings: config changes by name; success is over all clips of all settings.
        walking: use only walking clips, instead of walking, turning, running and gestures.
        success: ``"follow"``: mean link error within the config's limit to the clip's end;
            ``"up"``: still up ``RECOVERY_S`` after the push; ``"ball"``: the ball was moved and
            the avatar is up at the end.
    """

    name: str
    label: str
    bar: float | None
    settings: dict[str, dict[str, Any]]
    walking: bool = False
    success: str = "follow"


def _heights(*metres: float) -> dict[str, dict[str, Any]]:
    return {f"{height:.2f} m": {"heights": (height, height)} for height in metres}


WORLDS: tuple[World, ...] = (
    World("flat", "flat ground, to compare", None, {"flat": {}}),
    World("rough_4cm", "rough ground, ±4 cm at 0.5 m", 0.90, {"rough": {"terrain": Terrain()}}),
    World(
        "rough_8cm",
        "rough ground, ±8 cm at 0.5 m",
        0.75,
        {"rough": {"terrain": Terrain(amplitude_m=0.08)}},
    ),
    World(
        "slope_8deg",
        "slopes of 8°, up, down, across",
        0.85,
        {
            way: {"terrain": Terrain("slope", slope_deg=8.0, direction=way)}
            for way in ("up", "down", "across")
        },
    ),
    World("other_height", "avatar of 1.45 or 1.95 m for a user of 1.70 m", 0.85,
          _heights(1.45, 1.95)),
    World(
        "push_100n",
        "100 N for 0.2 s at the chest while walking, up 3 s later",
        0.80,
        {"push": {"pushes": PUSH}},
        walking=True,
        success="up",
    ),
    World(
        "ball",
        "a ball is kicked while walking",
        0.90,
        {"ball": {"objects": (BALL,)}},
        walking=True,
        success="ball",
    ),
)  # fmt: skip
SPEED_BAR = 0.6
WALKING = next(world for world in WORLDS if world.walking)


def group_of(kind: str) -> str | None:
    """Walking, turning, running or gesture; None for kinds that the table does not use."""
    if "turn" in kind:
        return "turning"
    if kind in ("run", "jog"):
        return "running"
    if kind == "walk":
        return "walking"
    gestures = ("wave", "raise", "whiteboard", "boxing")
    return "gesture" if kind.startswith(gestures) else None


def run_worlds(
    agent: Agent,
    clips: Sequence[Clip],
    config: EnvConfig,
    threads: int = 1,
    max_clips: int | None = None,
    seed: int = 0,
    mapper: Mapper = map,
) -> dict[str, Any]:
    """Run every row of the table.

    Args:
        agent: any agent.
        clips: only walking, turning, running and gesture clips are used.
        config: the environment that the agent needs, with ``fixed_start``.
        threads: physics threads.
        max_clips: largest number of clips in each setting, of all kinds.
        seed: seed of positions, directions and objects; terrain seeds are fixed.
        mapper: runs the batches of a row, here or on workers, with the same bits.

    Returns:
        ``{"rows": [...], "speed": {...}}`` of plain numbers.

    Raises:
        InputError: there is no walking clip.
    """
    if not world_clips(WALKING, clips):
        raise InputError(
            f"no clip of walking lasts {_PUSH_END_S + RECOVERY_S:g} s", "--motions", "add some"
        )
    rows = []
    for world in WORLDS:
        chosen = world_clips(world, clips)
        if max_clips is not None:
            chosen = choose_clips(chosen, max_clips)
        rows.append(world_row(world, agent, chosen, config, threads, seed, mapper))
    grouped = [clip for clip in clips if group_of(clip.kind)]
    rows += standing_rows(agent, config, threads)
    return {"rows": rows, "speed": terrain_speed(grouped, config, threads)}


def world_clips(world: World, clips: Sequence[Clip]) -> list[Clip]:
    """The clips that a row uses."""
    grouped = [clip for clip in clips if group_of(clip.kind)]
    if not world.walking:
        return grouped
    walking = [clip for clip in grouped if group_of(clip.kind) == "walking"]
    return [clip for clip in walking if clip.duration >= _PUSH_END_S + RECOVERY_S]


def world_row(
    world: World,
    agent: Agent,
    clips: Sequence[Clip],
    config: EnvConfig,
    threads: int,
    seed: int,
    mapper: Mapper = map,
) -> dict[str, Any]:
    """A row of the table; the arguments are those of ``run_worlds``, the clips ``world_clips``."""
    parts = {}
    shares = np.zeros(len(clips))
    by_group: dict[str, list[bool]] = {}
    batches = batches_of(clips, _BATCH_CLIPS)
    jobs = [
        (world.success, agent, [clips[i] for i in batch], replace(config, **changes), threads, seed)
        for changes in world.settings.values()
        for batch in batches
    ]
    results = iter(mapper(_good, jobs))
    for name in world.settings:
        good = np.zeros(len(clips), bool)
        for batch in batches:
            good[batch] = next(results)
        parts[name] = {"clips": len(clips), "succeeded": int(good.sum())}
        shares += good / len(world.settings)
        for clip, succeeded in zip(clips, good, strict=True):
            by_group.setdefault(group_of(clip.kind) or "", []).append(bool(succeeded))
    clips_run = sum(part["clips"] for part in parts.values())
    succeeded = sum(part["succeeded"] for part in parts.values())
    success = succeeded / clips_run
    return {
        "name": world.name,
        "label": world.label,
        "clips": clips_run,
        "succeeded": succeeded,
        "success": round(success, 4),
        "interval": rounded(interval(shares)),
        "bar": world.bar,
        "reached": None if world.bar is None else success >= world.bar,
        "settings": parts,
        "by_group": {k: round(float(np.mean(v)), 4) for k, v in sorted(by_group.items())},
    }


def _good(job: tuple[str, Agent, list[Clip], EnvConfig, int, int]) -> np.ndarray:
    """Success of each clip of a batch ``(C,)`` bool."""
    success, agent, clips, config, threads, seed = job
    if success != "follow":
        config = replace(config, max_error_m=_NEVER_LOST_M)
    sim = evaluation_sim(clips, config, threads, seed)
    try:
        agent.bind(sim)
        watch = _Watch(sim, clips)
        followed = follow(agent, sim, clips, watch)
    finally:
        sim.close()
    good = ~followed.fell
    if success == "up":
        good &= watch.up_at(round((_PUSH_END_S + RECOVERY_S) * FPS))
    elif success == "ball":
        good &= watch.up_at(None) & (watch.ball_moved_m > BALL_MOVED_M)
    return good


class _Watch:
    """Records in every step of a batch which avatars are up and how far the ball has moved."""

    def __init__(self, sim: BatchSim, clips: Sequence[Clip]) -> None:
        self._sim = sim
        self._last = np.array([len(clip) - 1 for clip in clips])
        self._wanted = [clip.qpos[:, 2] / clip.height_m for clip in clips]
        self._up: list[np.ndarray] = []
        self._ball_from: np.ndarray | None = None
        self.ball_moved_m = np.zeros(len(clips))

    def __call__(self, keep: np.ndarray) -> None:
        sim, at = self._sim, len(self._up)
        reference = np.array(
            [w[min(at, last)] for w, last in zip(self._wanted, self._last, strict=True)]
        )
        above = sim.link_positions[:, 0, 2] - sim.floor
        self._up.append((above > UP_SHARE * reference * sim.heights) & np.isfinite(above))
        if sim.objects.pose.shape[1]:
            place = sim.objects.pose[:, 0, :2]
            if self._ball_from is None:
                self._ball_from = place.copy()
            moved = np.linalg.norm(place - self._ball_from, axis=-1)
            self.ball_moved_m = np.where(keep, np.maximum(moved, self.ball_moved_m),
                                         self.ball_moved_m)  # fmt: skip

    def up_at(self, frame: int | None) -> np.ndarray:
        """Avatars that are up at a frame, ``(C,)`` bool; None for the end of each clip."""
        up = np.array(self._up)
        at = self._last if frame is None else np.minimum(frame, self._last)
        return up[at, np.arange(len(at))]


def terrain_speed(
    clips: Sequence[Clip], config: EnvConfig, threads: int, steps: int = _SPEED_STEPS
) -> dict[str, Any]:
    """Ratio of environment steps/s on rough and on flat ground, stepped alternately.

    Both use the same clips. Springs towards the straight pose keep the avatars standing and
    stumbling for a while. The median of the ratios of single steps is robust to a busy machine.
    """
    options: dict[str, Any] = {"fixed_start": False, "max_error_m": 0.5}
    sims = [
        BatchSim(clips, replace(config, terrain=ground, **options), _SPEED_ENVS, 0, threads)
        for ground in (None, Terrain())
    ]
    gain = 4.0 * sims[0].body.damping / 0.04 / sims[0].body.torque_limits
    for sim in sims:
        sim.reset()
    ratios = []
    for step in range(steps + 5):
        seconds = []
        for sim in sims:
            action = -gain * sim.joint_angles
            began = time.perf_counter()
            sim.step(action)
            seconds.append(time.perf_counter() - began)
            done = np.flatnonzero(sim.fell | sim.ended)
            if len(done):
                sim.reset(done)
        if step >= 5:  # the first steps compile and fill caches
            ratios.append(seconds[0] / seconds[1])
    for sim in sims:
        sim.close()
    ratio = float(np.median(ratios))
    return {"ratio_to_flat": round(ratio, 3), "bar": SPEED_BAR, "reached": ratio >= SPEED_BAR}


def format_worlds(table: dict[str, Any]) -> str:
    """The table as text; the interval is of 95 %, over clips."""
    lines = [f"{'world':58}  {'clips':>5}  success      interval      bar"]
    for row in table["rows"]:
        bar = "" if row["bar"] is None else f"{row['bar']:7.0%}"
        verdict = {True: "reached", False: "missed", None: ""}[row["reached"]]
        ends = row.get("interval")
        between = "" if ends is None else f"{100 * ends[0]:.1f} to {100 * ends[1]:.1f}"
        figures = f"{row['clips']:5}  {row['success']:7.1%}  {between:>12}  {bar:>7}  {verdict}"
        lines.append(f"{row['label']:58}  {figures}".rstrip())
    speed = table["speed"]
    verdict = "reached" if speed["reached"] else "missed"
    lines.append(
        f"{'environment steps/s, rough over flat ground':58}  {'':5}  "
        f"{speed['ratio_to_flat']:7.2f}  {'':12}  {speed['bar']:7.2f}  {verdict}"
    )
    return "\n".join(lines)


def write_worlds(table: dict[str, Any], folder: Path, context: dict[str, Any]) -> Path:
    """Write ``worlds.json`` atomically: readers see the old file or the complete new one.

    Args:
        table: the result of ``run_worlds``.
        folder: created if needed.
        context: agent, motions, configuration, versions and hashes.

    Returns:
        The file's path.
    """
    path = folder / "worlds.json"
    record = {"schema": SCHEMA, "version": SCHEMA_VERSION, "context": plain(context), **table}
    folder.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        Path(temporary).write_text(json.dumps(record, indent=2) + "\n")
    return path
