"""Every kinematic agent that is trained: its presets, networks, system and stages of training."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from torch import nn

from agents.kinematic.dragposer import networks as dragposer
from agents.kinematic.dragposer import training as drag_training
from agents.kinematic.dragposer.solver import DragPoser
from agents.kinematic.interface import KinematicSystem
from agents.kinematic.learning import Config, Learning, TaskMaker
from agents.kinematic.recurrent import poser as recurrent
from agents.kinematic.recurrent.hmdposer import HmdPoserSpec
from agents.kinematic.recurrent.lgsik import LgsikSpec
from agents.kinematic.sparseposer import poser as sparseposer
from agents.kinematic.sparseposer import training as sparse_training
from questsim.errors import InputError


@dataclass(frozen=True)
class Entry:
    """One agent.

    Attributes:
        title: its name in full.
        sensors: the named sets of ``questsim.sensors`` that it reads.
        presets: ``paper``, ``cpu``, ``smoke``.
        build: an untrained module of a spec.
        task: see ``learning.TaskMaker``.
        system: of module, name, stages trained, and options.
        optional: stages that are left out where this switch of the spec is off.
    """

    title: str
    sensors: tuple[str, ...]
    presets: dict[str, Config]
    build: Callable[[Any], nn.Module]
    task: TaskMaker
    system: Callable[[nn.Module, str, list[str], dict[str, Any]], KinematicSystem]
    optional: dict[str, str] = field(default_factory=dict)

    def needed(self, config: Config) -> Config:
        """A preset without the stages that its spec does without; the others share the time."""
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


def _no_options(name: str, options: dict[str, Any], known: tuple[str, ...] = ()) -> None:
    for option in options:
        if option not in known:
            raise InputError(f"has no option {option!r}", name, f"known: {', '.join(known)}")


def _recurrent(
    module: nn.Module, name: str, trained: list[str], options: dict[str, Any]
) -> KinematicSystem:
    assert isinstance(module, recurrent.RecurrentModule)
    _no_options(name, options)
    return recurrent.RecurrentPoser(module, name)


def _sparse(
    module: nn.Module, name: str, trained: list[str], options: dict[str, Any]
) -> KinematicSystem:
    assert isinstance(module, sparseposer.SparsePoserModule)
    _no_options(name, options, ("future_frames", "learned_ik"))
    return sparseposer.SparsePoser(module, name, **{"learned_ik": "ik" in trained, **options})


def _drag(
    module: nn.Module, name: str, trained: list[str], options: dict[str, Any]
) -> KinematicSystem:
    assert isinstance(module, dragposer.DragPoserModule)
    _no_options(name, options, ("iterations", "solver", "predictor", "constraints", "rotations"))
    return DragPoser(module, name, **{"predictor": "predictor" in trained, **options})


_HMD_SETS = ("H+2C", "H+2C+2IMU", "H+2C+3IMU")
_CPU = Learning(batch=32, window=42, warm_up=200, bfloat16=True)
"""Small batches in bfloat16: in half an hour on one core, many steps do more than exact ones."""
_SMOKE = Learning(batch=8, evaluate_every=20, steps=60, learning_rate=2e-3)

AGENTS: dict[str, Entry] = {
    "hmdposer": Entry(
        "HMD-Poser (Dai et al., CVPR 2024)",
        _HMD_SETS,
        {
            "paper": Config(
                HmdPoserSpec(),
                {
                    "network": Learning(
                        optimiser="adam",
                        schedule="step",
                        final_rate=0.1,
                        batch=256,
                        window=42,
                        clip=None,
                    )
                },
            ),
            "cpu": Config(
                HmdPoserSpec(
                    size=96, layers=1, heads=4, feed_forward=256, head_hidden=192, dropout=0.0
                ),
                {"network": _CPU},
            ),
            "smoke": Config(
                HmdPoserSpec(size=32, blocks=1, layers=1, heads=4, feed_forward=32, head_hidden=32),
                {"network": replace(_SMOKE, window=18)},
                validation=12,
            ),
        },
        recurrent.RecurrentModule,
        recurrent.make_task,
        _recurrent,
    ),
    "lgsik": Entry(
        "LGSIK-Poser (2025)",
        _HMD_SETS,
        {
            "paper": Config(
                LgsikSpec(),
                {"network": Learning(schedule="plateau", final_rate=0.1, window=42, clip=None)},
            ),
            "cpu": Config(
                LgsikSpec(size=64, hidden=(256, 128), shape_hidden=128),
                {"network": _CPU},
            ),
            "smoke": Config(
                LgsikSpec(size=16, hidden=(32, 32), shape_hidden=16),
                {"network": replace(_SMOKE, window=18)},
                validation=12,
            ),
        },
        recurrent.RecurrentModule,
        recurrent.make_task,
        _recurrent,
    ),
    "sparseposer": Entry(
        "SparsePoser (Ponton, Yun et al., ACM TOG 2023)",
        ("6T",),
        {
            "paper": Config(
                sparseposer.SparsePoserSpec(),
                {
                    "generator": Learning(
                        share=0.8,
                        learning_rate=1e-4,
                        final_rate=1.0,
                        batch=256,
                        window=64,
                        clip=None,
                    ),
                    "ik": Learning(
                        share=0.2,
                        learning_rate=1e-4,
                        final_rate=1.0,
                        batch=256,
                        window=64,
                        clip=None,
                        weights=sparse_training.WEIGHTS,
                    ),
                },
            ),
            "cpu": Config(
                sparseposer.SparsePoserSpec(channels=(8, 12, 20, 32), kernel=9),
                {
                    "generator": replace(_CPU, share=0.75, window=64),
                    "ik": Learning(
                        share=0.25, batch=32, window=64, weights=sparse_training.WEIGHTS
                    ),
                },
            ),
            "smoke": Config(
                sparseposer.SparsePoserSpec(channels=(8, 8, 8, 8), kernel=5, ik_hidden=32),
                {
                    "generator": replace(_SMOKE, share=0.7, window=64),
                    "ik": replace(_SMOKE, share=0.3, window=64, weights=sparse_training.WEIGHTS),
                },
                validation=12,
            ),
        },
        sparseposer.SparsePoserModule,
        sparse_training.make_task,
        _sparse,
        {"ik": "learned_ik"},
    ),
    "dragposer": Entry(
        "DragPoser (Ponton et al., 2024)",
        ("3T", "4T", "6T"),
        {
            "paper": Config(
                dragposer.DragPoserSpec(),
                {
                    "vae": Learning(
                        share=0.5,
                        learning_rate=1e-4,
                        final_rate=1.0,
                        batch=64,
                        window=3,
                        clip=100.0,
                        weights=drag_training.WEIGHTS,
                    ),
                    "predictor": Learning(
                        share=0.5,
                        optimiser="adam",
                        final_rate=1.0,
                        batch=512,
                        window=129,
                        clip=None,
                    ),
                },
            ),
            "cpu": Config(
                dragposer.DragPoserSpec(feed_forward=256, encoder_layers=2, decoder_layers=2),
                {
                    "vae": Learning(
                        share=0.6, batch=256, window=3, clip=10.0, weights=drag_training.WEIGHTS
                    ),
                    "predictor": Learning(share=0.4, batch=32, window=129, warm_up=200),
                },
            ),
            "smoke": Config(
                dragposer.DragPoserSpec(feed_forward=32, encoder_layers=1, decoder_layers=1),
                {
                    "vae": replace(
                        _SMOKE,
                        share=0.5,
                        batch=32,
                        window=3,
                        clip=10.0,
                        weights=drag_training.WEIGHTS,
                    ),
                    "predictor": replace(_SMOKE, share=0.5, window=129),
                },
                validation=12,
            ),
        },
        dragposer.DragPoserModule,
        drag_training.make_task,
        _drag,
        {"predictor": "predictor"},
    ),
}
