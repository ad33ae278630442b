"""Checks of the messages of a page: sizes, rates, numbers and times."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from questsim.devices import DeviceFrame
from questsim.errors import InputError
from questsim.sensors import SENSOR_SETS

MAX_BYTES = 4096
"""Largest message in bytes; a message of three devices has 500."""
MAX_PER_SECOND = 200.0
"""Largest number of messages per second; headsets send 72 to 120. Excess frames are dropped."""
MAX_FAULTS = 20
"""A client with more invalid messages is disconnected."""
MAX_TIME_S = 1e9
DEVICES = SENSOR_SETS["H+2C"]
"""Devices of a page."""


class Allowance:
    """A token bucket that refills at ``rate`` messages per second and holds one second of them.

    Args:
        rate: messages per second.
        clock: returns the time in seconds.
    """

    def __init__(self, rate: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._clock = rate, clock
        self._left, self._at = rate, clock()

    def take(self) -> bool:
        """Whether one more message is allowed now."""
        now = self._clock()
        self._left = min(self._rate, self._left + (now - self._at) * self._rate)
        self._at = now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


def read_message(text: str) -> dict[str, Any]:
    """Parse a page's message: a JSON object with a ``type``.

    Raises:
        InputError: the message is not such an object.
    """
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        raise InputError("is not JSON", "message") from None
    if not isinstance(message, dict) or not isinstance(message.get("type"), str):
        raise InputError("is not an object with a type", "message")
    return message


def frame_of(message: dict[str, Any]) -> DeviceFrame:
    """Parse a WebXR frame ``{"type": "frame", "t": seconds, "headset": [7 numbers], ...}``.

    Raises:
        InputError: unexpected devices, invalid poses or an invalid time.
    """
    time_s = message.get("t")
    if isinstance(time_s, bool) or not isinstance(time_s, int | float):
        raise InputError("t is not a number", "frame")
    if not 0.0 <= time_s <= MAX_TIME_S:
        raise InputError(f"t is not within 0 to {MAX_TIME_S:g} s", "frame")
    poses = {name: value for name, value in message.items() if name not in ("type", "t")}
    for name, value in poses.items():
        if name not in DEVICES:
            raise InputError(f"has {name[:40]!r}, which is not a device of a page", "frame")
        numbers = isinstance(value, list) and all(type(x) in (int, float) for x in value)
        if not numbers or len(value) != 7:
            raise InputError(f"{name} is not 7 numbers", "frame")
    return DeviceFrame.of(float(time_s), poses, "openxr")


def rounded(values: np.ndarray, decimals: int = 4) -> list[float]:
    """An array as a flat list for JSON."""
    return np.round(values, decimals).ravel().tolist()
