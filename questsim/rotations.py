"""Rotations: quaternions wxyz as in MuJoCo, over any leading axes; SciPy does the work."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy  # it imports its parts on first use

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

# In gimbal lock SciPy sets the free Euler angle to zero, which is valid; hide its warning.
warnings.filterwarnings("ignore", message="Gimbal lock detected")


def as_rotation(quat: np.ndarray) -> Rotation:
    """SciPy's Rotation, flattened to one axis, of quaternions wxyz ``(..., 4)``."""
    flat = np.asarray(quat, float).reshape(-1, 4)
    return scipy.spatial.transform.Rotation.from_quat(flat, scalar_first=True)


def from_euler(order: str, angles: Any) -> Rotation:
    """SciPy's Rotation of Euler angles in radians, of SciPy's orders."""
    return scipy.spatial.transform.Rotation.from_euler(order, angles)


def from_rotvec(rotvec: np.ndarray) -> Rotation:
    """SciPy's Rotation of rotation vectors ``(3,)`` or ``(n, 3)`` in radians."""
    return scipy.spatial.transform.Rotation.from_rotvec(rotvec)


def as_quat(rotation: Rotation, shape: tuple[int, ...] = ()) -> np.ndarray:
    """Quaternions wxyz ``(*shape, 4)`` of a Rotation; by default as the Rotation is shaped."""
    quat = rotation.as_quat(scalar_first=True)
    return quat.reshape(*shape, 4) if shape else quat


def quat_to_matrix(quat: np.ndarray) -> np.ndarray:
    """Matrices ``(..., 3, 3)`` of quaternions wxyz ``(..., 4)``."""
    quat = np.asarray(quat, float)
    return as_rotation(quat).as_matrix().reshape(*quat.shape[:-1], 3, 3)


def matrix_to_quat(matrix: np.ndarray) -> np.ndarray:
    """Quaternions wxyz ``(..., 4)`` of rotation matrices ``(..., 3, 3)``."""
    matrix = np.asarray(matrix, float)
    return as_quat(
        scipy.spatial.transform.Rotation.from_matrix(matrix.reshape(-1, 3, 3)), matrix.shape[:-2]
    )


def quat_multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Hamilton product of quaternions wxyz, broadcast: first ``b``, then ``a``."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    first = aw * bw - ax * bx - ay * by - az * bz
    out = np.empty((*np.shape(first), 4))
    out[..., 0] = first
    out[..., 1] = aw * bx + ax * bw + ay * bz - az * by
    out[..., 2] = aw * by - ax * bz + ay * bw + az * bx
    out[..., 3] = aw * bz + ax * by - ay * bx + az * bw
    return out


def quat_conjugate(quat: np.ndarray) -> np.ndarray:
    """The inverse rotation of unit quaternions wxyz ``(..., 4)``."""
    return np.asarray(quat, float) * np.array([1.0, -1.0, -1.0, -1.0])


def quat_rotate(quat: np.ndarray, vec: np.ndarray) -> np.ndarray:
    """Vectors ``(..., 3)`` turned by quaternions wxyz ``(..., 4)``, broadcast."""
    quat, vec = np.asarray(quat, float), np.asarray(vec, float)
    w, qx, qy, qz = quat[..., 0], quat[..., 1], quat[..., 2], quat[..., 3]
    x, y, z = vec[..., 0], vec[..., 1], vec[..., 2]
    # v + w t + q x t with t = 2 q x v, by component: np.cross takes twice as long.
    tx = 2.0 * (qy * z - qz * y)
    ty = 2.0 * (qz * x - qx * z)
    tz = 2.0 * (qx * y - qy * x)
    first = x + w * tx + (qy * tz - qz * ty)
    out = np.empty((*np.shape(first), 3))
    out[..., 0] = first
    out[..., 1] = y + w * ty + (qz * tx - qx * tz)
    out[..., 2] = z + w * tz + (qx * ty - qy * tx)
    return out


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors ``(..., 3)`` scaled to length 1; those shorter than 1e-9 stay shorter."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Geodesic angle in radians ``(...)`` between quaternions wxyz ``(..., 4)``."""
    d = quat_multiply(quat_conjugate(a), b)
    return 2.0 * np.arctan2(np.linalg.norm(d[..., 1:], axis=-1), np.abs(d[..., 0]))


