"""Faults of the devices that a kinematic system measures the user with."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np

from agents.kinematic.options import Noise
from questsim.joint_sensors import SENSOR_FPS, SensorSequence
from questsim.sensors import DEVICES, SensorNoise

NOISES: tuple[Noise, ...] = get_args(Noise)

NOISE_M, NOISE_RAD = 0.005, 0.02
"""White noise: standard deviations of each coordinate, and of each part of the rotation vector."""
MOUNT_M, MOUNT_RAD = 0.03, float(np.radians(10.0))
"""Mounts: greatest distance and angle of each device from its nominal place, constant in a clip."""
LATENCY_S = 1.0 / 12.0
"""Latency of every device: five frames at 60 Hz, three at 36 Hz."""
DROPOUT_PER_S, DROPOUT_S = 0.3, 0.5
"""Dropouts: how often one begins at each device, and its greatest duration (its least a tenth)."""
SILENT_FRAMES = 100
"""Number of frames after which a faulty tracker returns (DragPoser)."""


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


def faulty(sequence: SensorSequence, probability: float, seed: int) -> SensorSequence:
    """In each frame, one device drops out with this probability; it returns after 100 frames.

    Source: DragPoser's faulty trackers. At least one device always reports.
    """
    rng, present = np.random.default_rng(seed), sequence.present.copy()
    for frame in range(1, len(sequence)):
        if rng.random() < probability:
            device = int(rng.integers(present.shape[1]))
            if present[frame].sum() > 1:
                present[frame : frame + SILENT_FRAMES, device] = False
    return replace(sequence, present=present)
