"""Stance figures of a retargeted clip, as ``questsim motions import`` prints them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M
from questsim.motion.clip import FPS, Clip
from questsim.motion.footing import ANKLES, leg_targets
from questsim.motion.kinematics import central_difference, sole_positions
from questsim.motion.limbs import ankle_rise
from questsim.motion.motion import Motion
from questsim.motion.stance import ON_FLOOR_M, still_feet
from questsim.skeleton import FOOT_LINKS

SOLE_BAR_CM, SOLE_P90_BAR_CM, TILT_BAR_CM, CONTACT_BAR = 0.7, 1.5, 1.0, 0.97
MIN_BEARING = 0.8
"""Warn if a sole bears in a smaller share of walking frames: then the feet of the file slide."""
WALKING_M_S = (0.3, 2.0)
"""The root's horizontal speed in frames that count as walking, scaled with height."""
MAX_VERTICAL_M_S, MAX_FALL_M_S2 = 0.6, 5.0
"""Frames in which the root moves faster up or down, or falls faster, are of a jump."""
MIN_UPRIGHT = 0.7
"""Cosine of the trunk's greatest angle to the vertical while walking: no crawl, no cartwheel."""
MIN_WALKING_FRAMES = 18
SKATE_MARGIN_CM_S = 2.0


@dataclass(frozen=True)
class StanceFigures:
    """How the feet of a clip stand.

    Still feet are those that are still in the file and not lifted off the floor.

    Attributes:
        still: share of frames in which a foot is still.
        sole_cm, sole_p90_cm: distance of the sole's lowest point from the floor, mean and 90th
            percentile; NaN where no foot is ever still, like the others.
        tilt_cm: mean height of the sole's highest point over its lowest.
        contact: share of walking frames in which some sole is within 1.5 cm of the floor; NaN if
            the clip hardly walks.
        bears: the same for a sole that is also slow (``Clip.contacts``).
        skate_cm_s, file_skate_cm_s: mean horizontal speed of the soles' centres, in the clip and
            in the file (scaled to the avatar).
    """

    still: float
    sole_cm: float
    sole_p90_cm: float
    tilt_cm: float
    contact: float
    bears: float
    skate_cm_s: float
    file_skate_cm_s: float

    def __str__(self) -> str:
        parts = ["feet never still"]
        if self.still:
            parts = [
                f"still soles at {self.sole_cm:.1f} cm (90 %: {self.sole_p90_cm:.1f})",
                f"tilt {self.tilt_cm:.1f} cm",
                f"skating {self.skate_cm_s:.0f} cm/s (file {self.file_skate_cm_s:.0f})",
            ]
        if np.isfinite(self.contact):
            walking = (
                f"a foot touches in {100 * self.contact:.0f} % of walking, "
                f"bears in {100 * self.bears:.0f} %"
            )
            parts.insert(len(parts) - 1, walking)
        return ", ".join(parts)

    def warnings(self) -> list[str]:
        """One clause for each figure that is worse than twice its bar."""
        out = []
        if self.sole_cm > 2 * SOLE_BAR_CM or self.sole_p90_cm > 2 * SOLE_P90_BAR_CM:
            out.append(f"still soles are {self.sole_cm:.1f} cm off the floor")
        if self.tilt_cm > 2 * TILT_BAR_CM:
            out.append(f"still soles tilt by {self.tilt_cm:.1f} cm")
        if self.contact < 1 - 2 * (1 - CONTACT_BAR):
            out.append(f"no foot touches in {100 * (1 - self.contact):.0f} % of walking")
        elif self.bears < MIN_BEARING:
            out.append(f"feet slide in {100 * (1 - self.bears):.0f} % of walking")
        if self.skate_cm_s > 2 * self.file_skate_cm_s + SKATE_MARGIN_CM_S:
            out.append(f"feet skate at {self.skate_cm_s:.0f} cm/s")
        return out


def stance_figures(motion: Motion, clip: Clip) -> StanceFigures:
    """How the feet of a clip stand, in frames in which those of its motion are still."""
    motion = motion.resampled(FPS)
    position, quat = motion.forward_kinematics()
    height, ratio = clip.height_m, clip.height_m / DEFAULT_HEIGHT_M
    _, ankles = leg_targets(motion, position, quat, height, ankle_rise(motion, position))
    recorded = quat[:, ANKLES]
    links = list(FOOT_LINKS)
    soles = sole_positions(clip.link_position[:, links], clip.link_quat[:, links], height)
    lowest = soles[..., 2].min(axis=-1)
    lifted = lowest > lowest.min(axis=1, keepdims=True) + ON_FLOOR_M * ratio
    still = still_feet(ankles, recorded, height) & ~lifted
    walks = _walks(clip)
    contact, bears = np.nan, np.nan
    if walks.sum() >= MIN_WALKING_FRAMES:
        contact = float((lowest[walks].min(axis=1) < 0.01 * SOLE_P90_BAR_CM * ratio).mean())
        bears = float(clip.contacts[walks].any(axis=1).mean())
    if not still.any():
        return StanceFigures(0.0, np.nan, np.nan, np.nan, contact, bears, np.nan, np.nan)
    off = 100.0 * np.abs(lowest[still])
    skate, file_skate = (
        100.0 * float(np.linalg.norm(central_difference(s[..., :2]), axis=-1)[still].mean())
        for s in (soles.mean(axis=-2), sole_positions(ankles, recorded, height).mean(axis=-2))
    )
    return StanceFigures(
        still=float(still.any(axis=1).mean()),
        sole_cm=float(off.mean()),
        sole_p90_cm=float(np.percentile(off, 90)),
        tilt_cm=100.0 * float(np.ptp(soles[..., 2], axis=-1)[still].mean()),
        contact=contact,
        bears=bears,
        skate_cm_s=skate,
        file_skate_cm_s=file_skate,
    )


def _walks(clip: Clip) -> np.ndarray:
    """``(T,)`` bool: the avatar walks, neither crawls nor jumps."""
    speed = np.linalg.norm(central_difference(clip.qpos[:, :2]), axis=-1)
    speed *= DEFAULT_HEIGHT_M / clip.height_m
    vertical = central_difference(clip.qpos[:, 2])
    upright = rot.quat_rotate(clip.qpos[:, 3:7], np.array([0.0, 0.0, 1.0]))[:, 2]
    return (
        (speed > WALKING_M_S[0])
        & (speed < WALKING_M_S[1])
        & (np.abs(vertical) < MAX_VERTICAL_M_S)
        & (central_difference(vertical) > -MAX_FALL_M_S2)
        & (upright > MIN_UPRIGHT)
    )


def mean_figures(figures: Sequence[StanceFigures]) -> StanceFigures:
    """The mean of each figure over those clips that have it."""
    table = np.array([astuple(each) for each in figures])
    known = np.isfinite(table)
    total = np.where(known, table, 0.0).sum(axis=0)
    return StanceFigures(
        *np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), np.nan)
    )
