"""What ``questsim ablations`` can ablate: kinematic systems, and QuestSim, the torque policy."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, Protocol

from agents.comparison.costs import plan_costs, run
from agents.comparison.report import Row, row_of
from agents.comparison.run import Plan, simulated, suiting
from agents.kinematic.options import TrainSystemArgs
from agents.kinematic.registry import AGENTS
from agents.kinematic.scenario import Variant
from agents.kinematic.store import CARD_FILE, load_system, read_system_card
from agents.kinematic.training import train_system
from agents.overrides import with_overrides
from agents.policy.checkpoint import CARD_FILE as POLICY_CARD
from agents.policy.checkpoint import read_card
from agents.resolve import resolve
from agents.training.options import TrainArgs
from agents.training.presets import PRESETS, PPOConfig, Preset, StageConfig
from agents.training.train_policy import train
from questsim.errors import InputError
from questsim.motion.motion import Motion
from questsim.reward import PAPER_REWARD, summed

QUESTSIM = "questsim"
"""Name of the torque policy in the command."""
TRUE_START = "from the user's state"
"""Its scenario in the tables."""
PolicyStage = Literal["all", "teacher", "student", "ppo"]
FUTURES = (3, 1, 0)
"""Future frames of the variants; the full policy observes 6."""


class Ablated(Protocol):
    """A family of agents that is trained whole and without parts.

    Attributes:
        figures: keys of the figures in its table.
    """

    figures: Sequence[str]

    def preset(self, name: str, assignments: Sequence[str]) -> Any:
        """A preset with changed values; InputError if one does not fit."""
        ...

    def variants(self, preset: str) -> Sequence[Variant]:
        """Its variants without one part each."""
        ...

    def train(self, options: dict[str, Any]) -> int:
        """Train a variant with these options of the training command; returns the exit code."""
        ...

    def score(
        self, folder: Path, variant: Variant, motions: Sequence[Motion], seed: int
    ) -> list[Row]:
        """The rows of a trained run on recordings at 60 Hz."""
        ...

    def trained(self, folder: Path) -> dict[str, dict[str, float]]:
        """``steps`` and ``minutes`` of each stage of a run."""
        ...


def ablated(name: str, stage: PolicyStage = "all", teacher: Path | None = None) -> Ablated:
    """The family of a name.

    Args:
        name: a kinematic system with variants, or questsim.
        stage: the one stage of QuestSim's training that is ablated, or ``all``.
        teacher: of QuestSim's stage ``student``.

    Raises:
        InputError: it has no ablations, or not such ones.
    """
    known = [*(agent for agent, entry in AGENTS.items() if entry.variants), QUESTSIM]
    if name not in known:
        what = f"there are no ablations of {name!r}"
        raise InputError(what, "--agent", f"use {', '.join(known)}")
    if teacher is not None and stage != "student":
        what = "is for the stage that learns from a teacher"
        raise InputError(what, "--teacher", "add --stage student, or leave it out")
    if teacher is None and stage == "student":
        raise InputError("needs a teacher", "--stage student", "add e.g. --teacher tracker")
    if name == QUESTSIM:
        return PolicyAblated(stage, teacher)
    if stage != "all":
        raise InputError(f"is for {QUESTSIM}", "--stage", "leave it out")
    return SystemAblated(name)


class SystemAblated:
    """A kinematic system.

    Args:
        agent: its family.
    """

    def __init__(self, agent: str) -> None:
        self._agent, self._entry = agent, AGENTS[agent]
        self.figures: Sequence[str] = self._entry.figures

    def preset(self, name: str, assignments: Sequence[str]) -> Any:
        """See ``Ablated``."""
        return with_overrides(self._entry.presets[name], assignments)

    def variants(self, preset: str) -> Sequence[Variant]:
        """See ``Ablated``."""
        return self._entry.variants

    def train(self, options: dict[str, Any]) -> int:
        """See ``Ablated``."""
        return train_system(TrainSystemArgs(agent=self._agent, **options))

    def score(
        self, folder: Path, variant: Variant, motions: Sequence[Motion], seed: int
    ) -> list[Row]:
        """See ``Ablated``."""
        rows = []
        for scenario in load_system(str(folder)).scenarios:
            if scenario.name in self._entry.ablated_in:
                given = replace(scenario, options=(*scenario.options, *variant.options))
                rows.append(run(str(folder), given, motions, seed))
        return rows

    def trained(self, folder: Path) -> dict[str, dict[str, float]]:
        """See ``Ablated``."""
        return _stages(
            read_system_card(p.parent) for p in sorted(folder.glob(f"*/last/{CARD_FILE}"))
        )


class PolicyAblated:
    """QuestSim: the torque policy of ``train.py``, scored from the user's true state.

    Args:
        stage: the one stage that is trained, or ``all``. A teacher has no variants of the devices,
            a student none of the reward.
        teacher: of the stage ``student``.
    """

    figures: Sequence[str] = (
        "success_percent", "mpjpe_cm", "h_pe_cm", "world_cm", "jitter_100_m_s3", "foot_skate_cm_s",
    )  # fmt: skip

    def __init__(self, stage: PolicyStage, teacher: Path | None) -> None:
        self._stage: PolicyStage = stage
        self._teacher = teacher

    def preset(self, name: str, assignments: Sequence[str]) -> Preset:
        """See ``Ablated``."""
        return with_overrides(PRESETS[name], assignments)

    def variants(self, preset: str) -> Sequence[Variant]:
        """See ``Ablated``; those of the reward change the stages that are trained by it."""
        trained = {
            name: stage
            for name, stage in PRESETS[preset].stages.items()
            if (stage.share > 0 if self._stage == "all" else name == self._stage)
        }
        rewarded = {n: s for n, s in trained.items() if isinstance(s.learning, PPOConfig)}
        found = []
        if rewarded:
            what = "errors of the reward are sums over joints and links, as published, not means"
            sums = tuple(part for n, s in rewarded.items() for part in _sums(n, s))
            found += [_contact(rewarded), Variant("sums", what, sums)]
        if set(trained) != {"teacher"}:
            found += [
                Variant(
                    f"future-{n}", f"{n} future frames instead of 6", args=(("future_frames", n),)
                )
                for n in FUTURES
            ]
            found.append(Variant("headset-only", "the controllers", args=(("sensors", "H"),)))
        without = "the stature and bone lengths of the avatar in the observation"
        return (*found, Variant("no-scale", without, _without_scale(trained)))

    def train(self, options: dict[str, Any]) -> int:
        """See ``Ablated``."""
        return train(TrainArgs(**options, stage=self._stage, teacher=self._teacher))

    def score(
        self, folder: Path, variant: Variant, motions: Sequence[Motion], seed: int
    ) -> list[Row]:
        """See ``Ablated``."""
        agent = resolve(folder)
        (scenario,) = suiting(agent)
        plan = Plan(agent, scenario, None, ("user",))
        jobs = [plan.job(motion, seed + i) for i, motion in enumerate(motions)]
        ((_, summaries),) = simulated(plan, jobs, 1, map, {})
        (cost,) = plan_costs(plan, motions, None)
        # One name for all, whatever the sensors: they are compared with each other.
        return [row_of("", TRUE_START, summaries, cost)]

    def trained(self, folder: Path) -> dict[str, dict[str, float]]:
        """See ``Ablated``."""
        return _stages(
            read_card(path.parent) for path in sorted(folder.glob(f"*/last/{POLICY_CARD}"))
        )


def _stages(cards: Any) -> dict[str, dict[str, float]]:
    records = [card["training"] for card in cards]
    return {each["stage"]: {n: each[n] for n in ("steps", "minutes")} for each in records}


def _contact(rewarded: dict[str, StageConfig]) -> Variant:
    """The contact term is removed from a preset that has it, and added to one that does not."""
    there = any(stage.reward.contact for stage in rewarded.values())
    name, weight = ("no-contact", 0.0) if there else ("contact", PAPER_REWARD.contact)
    what = "the reward's contact term" + ("" if there else " is added, with its published weight")
    return Variant(name, what, tuple(f"stages.{n}.reward.contact={weight}" for n in rewarded))


def _sums(name: str, stage: StageConfig) -> list[str]:
    kernels = summed(stage.reward)
    names = [n for n in vars(kernels) if getattr(kernels, n) != getattr(stage.reward, n)]
    return [f"stages.{name}.reward.{n}={json.dumps(getattr(kernels, n))}" for n in names]


def _without_scale(stages: Mapping[str, StageConfig]) -> tuple[str, ...]:
    found = []
    for name, stage in stages.items():
        for side in ("actor_blocks", "critic_blocks"):
            blocks = getattr(stage.policy, side)
            if "o_scale" in blocks:
                left = [block for block in blocks if block != "o_scale"]
                found.append(f"stages.{name}.policy.{side}={json.dumps(left)}")
    return tuple(found)
