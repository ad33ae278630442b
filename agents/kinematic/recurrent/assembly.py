"""Compiled conversion of the network outputs of HMD-Poser and LGSIK-Poser to poses of 22 joints.

Computes 6D rotations, forward kinematics and quaternions like ``questsim.differentiable`` and
SciPy, in double precision. For single frames, most of PyTorch's time would be call overhead.
"""

from __future__ import annotations

import math

import numpy as np

from questsim.compiled import jit
from questsim.skeleton import JOINT_PARENTS, JOINTS

_PARENTS = np.array(JOINT_PARENTS)
_HEAD = JOINTS.index("head")


def assembled(
    six: np.ndarray, heading: np.ndarray, head: np.ndarray, offsets: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Roots ``(T, 3)`` and rotations ``(T, 22, 4)``; the head keeps its measured position.

    Args:
        six: ``(T, 22, 6)`` two columns of each joint's rotation; the root's is relative to heading.
        heading: ``(T, 3, 3)`` rotation of the heading about z.
        head: ``(T, 3)`` position of the head joint in the world.
        offsets: ``(T, 22, 3)`` as in ``Poses``.

    Returns:
        NaN quaternions where the two columns do not define a rotation.
    """
    root, quat = np.empty((len(six), 3)), np.empty((*six.shape[:2], 4))
    # A fixed memory layout, so that the function is compiled only once.
    arrays = (np.ascontiguousarray(array, float) for array in (six, heading, head, offsets))
    _assemble(*arrays, _PARENTS, root, quat)
    return root, quat


@jit
def _assemble(six, heading, head, offsets, parents, root, quat):
    joints = len(parents)
    world, place = np.empty((joints, 3, 3)), np.empty((joints, 3))
    local, turned = np.empty((3, 3)), np.empty((3, 3))
    for t in range(len(six)):
        for joint in range(joints):
            good = _matrix(six[t, joint], local)
            if joint == 0:
                _multiply(heading[t], local, turned)
                local[:] = turned
                world[0] = local
                place[0] = 0.0
            else:
                parent = parents[joint]
                _multiply(world[parent], local, world[joint])
                for i in range(3):
                    place[joint, i] = place[parent, i]
                    for k in range(3):
                        place[joint, i] += world[parent, i, k] * offsets[t, joint, k]
            if good:
                _quaternion(local, quat[t, joint])
            else:
                quat[t, joint] = np.nan
        for i in range(3):
            root[t, i] = head[t, i] - place[_HEAD, i]


@jit
def _matrix(six, out):
    """Write the rotation of two columns (Zhou et al. 2019); returns whether they define one."""
    x, y = out[:, 0], out[:, 1]
    along, length = 0.0, 0.0
    for i in range(3):
        x[i], y[i] = six[i], six[3 + i]
        length += x[i] * x[i]
    length = max(math.sqrt(length), 1e-12)
    for i in range(3):
        x[i] /= length
        along += x[i] * y[i]
    length = 0.0
    for i in range(3):
        y[i] -= along * x[i]
        length += y[i] * y[i]
    length = max(math.sqrt(length), 1e-12)
    for i in range(3):
        y[i] /= length
    out[0, 2] = x[1] * y[2] - x[2] * y[1]
    out[1, 2] = x[2] * y[0] - x[0] * y[2]
    out[2, 2] = x[0] * y[1] - x[1] * y[0]
    return out[0, 2] ** 2 + out[1, 2] ** 2 + out[2, 2] ** 2 > 0.5


@jit
def _multiply(a, b, out):
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@jit
def _quaternion(m, out):
    """Write the quaternion wxyz of a rotation, with its largest component positive."""
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    largest, most = 3, trace
    for i in range(3):
        if m[i, i] > most:
            largest, most = i, m[i, i]
    if largest == 3:
        out[0] = 1.0 + trace
        out[1], out[2], out[3] = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        out[0] = m[k, j] - m[j, k]
        out[1 + i] = 1.0 - trace + 2.0 * m[i, i]
        out[1 + j], out[1 + k] = m[j, i] + m[i, j], m[k, i] + m[i, k]
    length = math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2 + out[3] ** 2)
    for i in range(4):
        out[i] /= length
