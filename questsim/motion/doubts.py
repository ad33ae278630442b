"""Signs that a file is not what it seems: warnings of an import, no refusals."""

from __future__ import annotations

import numpy as np

from questsim.motion.checks import FLOOR_TOLERANCE_M, UNKNOWN_UNITS, Report, jumps
from questsim.motion.motion import Motion

MAX_REPEATED = 0.3
"""Share of frames that may repeat the one before. Recorded frames differ, if only by noise."""
MIN_FRAMES = 10
"""A shorter file may well be a pose."""


def doubts(motion: Motion, report: Report) -> tuple[str, ...]:
    """One clause for each sign; empty if there is none."""
    found = (_unknown_units(report), jumps(motion), _repeats(motion), _far_from_floor(report))
    return tuple(filter(None, found))


def _unknown_units(report: Report) -> str:
    if UNKNOWN_UNITS not in report.units:
        return ""
    return (
        f"the skeleton is no person's height in any known unit and is scaled to "
        f"{report.stature_m:.1f} m; declare the performer's height with --height"
    )


def _repeats(motion: Motion) -> str:
    """Frames that are those before: a frozen export, or frames filled in for another rate."""
    if len(motion) < MIN_FRAMES:
        return ""
    frames = np.concatenate([motion.root_position, motion.rotations.reshape(len(motion), -1)], 1)
    share = float((frames[1:] == frames[:-1]).all(axis=1).mean())
    if share == 1.0:
        return "nothing moves: all frames are the same"
    if share <= MAX_REPEATED:
        return ""
    rate = (1.0 - share) * motion.fps
    return (
        f"{100 * share:.0f} % of the frames repeat the one before: it may have been recorded at "
        f"about {rate:.0f} frames a second"
    )


def _far_from_floor(report: Report) -> str:
    if abs(report.lifted_m) <= FLOOR_TOLERANCE_M:
        return ""
    return (
        f"moved by {report.lifted_m:+.2f} m onto the floor: perhaps the root's positions have "
        "other units than the bones, or another origin"
    )
