"""Physical plausibility of a motion: the residual force on its root.

Inverse dynamics computes the generalised forces of a motion. The floor supplies as much as it can
at soles near it. Muscles act on joints, not on the pelvis, so any force left at the root is an
error of the motion: floating, jerking, or leaning without support.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from questsim.motion.clip import Clip
from questsim.motion.inverse_dynamics import InverseDynamics


def root_force(clip: Clip) -> np.ndarray:
    """Residual force on the root in body weights ``(T,)``; 0 is plausible, 1 is hovering.

    Velocities are the clip's, accelerations their differences. The floor may supply any force
    inside a friction pyramid at sole points within 1.5 cm of it (``InverseDynamics``), so that
    errors of millimetres from retargeting or estimation do not count as floating.

    Args:
        clip: a clip at its own stature.
    """
    dynamics = _dynamics(round(clip.height_m, 4))
    return np.linalg.norm(dynamics.forces(clip)[:, :3], axis=-1) / dynamics.weight_n


@lru_cache(maxsize=8)
def _dynamics(height_m: float) -> InverseDynamics:
    return InverseDynamics(height_m)
