"""The forearm's axis in a controller, from palms that turn to and fro.

One pose of a hanging arm gives only the sum of arm and grip. When the forearm turns about its own
axis, the controller moves about that axis, which shows how the hand holds it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from questsim import rotations as rot
from questsim.devices import DeviceFrame
from questsim.errors import InputError

LEAST_TURN_DEG, LEAST_FRAMES = 40.0, 40
"""Smallest turn of the palms, from one side to the other, and number of frames."""
OFF_AXIS_M = 0.015
"""Largest root mean square distance of the positions from a turn about one axis."""


class ForearmAxis(NamedTuple):
    """A line in the axes of a controller's reported pose.

    Attributes:
        offset: ``(3,)`` metres from the line to the controller, perpendicular to it.
        direction: ``(3,)`` unit vector towards the elbow.
    """

    offset: np.ndarray
    direction: np.ndarray


def forearm_axis(frames: Iterable[DeviceFrame], name: str) -> ForearmAxis | None:
    """The axis about which a controller turned; None if it never reports.

    With orientations ``Q`` and positions ``p`` of the controller, ``p = c + Q d`` is solved for the
    fixed point ``c`` and the offset ``d`` by least squares.

    Args:
        frames: the user turns the palms of the hanging, straight arms to and fro.
        name: the controller.

    Raises:
        InputError: it turned too little, or moved otherwise.
    """
    seen = [frame.poses[name] for frame in frames if name in frame.poses]
    if not seen:
        return None
    place = np.array([pose.position for pose in seen])
    turned = rot.as_rotation(np.array([pose.quat for pose in seen]))
    about = (turned.mean().inv() * turned).as_rotvec()
    direction = np.linalg.svd(about, full_matrices=False)[2][0]
    wide = float(np.degrees(np.ptp(np.percentile(about @ direction, [5, 95]))))
    if len(seen) < LEAST_FRAMES or wide < LEAST_TURN_DEG:
        raise InputError(
            f"{name} turned by {wide:.0f} degrees in {len(seen)} frames",
            "calibration",
            "turn both palms to the front and to the back, several times",
        )
    if turned.mean().apply(direction)[2] < 0.0:
        direction = -direction
    across = np.linalg.svd(direction[None])[2][1:].T
    matrices = turned.as_matrix()
    known = ((matrices - matrices.mean(0)) @ across).reshape(-1, 2)
    moved = (place - place.mean(0)).ravel()
    found = np.linalg.lstsq(known, moved, rcond=None)[0]
    rest = (moved - known @ found).reshape(-1, 3)
    if np.sqrt((rest**2).sum(-1).mean()) > OFF_AXIS_M:
        raise InputError(
            f"{name} moved, besides its turn",
            "calibration",
            "let the arms hang straight while the palms turn",
        )
    return ForearmAxis(across @ found, direction)
