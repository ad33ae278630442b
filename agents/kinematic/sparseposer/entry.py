"""SparsePoser's registry entry: presets, scenarios and ablations."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from torch import nn

from agents.kinematic.entry import CPU, ROOTS_ALIGNED, SMOKE, Entry, no_options
from agents.kinematic.interface import KinematicSystem
from agents.kinematic.learning import Config, Learning
from agents.kinematic.scenario import Scenario, Variant
from agents.kinematic.sparseposer.networks import SparsePoserModule, SparsePoserSpec
from agents.kinematic.sparseposer.poser import SparsePoser
from agents.kinematic.sparseposer.training import WEIGHTS, make_task
from agents.kinematic.training_faults import EXACT
from questsim.sensors import SENSOR_SETS

_SIX = SENSOR_SETS["6T"]
SCENARIOS = (
    Scenario("6", _SIX),
    Scenario("6, 7 frames late", _SIX, options=(("future_frames", 7),)),
)
_PAPER = Learning(
    learning_rate=1e-4, final_rate=1.0, batch=256, window=64, clip=None, epochs=500, stride=8,
    noise=EXACT,
)  # fmt: skip


def _system(
    module: nn.Module, name: str, trained: list[str], options: dict[str, Any]
) -> KinematicSystem:
    assert isinstance(module, SparsePoserModule)
    no_options(name, options, ("future_frames", "learned_ik"))
    return SparsePoser(module, name, **{"learned_ik": "ik" in trained, **options})


SPARSEPOSER = Entry(
    "SparsePoser (Ponton, Yun et al., ACM TOG 2023)",
    ("6T",),
    {
        "paper": Config(
            SparsePoserSpec(),
            {
                "generator": replace(_PAPER, share=0.8),
                "ik": replace(_PAPER, share=0.2, weights=WEIGHTS),
            },
        ),
        "cpu": Config(
            SparsePoserSpec(channels=(8, 12, 20, 32), kernel=9),
            {
                "generator": replace(CPU, share=0.75, window=64, noise=EXACT),
                "ik": Learning(share=0.25, batch=32, window=64, weights=WEIGHTS, noise=EXACT),
            },
        ),
        "smoke": Config(
            SparsePoserSpec(channels=(8, 8, 8, 8), kernel=5, ik_hidden=32),
            {
                "generator": replace(SMOKE, share=0.7, window=64, noise=EXACT),
                "ik": replace(SMOKE, share=0.3, window=64, weights=WEIGHTS, noise=EXACT),
            },
            validation=12,
        ),
    },
    SparsePoserModule,
    make_task,
    _system,
    {"ik": "learned_ik"},
    scenarios=SCENARIOS,
    figures=ROOTS_ALIGNED,
    variants=(
        Variant(
            "no-learned-ik",
            "the generator's limbs as they are (SparsePoser: without learned IK)",
            options=(("learned_ik", False),),
        ),
        Variant(
            "no-regularisation",
            "lambda 0 in learned IK's loss: limbs may leave the generator's pose (SparsePoser)",
            set=("stages.ik.weights.keep=0",),
        ),
        Variant(
            "no-skeleton",
            "plain convolutions and products in place of skeletal ones, pooling and unpooling "
            "(SparsePoser: without skeletal operations)",
            set=("spec.skeletal=false",),
        ),
    ),
    paper_ms=27.0,
)
