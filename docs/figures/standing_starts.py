"""How many clips an avatar that begins at rest can follow at all.

    python -m docs.figures.standing_starts --motions bandai-namco-2:test

A body at rest whose centre accelerates by at most a is after t seconds within a t^2 / 2 of its
place. A clip whose centre is farther away than that by more than 0.5 m cannot be completed: the
mean distance of the links is at least that of their means.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
import tyro

from questsim.motion.clip import FPS, Clip
from questsim.motion.spec import load_motions

LIMIT_M = 0.5


def possible(clip: Clip, acceleration: float) -> bool:
    """Whether a body that begins at rest can stay within 0.5 m of a clip.

    Args:
        clip: the reference.
        acceleration: greatest horizontal acceleration of the body's centre, m/s^2.
    """
    centre = clip.link_position[..., :2].mean(axis=1)
    away = np.linalg.norm(centre - centre[0], axis=-1)
    reach = acceleration / 2 * (np.arange(len(clip)) / FPS) ** 2
    return bool((away - reach < LIMIT_M).all())


@dataclass(frozen=True)
class Args:
    """Print the share of clips that an avatar can follow from a standing start."""

    motions: str = "synthetic"
    """Motions, as for evaluate.py."""


def main() -> None:
    """Print the share for some accelerations, and the kinds of the other clips."""
    clips = load_motions(tyro.cli(Args).motions)
    for acceleration in (2.0, 3.0, 4.0, 6.0, 8.0):
        lost = Counter(clip.kind for clip in clips if not possible(clip, acceleration))
        share = 100 * (1 - lost.total() / len(clips))
        print(f"{acceleration:.0f} m/s^2: {share:.1f} % of {len(clips)}; not: {dict(lost)}")


if __name__ == "__main__":
    main()
