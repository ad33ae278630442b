"""How plausible a motion is to physics: the force on its root that nothing in the world supplies.

Inverse dynamics asks which generalised forces a motion needs, and gives the floor what it can carry
at soles near it. A person has muscles at the joints but nothing that pulls at the pelvis: what is
left there is what the motion gets wrong, be it floating, jerking or leaning without a foot below.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from questsim.motion.clip import Clip
from questsim.motion.inverse_dynamics import InverseDynamics


def root_force(clip: Clip) -> np.ndarray:
    """Force on the root in body weights ``(T,)``; 1 is someone who hovers, 0 someone plausible.

    Velocities are the clip's, accelerations their differences. The floor may give any force inside
    a friction pyramid at sole points within 1.5 cm of it (``InverseDynamics``), so that retargeting
    or an estimate that is off by millimetres does not count as floating.

    Args:
        clip: for its own stature.
    """
    dynamics = _dynamics(round(clip.height_m, 4))
    return np.linalg.norm(dynamics.forces(clip)[:, :3], axis=-1) / dynamics.weight_n


@lru_cache(maxsize=8)
def _dynamics(height_m: float) -> InverseDynamics:
    return InverseDynamics(height_m)
