"""DragPoser's registry entry: presets, scenarios and ablations."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from torch import nn

from agents.kinematic.dragposer.networks import DragPoserModule, DragPoserSpec
from agents.kinematic.dragposer.published import PublishedDragPoser
from agents.kinematic.dragposer.together import ManyDragPoser
from agents.kinematic.dragposer.training import WEIGHTS, make_task
from agents.kinematic.entry import ROOTS_ALIGNED, SMOKE, Entry, no_options
from agents.kinematic.interface import KinematicSystem
from agents.kinematic.learning import Config, Learning
from agents.kinematic.scenario import HANDS, SIX, Scenario, Variant

SCENARIOS: tuple[Scenario, ...] = (
    Scenario("3 head+hands", ("headset", *HANDS)),
    Scenario("3 hip+hands", ("pelvis_tracker", *HANDS)),
    Scenario("4", SIX[:4]),
    Scenario("5 no left foot", (*SIX[:4], "right_foot_tracker")),
    Scenario("6", SIX),
    Scenario("6, 1 iteration", SIX, options=(("iterations", 1),)),
    Scenario("6 position only", SIX, options=(("rotations", False),)),
    Scenario("4, no predictor", SIX[:4], options=(("predictor", False),)),
    Scenario("4, published solver", SIX[:4], options=(("published", True),)),
    Scenario("6, published solver", SIX, options=(("published", True),)),
    Scenario("faulty 0.5 %", SIX, faults=0.005),
    Scenario("faulty 1 %", SIX, faults=0.01),
)
"""Scenarios of DragPoser's table 2, one with a single iteration per frame, one without the temporal
predictor (its figure 6), and the solver as
published on the same weights."""


def _system(
    module: nn.Module, name: str, trained: list[str], options: dict[str, Any]
) -> KinematicSystem:
    assert isinstance(module, DragPoserModule)
    known = ("iterations", "predictor", "constraints", "rotations")
    chosen = {"predictor": "predictor" in trained, **options}
    if chosen.pop("published", module.spec.published):
        no_options(name, options, (*known, "published", "predicted_frames"))
        return PublishedDragPoser(module, name, solver="adam", **chosen)
    no_options(name, options, (*known, "published", "solver"))
    return ManyDragPoser(module, name, **chosen)


DRAGPOSER = Entry(
    "DragPoser (Ponton et al., 2024)",
    ("3T", "4T", "6T"),
    {
        "paper": Config(
            DragPoserSpec(solver="adam", published=True),
            {
                "vae": Learning(
                    share=0.5,
                    learning_rate=1e-4,
                    final_rate=1.0,
                    batch=64,
                    window=3,
                    clip=100.0,
                    weights=WEIGHTS,
                ),
                "predictor": Learning(
                    share=0.5,
                    final_rate=1.0,
                    batch=512,
                    window=129,
                    clip=None,
                    epochs=80,
                    stride=16,
                ),
            },
        ),
        "cpu": Config(
            DragPoserSpec(feed_forward=256, encoder_layers=2, decoder_layers=2),
            {
                "vae": Learning(share=0.6, batch=256, window=3, clip=10.0, weights=WEIGHTS),
                "predictor": Learning(share=0.4, batch=32, window=129, warm_up=200),
            },
        ),
        "smoke": Config(
            DragPoserSpec(feed_forward=32, encoder_layers=1, decoder_layers=1),
            {
                "vae": replace(
                    SMOKE,
                    share=0.5,
                    batch=32,
                    window=3,
                    clip=10.0,
                    weights=WEIGHTS,
                ),
                "predictor": replace(SMOKE, share=0.5, window=129),
            },
            validation=12,
        ),
    },
    DragPoserModule,
    make_task,
    _system,
    {"predictor": "predictor"},
    scenarios=SCENARIOS,
    figures=ROOTS_ALIGNED,
    variants=(
        Variant(
            "no-continuity",
            "no continuity loss in the autoencoder's training (DragPoser)",
            set=("stages.vae.weights.continuity=0",),
        ),
        Variant(
            "no-predictor",
            "the last latent is expected again, not what the temporal predictor says (DragPoser)",
            options=(("predictor", False),),
        ),
    ),
    paper_ms=30.0,
)
