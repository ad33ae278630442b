"""Errors of the devices in the training of the systems that learn from what devices measure.

The same errors as in the comparison (``questsim.sensors.SensorNoise``): white noise on positions
and orientations, and mounts off their nominal places, constant in a window.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from questsim import rotations as rot
from questsim.sensors import SensorNoise

EXACT = {"position_m": 0.0, "rotation_rad": 0.0, "mount_m": 0.0, "mount_rad": 0.0}
"""``Learning.noise`` without errors: standard deviations of white noise, and bounds of mounts."""


@dataclass(frozen=True)
class Faults:
    """Errors of the devices in a batch of windows.

    Attributes:
        offset: ``(B, T, D, 3)`` added to the positions in metres, in the world.
        mount: ``(B, 1, D, 3)`` added to the positions in metres, in the devices' axes.
        before: ``(B, T, D, 3, 3)`` turns in the world.
        after: ``(B, 1, D, 3, 3)`` turns in the devices' axes.
    """

    offset: Tensor
    mount: Tensor
    before: Tensor
    after: Tensor

    def apply(self, position: Tensor, rotation: Tensor) -> tuple[Tensor, Tensor]:
        """Poses of ``D`` devices ``(B, T, D, 3)``, ``(B, T, D, 3, 3)`` with the errors."""
        moved = position + (rotation @ self.mount[..., None]).squeeze(-1) + self.offset
        return moved, self.before @ rotation @ self.after


def drawn(
    noise: dict[str, float], shape: tuple[int, int, int], rng: np.random.Generator
) -> Faults | None:
    """Errors of ``shape`` windows, frames and devices; None, without a random number, if exact.

    Raises:
        InputError: a negative or infinite size.
    """
    sizes = EXACT | noise
    errors = SensorNoise(
        position_std_m=sizes["position_m"],
        rotation_std_rad=sizes["rotation_rad"],
        mount_m=sizes["mount_m"],
        mount_rad=sizes["mount_rad"],
    )
    if errors == SensorNoise():
        return None
    windows, frames, devices = shape
    still, upright = np.zeros((frames, devices, 3)), np.zeros((frames, devices, 4))
    upright[..., 0] = 1.0
    white = SensorNoise(
        position_std_m=errors.position_std_m, rotation_std_rad=errors.rotation_std_rad
    )
    mounts = SensorNoise(mount_m=errors.mount_m, mount_rad=errors.mount_rad)
    offset, before = zip(*(white.apply(still, upright, rng) for _ in range(windows)), strict=True)
    mount, after = zip(
        *(mounts.apply(still[:1], upright[:1], rng) for _ in range(windows)), strict=True
    )
    return Faults(
        *(torch.as_tensor(np.array(each), dtype=torch.float32) for each in (offset, mount)),
        *(
            torch.as_tensor(rot.quat_to_matrix(np.array(each)), dtype=torch.float32)
            for each in (before, after)
        ),
    )
