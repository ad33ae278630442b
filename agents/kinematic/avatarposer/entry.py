"""AvatarPoser's registry entry: presets, scenario and ablation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from torch import nn

from agents.kinematic.avatarposer.poser import (
    DEVICES,
    WINDOW,
    AvatarPoser,
    AvatarPoserModule,
    AvatarPoserSpec,
    make_task,
)
from agents.kinematic.entry import CPU, HEADS_ALIGNED, SMOKE, Entry, no_options
from agents.kinematic.interface import KinematicSystem
from agents.kinematic.learning import Config, Learning
from agents.kinematic.scenario import PAPER_NAMES, Scenario, Variant
from agents.kinematic.training_faults import EXACT

_SET = "H+2C"
_WINDOW = WINDOW + 2
"""Frames of a training window with those before it that features need."""


def _system(
    module: nn.Module, name: str, trained: list[str], options: dict[str, Any]
) -> KinematicSystem:
    assert isinstance(module, AvatarPoserModule)
    no_options(name, options, ("refined",))
    return AvatarPoser(module, name, **options)


AVATARPOSER = Entry(
    "AvatarPoser (Jiang et al., ECCV 2022)",
    (_SET,),
    {
        "paper": Config(
            AvatarPoserSpec(),
            {
                "network": Learning(
                    optimiser="adam",
                    learning_rate=1e-4,
                    schedule="halving",
                    final_rate=0.5,
                    batch=256,
                    window=_WINDOW,
                    clip=None,
                    steps=420_000,
                    noise=EXACT,
                )
            },
        ),
        "cpu": Config(
            AvatarPoserSpec(size=128, feed_forward=256, dropout=0.0),
            {"network": replace(CPU, window=_WINDOW, noise=EXACT)},
        ),
        "smoke": Config(
            AvatarPoserSpec(size=32, layers=1, heads=4, feed_forward=32),
            {"network": replace(SMOKE, window=18, noise=EXACT)},
            validation=12,
        ),
    },
    AvatarPoserModule,
    make_task,
    _system,
    scenarios=(Scenario(PAPER_NAMES[_SET], DEVICES),),
    figures=HEADS_ALIGNED,
    variants=(
        Variant(
            "no-refinement",
            "the network's arms, without inverse kinematics (AvatarPoser)",
            options=(("refined", False),),
        ),
    ),
    ablated_in=(PAPER_NAMES[_SET],),
)