def heading(quat: np.ndarray) -> np.ndarray:
    """Yaw in radians ``(...)``: the direction of the rotated x axis on the floor."""
    quat = np.asarray(quat, float)
    w, x, y, z = (quat[..., i] for i in range(4))
    return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def yaw_quat(yaw: np.ndarray) -> np.ndarray:
    """Quaternions wxyz ``(..., 4)`` of a turn by ``yaw`` radians about z."""
    yaw = np.asarray(yaw, float)
    zero = np.zeros_like(yaw)
    return np.stack([np.cos(yaw / 2), zero, zero, np.sin(yaw / 2)], axis=-1)


def continuous(quat: np.ndarray) -> np.ndarray:
    """The same rotations with signs such that neighbours along axis 0 are close ``(T, ..., 4)``."""
    quat = np.array(quat, float)
    flip = np.sum(quat[1:] * quat[:-1], axis=-1) < 0
    sign = np.where(np.cumsum(flip, axis=0) % 2 == 1, -1.0, 1.0)
    quat[1:] *= sign[..., None]
    return quat


def resample_quat(quat: np.ndarray, times: np.ndarray, new_times: np.ndarray) -> np.ndarray:
    """Slerp of ``(T, ..., 4)`` from ``times`` ``(T,)`` to ``new_times`` ``(N,)``, in seconds.

    Same result as SciPy's ``Slerp``, but for all joints at once; one joint at a time takes four
    times as long.
    """
    quat = np.asarray(quat, float)
    before = np.maximum(np.searchsorted(times, new_times) - 1, 0)
    share = (new_times - times[before]) / np.diff(times)[before]
    start, end = as_rotation(quat[before]), as_rotation(quat[before + 1])
    turn = (start.inv() * end).as_rotvec()
    turn *= np.repeat(share, len(turn) // len(new_times))[:, None]
    turned = start * from_rotvec(turn)
    return as_quat(turned, (len(new_times), *quat.shape[1:-1]))


def resample_points(points: np.ndarray, times: np.ndarray, new_times: np.ndarray) -> np.ndarray:
    """Points ``(T, ..., 3)`` at ``times`` ``(T,)``, interpolated linearly to ``new_times``."""
    columns = points.reshape(len(points), -1).T
    at = np.stack([np.interp(new_times, times, column) for column in columns], axis=-1)
    return at.reshape(*new_times.shape, *points.shape[1:])


def resample_poses(
    position: np.ndarray, quat: np.ndarray, times: np.ndarray, new_times: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Poses ``(T, ..., 3)``, ``(T, ..., 4)`` at ``times``, interpolated to ``new_times`` ``(N,)``.

    The quaternions may change their signs from frame to frame.
    """
    at = resample_points(position, times, new_times)
    return at, resample_quat(continuous(quat), times, new_times)


def angular_velocity(quat: np.ndarray, fps: float) -> np.ndarray:
    """World angular velocity in rad/s ``(T, ..., 3)`` of quaternions ``(T, ..., 4)``.

    Central differences, one-sided at both ends; a single frame is at rest.
    """
    quat = np.asarray(quat, float)
    if len(quat) < 2:
        return np.zeros((*quat.shape[:-1], 3))
    last = np.minimum(np.arange(len(quat)) + 1, len(quat) - 1)
    first = np.maximum(np.arange(len(quat)) - 1, 0)
    delta = quat_multiply(quat[last], quat_conjugate(quat[first]))
    rotvec = as_rotation(delta).as_rotvec().reshape(*quat.shape[:-1], 3)
    seconds = (last - first) / fps
    return rotvec / seconds.reshape(-1, *([1] * (quat.ndim - 1)))
