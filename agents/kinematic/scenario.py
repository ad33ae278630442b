"""Scenarios of kinematic systems in a comparison, and variants in ablations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from questsim.sensors import SENSOR_SETS
from questsim.skeleton import JOINTS

PAPER_NAMES = {"H+2C": "HMD", "H+2C+2IMU": "HMD+2IMU", "H+2C+3IMU": "HMD+3IMU"}
"""Names of the sensor sets in HMD-Poser's and LGSIK-Poser's papers."""
WINDOW = 40
"""Frames of the online protocol's sliding window (LGSIK-Poser)."""
_END_OF = {
    "headset": "head",
    **{f"{side}_controller": f"{side}_wrist" for side in ("left", "right")},
    **{f"{side}_toe_tracker": f"{side}_toe" for side in ("left", "right")},
    **{f"{side}_foot_tracker": f"{side}_ankle" for side in ("left", "right")},
}


@dataclass(frozen=True)
class Scenario:
    """The input of a system in a comparison.

    Attributes:
        name: name in the table.
        devices: the devices.
        faults: probability per frame that a device drops out.
        options: options of the system.
        online: whether each frame is estimated from only the last ``WINDOW`` frames.
    """

    name: str
    devices: tuple[str, ...]
    faults: float = 0.0
    options: tuple[tuple[str, Any], ...] = ()
    online: bool = False

    @property
    def plain(self) -> bool:
        """Whether it is plain streaming: default options, no faults, not ``online``."""
        return not (self.online or self.options or self.faults)

    @property
    def ends(self) -> tuple[int, ...]:
        """End-effector joints that carry a device, for the error of end effectors."""
        return tuple(JOINTS.index(_END_OF[name]) for name in self.devices if name in _END_OF)

    def has(self, devices: Sequence[str] | None) -> bool:
        """Whether it has exactly these devices, at any place on the feet; None matches all."""
        return devices is None or _on_feet(devices) == _on_feet(self.devices)


def _on_feet(devices: Sequence[str]) -> set[str]:
    """Devices, with toe and ankle trackers treated as the same."""
    return {device.replace("_toe_", "_foot_") for device in devices}


HANDS = ("left_controller", "right_controller")
SIX = (
    "pelvis_tracker", "headset", *HANDS, "left_foot_tracker", "right_foot_tracker",
)  # fmt: skip
SIX_TRACKERS = (Scenario("6", SENSOR_SETS["6T"]),)
"""Default scenarios of a system."""


@dataclass(frozen=True)
class Variant:
    """A system without one of its parts.

    Attributes:
        name: name in the table and of its folder.
        what: the removed part, and the source of the ablation.
        set: changed values of the preset, as in ``--set``.
        options: options of ``load_system``, for a variant that uses the full system's weights.
        args: changed options of its training.
    """

    name: str
    what: str
    set: tuple[str, ...] = ()
    options: tuple[tuple[str, Any], ...] = ()
    args: tuple[tuple[str, Any], ...] = ()
