"""Our axes in those of BVH and glTF: right-handed, y up, facing +z, left along +x."""

from __future__ import annotations

import numpy as np

from questsim import rotations as rot


def y_up(position: np.ndarray) -> np.ndarray:
    """Positions ``(..., 3)``, x forward, y left, z up, with y up: ``(y, z, x)``."""
    return np.asarray(position, float)[..., [1, 2, 0]]


def y_up_quat(quat: np.ndarray) -> np.ndarray:
    """Quaternions wxyz ``(..., 4)`` for the same change of axes; they stay wxyz."""
    return np.asarray(quat, float)[..., [0, 2, 3, 1]]


def local_quats(world: np.ndarray, parents: tuple[int, ...]) -> np.ndarray:
    """Each link's rotation ``(T, n, 4)`` in its parent, of orientations in the world.

    The first is its own parent and stays in the world.
    """
    local = np.array(world, float)
    for link in range(1, len(parents)):
        local[:, link] = rot.quat_multiply(
            rot.quat_conjugate(world[:, parents[link]]), world[:, link]
        )
    return rot.continuous(local)
