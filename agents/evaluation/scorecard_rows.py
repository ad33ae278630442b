"""The scorecard's trials and bars: data of ``agents.evaluation.scorecard``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from agents.evaluation.standing_pushes import BARS as PUSH_BARS
from agents.evaluation.worlds import WORLDS, World
from envs.objects import WorldObject
from envs.randomisation import REAL_DEVICES
from envs.starts import WHOLLY

FRESH_SEED = 2026
"""Seed of the embedded clips; training uses seed 0."""
HELD_OUT_CLIPS = 40
EXTRA = "extra"
"""Trial of the motions of ``--extra``."""


@dataclass(frozen=True)
class Trial:
    """One evaluation of the scorecard.

    Attributes:
        suffix: suffix of the agent's name; each sensor set has its own policy.
        height_m: stature that avatar and clips are scaled to; None for the clips' own.
        says: label in the table.
        motions: what to follow; None for the scorecard's ``--motions``.
        seed: seed of embedded motions; None for the scorecard's.
        changes: fields of the environment that differ.
        estimate: whether episodes begin in the first estimate of a kinematic system.
        world: a row of the worlds table instead of a plain evaluation.
        push_n: pushes of this force on a standing avatar instead of a plain evaluation.
    """

    suffix: str = ""
    height_m: float | None = None
    says: str = ""
    motions: str | None = None
    seed: int | None = None
    changes: Mapping[str, Any] = field(default_factory=dict)
    estimate: bool = False
    world: World | None = None
    push_n: int | None = None


@dataclass(frozen=True)
class Bar:
    """A metric with its minimum requirement (bar) and its target (goal).

    Attributes:
        trial: name in ``TRIALS``.
        metric: key of the report; ``success`` is over all clips, the others over completed clips.
        bar, goal: in the metric's unit; success in percent.
        below: trial to which bar and goal are relative: points by which success may be lower.
        tracker: bar and goal of a policy that observes the whole body, if they differ.
    """

    trial: str
    metric: str
    bar: float
    goal: float
    below: str | None = None
    tracker: tuple[float, float] | None = None

    def of(self, tracker: bool) -> Bar:
        """The bar of a policy that observes the whole body (``tracker``), or devices."""
        if not tracker or self.tracker is None:
            return replace(self, tracker=None)
        return replace(self, bar=self.tracker[0], goal=self.tracker[1], tracker=None)

    def reached(self, value: float | None, limit: float) -> bool:
        """Whether a figure satisfies a limit."""
        if value is None:
            return False
        return value >= limit if self.metric == "success" else value <= limit


def _blocked(name: str, label: str, motions: str | None = None) -> Trial:
    world = World(name, label, None, {name: {"objects": (WorldObject(name),)}}, walking=True)
    if motions is None:
        return Trial(says=label, world=world)
    return Trial(says=label, motions=motions, changes={"objects": (WorldObject(name),)})


TRIALS: dict[str, Trial] = {
    "h2c": Trial(says="headset and controllers"),
    "headset": Trial("-headset", says="headset only"),
    "now": Trial("-now", says="headset and controllers, no future frames"),
    "short": Trial(height_m=1.45, says="headset and controllers, 1.45 m"),
    "tall": Trial(height_m=1.95, says="headset and controllers, 1.95 m"),
    "fresh": Trial(says="embedded clips, fresh seed", motions="synthetic:all", seed=FRESH_SEED),
    "held-out": Trial(
        says="embedded kinds not in training",
        motions=f"synthetic:held-out:{HELD_OUT_CLIPS}",
        seed=FRESH_SEED,
    ),
    EXTRA: Trial(says="motions of --extra"),
    "standing": Trial(says="standing start", changes={"starts": WHOLLY["standing"]}),
    "estimate": Trial(
        says="start from a settled estimate", changes={"starts": WHOLLY["estimate"]}, estimate=True
    ),
    "noise": Trial(
        says="noise, mounts off, jitter, dropouts", changes={"randomisation": REAL_DEVICES}
    ),
    "taller": Trial(says="avatar 15 cm taller, unscaled", changes={"unscaled_m": 0.15}),
    "smaller": Trial(says="avatar 15 cm smaller, unscaled", changes={"unscaled_m": -0.15}),
    **{
        f"push-{force}n": Trial(says=f"{force} N for 0.2 s while standing", push_n=force)
        for force in PUSH_BARS
    },
    **{
        world.name: Trial(says=world.label, world=world)
        for world in WORLDS
        if world.name in ("rough_4cm", "rough_8cm", "slope_8deg", "push_100n", "ball")
    },
    "chair": _blocked("chair", "sitting down on a chair", "synthetic:sit"),
    "hurdle": _blocked("hurdle", "walking into a hurdle"),
    "box": _blocked("box", "walking into a box"),
}

BARS: tuple[Bar, ...] = (
    Bar("h2c", "success", 97.0, 99.0),
    Bar("h2c", "mpjpe_cm", 3.4, 3.0),
    Bar("h2c", "mpjre_deg", 8.0, 5.7),
    Bar("h2c", "root_cm", 2.5, 1.8),
    Bar("h2c", "sip_deg", 12.3, 10.0),
    Bar("h2c", "jitter_km_s3", 0.5, 0.3),
    Bar("h2c", "mhpe_cm", 4.2, 3.7),
    Bar("h2c", "mhre_deg", 10.0, 8.4),
    Bar("headset", "success", 94.0, 98.0),
    Bar("now", "success", 95.0, 98.0),
    Bar("short", "success", 90.0, 97.0),
    Bar("tall", "success", 90.0, 97.0),
    Bar("fresh", "success", 90.0, 98.0),
    Bar("held-out", "success", 75.0, 90.0),
    Bar(EXTRA, "success", 55.0, 80.0, tracker=(70.0, 90.0)),
    Bar("standing", "success", 93.0, 97.0),
    Bar("estimate", "success", 95.0, 98.0),
    Bar("noise", "success", 3.0, 1.0, below="h2c"),
    Bar("taller", "success", 85.0, 95.0),
    Bar("smaller", "success", 85.0, 95.0),
    Bar("push-60n", "success", 100.0, 100.0),
    Bar("push-100n", "success", 95.0, 100.0),
    Bar("push-150n", "success", 75.0, 95.0),
    Bar("rough_4cm", "success", 95.9, 99.0),
    Bar("rough_8cm", "success", 82.0, 92.0),
    Bar("slope_8deg", "success", 93.7, 99.0),
    Bar("push_100n", "success", 89.0, 99.0),
    Bar("ball", "success", 100.0, 100.0),
    Bar("chair", "success", 80.0, 100.0),
    Bar("hurdle", "success", 60.0, 90.0),
    Bar("box", "success", 90.0, 100.0),
)
"""Bars of the project on bandai-namco-2:test unless a trial names its own motions."""
