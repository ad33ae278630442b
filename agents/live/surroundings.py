"""Environment, object and user's ghost of a live session, from its settings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agents.live.drivers import Driver
from agents.live.options import NOTHING
from envs.config import EnvConfig
from envs.core import BatchSim
from envs.objects import WorldObject
from envs.terrain import RANGES, TERRAINS, Terrain
from questsim.heightfield import HeightField
from questsim.motion.clip import Clip
from questsim.motion.synthesis.synthetic import SEATED
from questsim.viewing.live import Settings


def session_config(driver: Driver, settings: Settings) -> EnvConfig:
    """The environment of a session's settings."""
    config = driver.config(settings.sensors, float(settings.avatar_m))
    return replace(
        config,
        terrain=scaled_terrain(settings.terrain, settings.roughness),
        objects=() if settings.object == NOTHING else (WorldObject(settings.object),),
    )


def scaled_terrain(name: str, roughness: float) -> Terrain | None:
    """The named terrain with its relief multiplied; None for flat ground."""
    if name == "flat":
        return None
    terrain = TERRAINS[name]
    return replace(
        terrain,
        amplitude_m=terrain.amplitude_m * roughness,
        slope_deg=terrain.slope_deg * roughness,
        step_height_m=terrain.step_height_m * roughness,
        gap_m=max(terrain.gap_m * roughness, RANGES["gap_m"][0]),
    )


def needed_object(clip: Clip) -> str:
    """The object that a clip needs: a chair for seated clips, otherwise ``NOTHING``."""
    return "chair" if clip.kind in SEATED else NOTHING


def in_own_size(
    clip: Clip, field: HeightField | None, height_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """The clip's person in another size, at the same place on the ground in every frame.

    A person of another size would walk another distance in the same steps. Here the person moves
    along with the clip so that both stay together, and the feet slide by the difference.

    Args:
        clip: as the avatar follows it.
        field: the ground; None for a plane.
        height_m: the person's stature.

    Returns:
        Link positions ``(F, 16, 3)`` and ``qpos`` ``(F, 40)``; orientations and angles are the
        same.
    """
    if height_m == clip.height_m:
        return clip.link_position, clip.qpos
    scale, spot = height_m / clip.height_m, clip.qpos[:, :3].copy()
    spot[:, 2] = 0.0 if field is None else field.ground_at(spot)
    position = spot[:, None] + scale * (clip.link_position - spot[:, None])
    qpos = clip.qpos.copy()
    qpos[:, :3] = position[:, 0]
    return position, qpos


def object_pose(sim: BatchSim) -> tuple[np.ndarray, np.ndarray]:
    """Position and orientation of the session's object."""
    pose = sim.objects.pose[0, 0].copy()
    return pose[:3], pose[3:]
