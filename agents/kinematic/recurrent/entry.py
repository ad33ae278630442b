"""Registry entries of HMD-Poser and LGSIK-Poser: presets, scenarios and ablations."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from torch import nn

from agents.kinematic.entry import CPU, HEADS_ALIGNED, SMOKE, Entry, no_options
from agents.kinematic.interface import KinematicSystem
from agents.kinematic.learning import Config, Learning
from agents.kinematic.recurrent.hmdposer import HmdPoserSpec
from agents.kinematic.recurrent.lgsik import LgsikSpec
from agents.kinematic.recurrent.poser import RecurrentModule, RecurrentPoser
from agents.kinematic.recurrent.training import HMDPOSER_WEIGHTS, make_task
from agents.kinematic.scenario import PAPER_NAMES, Scenario, Variant
from agents.kinematic.training_faults import EXACT
from questsim.sensors import SENSOR_SETS

_SETS = tuple(PAPER_NAMES)
SCENARIOS = tuple(
    Scenario(PAPER_NAMES[key] + (", window 40" if online else ""), SENSOR_SETS[key], online=online)
    for online in (False, True)
    for key in _SETS
)
_ABLATED_IN = tuple(PAPER_NAMES[key] for key in _SETS)


def _system(
    module: nn.Module, name: str, trained: list[str], options: dict[str, Any]
) -> KinematicSystem:
    assert isinstance(module, RecurrentModule)
    no_options(name, options)
    return RecurrentPoser(module, name)


def _entry(
    title: str,
    paper: Config,
    cpu: Any,
    smoke: Any,
    variants: tuple[Variant, ...],
    paper_ms: float,
    weights: dict[str, float],
) -> Entry:
    """An entry; ``cpu`` and ``smoke`` are the specs of these presets; all share ``weights``."""
    presets = {
        "paper": paper,
        "cpu": Config(cpu, {"network": CPU}),
        "smoke": Config(smoke, {"network": replace(SMOKE, window=18)}, validation=12),
    }
    for name, preset in presets.items():
        network = replace(preset.stages["network"], weights=weights, noise=EXACT)
        presets[name] = replace(preset, stages={"network": network})
    return Entry(
        title,
        _SETS,
        presets,
        RecurrentModule,
        make_task,
        _system,
        scenarios=SCENARIOS,
        figures=HEADS_ALIGNED,
        variants=variants,
        ablated_in=_ABLATED_IN,
        paper_ms=paper_ms,
    )


HMDPOSER = _entry(
    "HMD-Poser (Dai et al., CVPR 2024)",
    paper=Config(
        HmdPoserSpec(),
        {
            "network": Learning(
                optimiser="adam",
                schedule="step",
                final_rate=0.1,
                batch=256,
                window=42,
                clip=None,
                epochs=400,
            )
        },
    ),
    cpu=HmdPoserSpec(size=96, layers=1, heads=4, feed_forward=256, head_hidden=192, dropout=0.0),
    smoke=HmdPoserSpec(size=32, blocks=1, layers=1, heads=4, feed_forward=32, head_hidden=32),
    variants=(
        Variant(
            "no-hands-in-head",
            "no tokens of the hands as seen from the head (HMD-Poser)",
            set=("spec.hands_in_head=false",),
        ),
        Variant(
            "no-shape-head",
            "bones are not estimated: all users have the mean body (HMD-Poser)",
            set=("spec.shape_head=false",),
        ),
        Variant(
            "no-acceleration-loss",
            "the loss has no term for accelerations (HMD-Poser)",
            set=("stages.network.weights.acceleration=0",),
        ),
        Variant(
            "no-joint-loss",
            # Bones are learnt from joint positions alone: without them no shape can be estimated.
            "the loss has no term for joint positions; all users have the mean body (HMD-Poser)",
            set=("stages.network.weights.joints=0", "spec.shape_head=false"),
        ),
        Variant(
            "no-global-loss",
            "the loss has no term for orientations in the world (HMD-Poser)",
            set=("stages.network.weights.global=0",),
        ),
        Variant(
            "narrow",
            "48 features a token (HMD-Poser)",
            set=("spec.size=48",),
        ),
    ),
    paper_ms=17.0,
    weights=HMDPOSER_WEIGHTS,
)

LGSIK = _entry(
    "LGSIK-Poser (2025)",
    paper=Config(
        LgsikSpec(),
        {
            "network": Learning(
                schedule="plateau",
                final_rate=0.1,
                window=42,
                clip=None,
                epochs=150,
                stride=20,
            )
        },
    ),
    cpu=LgsikSpec(size=64, hidden=(256, 128), shape_hidden=128),
    smoke=LgsikSpec(size=16, hidden=(32, 32), shape_hidden=16),
    variants=(
        Variant(
            "no-graph",
            "no graph convolutions: the six parts are independent (LGSIK-Poser)",
            set=("spec.graph=false",),
        ),
        Variant(
            "no-ik-heads",
            "one plain head for all joints in place of the parts' IK heads (LGSIK-Poser)",
            set=("spec.ik_heads=false",),
        ),
        Variant(
            "no-shape-group",
            "measurements are not read; bones are estimated from motion alone (LGSIK-Poser)",
            set=("spec.shape_group=false",),
        ),
        Variant(
            "supervised-lengths",
            "the true bone lengths supervise the shape, too; the paper's loss does not know them",
            set=("spec.loss=lgsik-lengths",),
        ),
        Variant(
            "hmdposer-loss",
            "trained by HMD-Poser's loss in place of its own (LGSIK-Poser)",
            set=("spec.loss=hmdposer",),
        ),
    ),
    paper_ms=8.0,
    weights={},
)
