"""Conditions of a comparison: faults of the devices, and starts of the avatar."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from envs.config import EnvConfig
from envs.randomisation import Randomisation
from envs.starts import WHOLLY, Starts
from questsim.joint_sensors import SENSOR_FPS, SensorSequence
from questsim.motion.clip import FPS
from questsim.sensors import DEVICES, SensorNoise

Noise = Literal["white", "mounts", "latency", "dropouts", "all"]
NOISES: tuple[Noise, ...] = get_args(Noise)
Start = Literal["estimate", "user", "standing"]

NOISE_M, NOISE_RAD = 0.005, 0.02
"""White noise: standard deviations of each coordinate, and of each part of the rotation vector."""
MOUNT_M, MOUNT_RAD = 0.03, float(np.radians(10.0))
"""Mounts: greatest distance and angle of each device from its nominal place, constant in a clip."""
LATENCY_S = 1.0 / 12.0
"""Latency of every device: five frames at 60 Hz, three at 36 Hz."""
DROPOUT_PER_S, DROPOUT_S = 0.3, 0.5
"""Dropouts: how often one begins at each device, and its greatest duration (its least a tenth)."""


def noisy(sequence: SensorSequence, noise: Noise | None, seed: int) -> SensorSequence:
    """Device signals with one kind of fault, or with all of them.

    IMUs have the orientation's noise and mounts; their accelerations are as without noise.

    Args:
        sequence: the exact signals at 60 Hz.
        noise: kind of fault; None for none.
        seed: of all random numbers.
    """
    if noise is None:
        return sequence
    rng = np.random.default_rng([seed, NOISES.index(noise)])

    def has(kind: Noise) -> bool:
        return noise in (kind, "all")

    late = round(LATENCY_S * SENSOR_FPS) if has("latency") else 0
    faults = SensorNoise(
        position_std_m=NOISE_M if has("white") else 0.0,
        rotation_std_rad=NOISE_RAD if has("white") else 0.0,
        latency_frames=late,
        mount_m=MOUNT_M if has("mounts") else 0.0,
        mount_rad=MOUNT_RAD if has("mounts") else 0.0,
    )
    position, quat = faults.apply(sequence.position, sequence.quat, rng)
    imus = [i for i, name in enumerate(sequence.names) if DEVICES[name].kind == "imu"]
    position[:, imus] = sequence.position[:, imus]
    arrived = np.maximum(np.arange(len(sequence)) - late, 0)
    present = sequence.present.copy()
    if has("dropouts"):
        _drop_out(present, rng)
    return replace(
        sequence,
        position=position,
        quat=quat,
        acceleration=sequence.acceleration[arrived],
        present=present,
    )


def _drop_out(present: np.ndarray, rng: np.random.Generator) -> None:
    """Hide devices at random times; at least one always reports, and all do in the first frame."""
    low, high = round(0.1 * DROPOUT_S * SENSOR_FPS), round(DROPOUT_S * SENSOR_FPS)
    begins = rng.random(present.shape) < DROPOUT_PER_S / SENSOR_FPS
    frames = rng.integers(low, high + 1, present.shape)
    begins[0] = False
    for frame, device in np.argwhere(begins):
        present[frame : frame + frames[frame, device], device] = False
    present[~present.any(axis=1), 0] = True


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


_FROM: dict[Start, str] = {"user": ", from the user's state", "standing": ", from standing"}


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
