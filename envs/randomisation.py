"""Random differences between the simulations of a batch, for robust policies."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from envs.checks import check_range
from envs.episode_random import within
from questsim.skeleton import NUM_LINKS

MAX_UNSCALED_M = 0.4
"""Greatest difference between the statures of avatar and user, to either side."""


@dataclass(frozen=True)
class Randomisation:
    """Ranges of the random values. Each simulation of a batch draws once, mounts every episode.

    Attributes:
        friction: factor on the friction of avatar and floor.
        mass: factor on mass and inertia of all links.
        latency_frames: latency of the devices in whole frames.
        dropout: probability per frame that a dropout of a device begins.
        dropout_frames: duration of a dropout; the device then repeats its last pose.
        latency_jitter_frames: greatest additional latency of a frame, drawn for every frame.
        noise_m: standard deviation of white noise on every coordinate of the devices.
        noise_rad: standard deviation of a white rotation vector.
        mount_m: distance of each device from its nominal mount, constant in an episode.
        mount_rad: angle of each device from its nominal mount, constant in an episode.
        recentre_m: horizontal distance by which the user jumps once in an episode, as when a
            headset is recentred. Devices and reference jump together.
        recentre_rad: angle by which the user turns in that jump, to either side.
        recentre_s: time of the jump after the start of the episode.
        unscaled_m: stature of the avatar minus that of its user, whose devices and motion are not
            scaled to the avatar; added to ``EnvConfig.unscaled_m``.

    Raises:
        InputError: an invalid range.
    """

    friction: tuple[float, float] = (1.0, 1.0)
    mass: tuple[float, float] = (1.0, 1.0)
    latency_frames: tuple[int, int] = (0, 0)
    dropout: tuple[float, float] = (0.0, 0.0)
    dropout_frames: tuple[int, int] = (4, 18)
    latency_jitter_frames: tuple[int, int] = (0, 0)
    noise_m: tuple[float, float] = (0.0, 0.0)
    noise_rad: tuple[float, float] = (0.0, 0.0)
    mount_m: tuple[float, float] = (0.0, 0.0)
    mount_rad: tuple[float, float] = (0.0, 0.0)
    recentre_m: tuple[float, float] = (0.0, 0.0)
    recentre_rad: tuple[float, float] = (0.0, 0.0)
    recentre_s: tuple[float, float] = (1.0, 8.0)
    unscaled_m: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name, least, most in (
            ("friction", 0.05, 5.0),
            ("mass", 0.5, 2.0),
            ("unscaled_m", -MAX_UNSCALED_M, MAX_UNSCALED_M),
            ("latency_frames", 0, 36),
            ("latency_jitter_frames", 0, 36),
            ("dropout", 0.0, 1.0),
            ("dropout_frames", 1, 360),
            ("noise_m", 0.0, 0.5),
            ("noise_rad", 0.0, np.pi),
            ("mount_m", 0.0, 0.5),
            ("mount_rad", 0.0, np.pi),
            ("recentre_m", 0.0, 5.0),
            ("recentre_rad", 0.0, np.pi),
            ("recentre_s", 0.0, 3600.0),
        ):
            whole = name.endswith("_frames")
            check_range(name, getattr(self, name), least, most, "randomisation", whole=whole)

    @property
    def of_bodies(self) -> bool:
        """Whether simulations need models of their own."""
        return self.friction != (1.0, 1.0) or self.mass != (1.0, 1.0)

    @property
    def of_poses(self) -> bool:
        """Whether reported poses have noise or mounting errors."""
        return max(*self.noise_m, *self.noise_rad, *self.mount_m, *self.mount_rad) > 0.0

    @property
    def recentres(self) -> bool:
        """Whether users jump."""
        return max(*self.recentre_m, *self.recentre_rad) > 0.0


REAL_DEVICES = Randomisation(
    latency_jitter_frames=(2, 2),
    dropout=(0.005, 0.005),
    dropout_frames=(4, 18),
    noise_m=(0.005, 0.005),
    noise_rad=(float(np.radians(1.0)), float(np.radians(1.0))),
    mount_m=(0.0, 0.03),
    mount_rad=(0.0, float(np.radians(10.0))),
)
"""Carelessly worn headsets and controllers with poor tracking and a jittery connection."""


def varied_models(
    models: list[mujoco.MjModel], options: Randomisation, seed: int, links: int = NUM_LINKS
) -> list[mujoco.MjModel]:
    """Copies of a batch's models with friction, and masses of the ``links``, drawn for each."""
    numbers = np.random.default_rng([seed, 10]).random((len(models), 2))
    friction = within(numbers[:, 0], options.friction)
    mass = within(numbers[:, 1], options.mass)
    varied = []
    for model, slide, weight in zip(models, friction, mass, strict=True):
        own = mujoco.MjModel.__copy__(model)
        own.geom_friction[:, 0] *= slide
        own.body_mass[1 : 1 + links] *= weight
        own.body_inertia[1 : 1 + links] *= weight
        mujoco.mj_setConst(own, mujoco.MjData(own))
        varied.append(own)
    return varied
