"""Rollouts for the tests of metrics and reports."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from questsim.metrics import Rollout
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import clip_from_qpos
from questsim.skeleton import NUM_DOFS


def still_clip(frames: int = 8, height_m: float = 1.75, **about: str) -> Clip:
    """A person who stands still with both soles on the floor."""
    qpos = np.zeros((frames, 7 + NUM_DOFS))
    qpos[:, 2], qpos[:, 3] = 0.9275 * height_m / 1.75, 1.0
    return clip_from_qpos(about.pop("name", "still"), qpos, height_m, None, **about)


def moving_clip(frames: int = 20, seed: int = 0, **about: str) -> Clip:
    """Smooth motion of every joint and of the root."""
    rng = np.random.default_rng(seed)
    phase = np.arange(frames)[:, None] / FPS + rng.uniform(0, 1, 7 + NUM_DOFS)
    qpos = rng.uniform(0.1, 0.4, 7 + NUM_DOFS) * np.sin(2 * np.pi * phase)
    qpos[:, 2] += 1.0
    qpos[:, 3:7] = Rotation.from_rotvec(qpos[:, 3:6]).as_quat(scalar_first=True)
    return clip_from_qpos(about.pop("name", f"moving-{seed}"), qpos, 1.75, None, **about)


def rollout(
    reference: Clip, performed: Clip | None = None, frames: int | None = None, **changes
) -> Rollout:
    """A rollout that performs ``performed`` (by default the reference itself) until ``frames``."""
    performed = performed or reference
    frames = frames or len(performed)
    whole = Rollout(
        name=reference.name,
        kind=reference.kind,
        style=reference.style,
        height_m=reference.height_m,
        fps=FPS,
        reference=reference,
        link_position=performed.link_position[:frames],
        link_quat=performed.link_quat[:frames],
        joint_angles=performed.qpos[:frames, 7:],
        foot_clearance=np.zeros((frames, 2)),
        contact_force=np.where(performed.contacts[:frames], 343.0, 0.0),
        fell=False,
        seconds_simulated=(frames - 1) / FPS,
        seconds_wall=0.5,
    )
    return replace(whole, **changes)


def shifted(reference: Clip, metres: tuple[float, float, float]) -> np.ndarray:
    """Link positions ``(T, 16, 3)`` of the clip, all moved alike."""
    return reference.link_position + np.array(metres)


def turned(quat: np.ndarray, links: list[int], degrees: float, axis=(0.0, 1.0, 0.0)) -> np.ndarray:
    """Orientations ``(T, 16, 4)`` with some links turned in the world about an axis."""
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array(axis))
    out = quat.copy()
    for link in links:
        own = Rotation.from_quat(quat[:, link], scalar_first=True)
        out[:, link] = (turn * own).as_quat(scalar_first=True)
    return out
