"""Conditions of a comparison: faults of the devices, and starts of the avatar."""

from __future__ import annotations

from dataclasses import replace

from agents.comparison.options import Start
from agents.kinematic.device_faults import (
    DROPOUT_PER_S,
    DROPOUT_S,
    LATENCY_S,
    MOUNT_M,
    MOUNT_RAD,
    NOISE_M,
    NOISE_RAD,
    Noise,
)
from envs.config import EnvConfig
from envs.randomisation import Randomisation
from envs.starts import WHOLLY, Starts
from questsim.motion.clip import FPS


def with_noise(config: EnvConfig, noise: Noise | None) -> EnvConfig:
    """The environment of a torque policy with the same kind of fault, at 36 Hz."""
    if noise is None:
        return config

    def both(value: float, kind: Noise) -> tuple[float, float]:
        return (value, value) if noise in (kind, "all") else (0.0, 0.0)

    late = round(LATENCY_S * FPS) if noise in ("latency", "all") else 0
    mount, turn = both(MOUNT_M, "mounts")[1], both(MOUNT_RAD, "mounts")[1]
    faults = Randomisation(
        latency_frames=(late, late),
        dropout=both(DROPOUT_PER_S / FPS, "dropouts"),
        dropout_frames=(round(0.1 * DROPOUT_S * FPS), round(DROPOUT_S * FPS)),
        noise_m=both(NOISE_M, "white"),
        noise_rad=both(NOISE_RAD, "white"),
        mount_m=(0.0, mount),
        mount_rad=(0.0, turn),
    )
    return replace(config, randomisation=faults)


def starts_of(start: Start) -> Starts | None:
    """``EnvConfig.starts`` of a start."""
    return None if start == "user" else WHOLLY[start]


_FROM: dict[Start, str] = {
    "first-estimate": ", from the first estimate",
    "user": ", from the user's state",
    "standing": ", from standing",
}


def row_name(scenario: str, noise: Noise | None, start: Start = "estimate") -> str:
    """Name of a row: the scenario, with the condition unless it is the usual one."""
    name = scenario if noise is None else f"{scenario}, noise: {noise}"
    return name + _FROM.get(start, "")


def condition_of(name: str) -> tuple[str, Start]:
    """Scenario and start in the ``row_name`` of a row without noise."""
    for start, words in _FROM.items():
        if name.endswith(words):
            return name.removesuffix(words), start
    return name, "estimate"
