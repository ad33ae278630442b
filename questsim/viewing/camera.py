"""Camera of a clip: constant direction, smooth path, everything in the picture."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from questsim import rotations as rot

FOVY_DEG = 35.0
"""Vertical field of view; narrow enough that limbs near the camera are not distorted."""


@dataclass(frozen=True)
class Camera:
    """A view in the parameters of MuJoCo's free camera.

    Attributes:
        lookat: ``(3,)`` the point in the middle of the picture, metres.
        distance: metres from the camera to ``lookat``.
        azimuth_deg: direction of view on the floor; 0 looks along +x, 90 along +y.
        elevation_deg: negative looks down.
        fovy_deg: vertical field of view.
    """

    lookat: np.ndarray
    distance: float
    azimuth_deg: float
    elevation_deg: float = -12.0
    fovy_deg: float = FOVY_DEG

    def axes(self) -> np.ndarray:
        """Unit vectors right, up and forward in the world, as rows ``(3, 3)``."""
        azimuth, elevation = np.radians([self.azimuth_deg, self.elevation_deg])
        forward = np.array(
            [
                np.cos(azimuth) * np.cos(elevation),
                np.sin(azimuth) * np.cos(elevation),
                np.sin(elevation),
            ]
        )
        right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
        return np.stack([right, np.cross(right, forward), forward])

    def project(self, points: np.ndarray, width: int, height: int) -> np.ndarray:
        """Pixels from the top left ``(..., 2)`` of points ``(..., 3)``; NaN behind the camera."""
        right, up, forward = np.moveaxis((points - self.lookat) @ self.axes().T, -1, 0)
        depth = forward + self.distance
        focal = height / 2.0 / np.tan(np.radians(self.fovy_deg) / 2.0)
        scale = focal / np.where(depth > 1e-3, depth, np.nan)
        return np.stack([width / 2.0 + right * scale, height / 2.0 - up * scale], axis=-1)


def three_quarter_azimuth(root_quat: np.ndarray) -> float:
    """Degrees that see people with root orientations ``(T, 4)`` from the front and a side.

    The direction is constant over the clip, because foot sliding only shows against a still floor.
    """
    yaw = rot.heading(root_quat)
    mean = np.arctan2(np.sin(yaw).mean(), np.cos(yaw).mean())
    return float(np.degrees(mean)) + 130.0


def following_cameras(
    points: np.ndarray,
    root: np.ndarray,
    azimuth_deg: float,
    aspect: float,
    smoothing_frames: float,
    margin: float = 0.84,
    fovy_deg: float = FOVY_DEG,
) -> list[Camera]:
    """A camera for each frame; it follows the root smoothly and keeps all points in the picture.

    Args:
        points: ``(T, n, 3)`` points to keep in the picture, metres.
        root: ``(T, 3)`` path to follow, metres.
        azimuth_deg: the direction of view.
        aspect: width of the picture over its height.
        smoothing_frames: standard deviation of the smoothing, both ways in time; 0 for none.
        margin: the part of the picture that the points may fill.
        fovy_deg: vertical field of view.
    """
    path = np.array(root, float)
    if smoothing_frames > 0:
        path[:, :2] = gaussian_filter1d(path[:, :2], smoothing_frames, axis=0, mode="nearest")
    path[:, 2] = (points[..., 2].min() + points[..., 2].max()) / 2.0
    camera = Camera(path[0], 0.0, azimuth_deg, fovy_deg=fovy_deg)
    right, up, forward = np.moveaxis((points - path[:, None]) @ camera.axes().T, -1, 0)
    tangent = np.tan(np.radians(fovy_deg) / 2.0) * margin
    needed = np.maximum(np.abs(right) / (tangent * aspect), np.abs(up) / tangent) - forward
    distance = max(float(needed.max()), 2.0)
    return [replace(camera, lookat=p, distance=distance) for p in path]
