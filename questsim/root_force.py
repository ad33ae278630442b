"""How plausible a motion is to physics: the force on its root that nothing in the world supplies.

Inverse dynamics asks which generalised forces a motion needs, the floor's among them where the
soles touch it. A person has muscles at the joints but nothing that pulls at the pelvis: what is
left there is what the motion gets wrong, be it floating, sliding or starting without a push.
"""

from __future__ import annotations

import mujoco
import numpy as np

from questsim.body import build_body
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import central_difference


def root_force(clip: Clip) -> np.ndarray:
    """Force on the root in body weights ``(T,)``; 1 is someone who hovers, 0 someone plausible.

    Velocities are the clip's, accelerations their central differences. Contact forces are those
    of MuJoCo's inverse dynamics, which follow from how deep and fast the soles are: a motion that
    floats a millimetre above the floor has none.

    Args:
        clip: for its own stature.
    """
    model = build_body(clip.height_m).model
    data = mujoco.MjData(model)
    acceleration = central_difference(clip.qvel, FPS)
    weight = float(model.body_mass.sum() * np.linalg.norm(model.opt.gravity))
    forces = np.empty(len(clip))
    for frame in range(len(clip)):
        data.qpos[:], data.qvel[:] = clip.qpos[frame], clip.qvel[frame]
        data.qacc[:] = acceleration[frame]
        mujoco.mj_inverse(model, data)
        forces[frame] = np.linalg.norm(data.qfrc_inverse[:3])
    return forces / weight
