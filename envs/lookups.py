"""Compiled helpers of the kernels: places, rotations, and the ground at a point."""

from __future__ import annotations

import math

from questsim.compiled import jit


@jit
def heading(w, x, y, z):
    """Cosine and sine of the heading of a quaternion."""
    forward_x = 1 - 2 * (y * y + z * z)
    forward_y = 2 * (w * z + x * y)
    length = math.sqrt(forward_x * forward_x + forward_y * forward_y)
    if length < 1e-9:
        return 1.0, 0.0
    return forward_x / length, forward_y / length


@jit
def _cell(values, grid, x, y):
    """Row, column and position within the cell of a grid point; clamped to the grid's edge."""
    rows, columns = values.shape
    across = min(max((x - grid[0]) / grid[2], 0.0), columns - 1.0)
    along = min(max((y - grid[1]) / grid[2], 0.0), rows - 1.0)
    column, row = min(int(across), columns - 2), min(int(along), rows - 2)
    return row, column, across - column, along - row


@jit
def ground_at(ground, grid, x, y):
    """``HeightField.ground_at`` of one point; a field of one number is a plane at zero."""
    if ground.size == 1:
        return 0.0
    row, column, u, v = _cell(ground, grid, x, y)
    near = ground[row, column] * (1.0 - u) + ground[row, column + 1] * u
    far = ground[row + 1, column] * (1.0 - u) + ground[row + 1, column + 1] * u
    return near * (1.0 - v) + far * v


@jit
def height_at(height, grid, x, y):
    """``HeightField.height_at`` of one point; a field of one number is a plane at zero."""
    if height.size == 1:
        return 0.0
    row, column, u, v = _cell(height, grid, x, y)
    low, right = height[row, column], height[row, column + 1]
    up, far = height[row + 1, column], height[row + 1, column + 1]
    if u >= v:
        return low + u * (right - low) + v * (far - right)
    return low + v * (up - low) + u * (far - up)


@jit
def turned(place, x, y):
    """Turn a horizontal vector of a clip into the world."""
    return place[2] * x - place[3] * y, place[3] * x + place[2] * y


@jit
def placed(place, x, y):
    """World position of a point of a clip."""
    turned_x, turned_y = turned(place, x, y)
    return place[0] + turned_x, place[1] + turned_y


@jit
def unplaced(place, quat):
    """A world quaternion in the clip's coordinates, before the turn to its place."""
    half_c = math.sqrt(max(0.5 * (1.0 + place[2]), 0.0))
    half_s = math.sqrt(max(0.5 * (1.0 - place[2]), 0.0))
    if place[3] < 0.0:
        half_s = -half_s
    w, x, y, z = quat[0], quat[1], quat[2], quat[3]
    return (
        half_c * w + half_s * z,
        half_c * x + half_s * y,
        half_c * y - half_s * x,
        half_c * z - half_s * w,
    )


@jit
def product(p, q):
    """Product of two quaternions, as tuples."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )
