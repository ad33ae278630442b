"""Is a recording in metres, z up, the right way round and at its true speed?"""

from __future__ import annotations

import numpy as np

from questsim.motion.motion import Motion, rest_height
from questsim.skeleton import JOINTS

LEG_FRACTION = 0.530 - 0.039
ANKLE_TO_HEAD_FRACTION = 0.870 - 0.039
"""Segment lengths as fractions of stature: hip 0.530, ankle 0.039, base of the head 0.870.

Source: Drillis and Contini 1966, as drawn in Winter, "Biomechanics and Motor Control of Human
Movement", 4th ed. 2009, figure 4.1.
"""


def stature(motion: Motion) -> float:
    """The performer's height in metres, from bone lengths alone.

    The mean of what the legs and what the chain from the ankles to the head joint say: where a
    skeleton's makers put the head and neck joints differs too much to trust the chain alone.
    """
    return stature_of(motion.offsets)


def stature_of(offsets: np.ndarray) -> float:
    """Stature in metres of a skeleton with these offsets ``(22, 3)``."""
    bones = [JOINTS.index(f"{side}_{j}") for side in ("left", "right") for j in ("knee", "ankle")]
    leg = np.linalg.norm(offsets[bones], axis=-1).sum() / 2.0
    return float(leg / LEG_FRACTION + rest_height(offsets) / ANKLE_TO_HEAD_FRACTION) / 2.0
