"""The registry entry of a family of kinematic systems; ``registry.py`` collects the entries."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from torch import nn

from agents.kinematic.interface import KinematicSystem
from agents.kinematic.learning import Config, Learning, TaskMaker
from agents.kinematic.scenario import SIX_TRACKERS, Scenario, Variant
from questsim.errors import InputError

HEADS_ALIGNED: tuple[str, ...] = (
    "mpjre_deg", "mpjpe_cm", "mpjve_cm_s", "jitter_100_m_s3",
    "h_pe_cm", "u_pe_cm", "l_pe_cm", "r_pe_cm",
)  # fmt: skip
ROOTS_ALIGNED: tuple[str, ...] = (
    "pos_cm", "rot_deg", "root_cm", "vel_cm_s", "ee_cm", "jitter_100_m_s3", "rot_local_deg",
)  # fmt: skip
CPU = Learning(batch=32, window=42, warm_up=200, bfloat16=True)
"""Small batches in bfloat16: in half an hour on one core, more steps help more than precision."""
SMOKE = Learning(batch=8, evaluate_every=20, steps=60, learning_rate=2e-3)


@dataclass(frozen=True)
class Entry:
    """Everything specific to one family of systems, in one place.

    Attributes:
        title: full name.
        sensors: names of its sensor sets in ``questsim.sensors``.
        presets: ``paper``, ``cpu``, ``smoke``.
        build: creates an untrained module from a spec.
        task: see ``learning.TaskMaker``.
        system: creates the system from module, name, trained stages and options.
        optional: by stage, the switch of the spec that turns the stage off.
        scenarios: its scenarios in a comparison.
        figures: figures in its paper's own tables, as keys of ``agents.comparison.report.LABELS``.
        variants: its paper's ablations.
        ablated_in: names of the scenarios in which the variants are scored.
        paper_ms: milliseconds per frame of the released code on one thread, at the published size.
    """

    title: str
    sensors: tuple[str, ...]
    presets: dict[str, Config]
    build: Callable[[Any], nn.Module]
    task: TaskMaker
    system: Callable[[nn.Module, str, list[str], dict[str, Any]], KinematicSystem]
    optional: dict[str, str] = field(default_factory=dict)
    scenarios: tuple[Scenario, ...] = SIX_TRACKERS
    figures: tuple[str, ...] = ROOTS_ALIGNED
    variants: tuple[Variant, ...] = ()
    ablated_in: tuple[str, ...] = ("6",)
    paper_ms: float | None = None

    def needed(self, config: Config) -> Config:
        """A preset without the stages that its spec turns off; the others share the time."""
        stages = {
            name: learning
            for name, learning in config.stages.items()
            if getattr(config.spec, self.optional.get(name, ""), True)
        }
        whole = sum(learning.share for learning in stages.values())
        if len(stages) == len(config.stages):
            return config
        shared = {name: replace(stage, share=stage.share / whole) for name, stage in stages.items()}
        return replace(config, stages=shared)


def no_options(name: str, options: dict[str, Any], known: tuple[str, ...] = ()) -> None:
    """Refuse options that a system does not have.

    Args:
        name: the system's name, for the message.
        options: the given options.
        known: names of the options that it has.

    Raises:
        InputError: names the first unknown option.
    """
    for option in options:
        if option not in known:
            raise InputError(f"has no option {option!r}", name, f"known: {', '.join(known)}")
