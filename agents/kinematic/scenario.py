"""What a kinematic system is given in a comparison, and its variants in ablations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from questsim.sensors import SENSOR_SETS
from questsim.skeleton import JOINTS

PAPER_NAMES = {"H+2C": "HMD", "H+2C+2IMU": "HMD+2IMU", "H+2C+3IMU": "HMD+3IMU"}
"""Names of sets of sensors in HMD-Poser's and LGSIK-Poser's papers."""
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
    """What a system is given.

    Attributes:
        name: for the table.
        devices: of the sensors.
        faults: probability a frame that one device falls silent.
        options: of the system.
        online: every frame from the last ``WINDOW`` frames alone.
    """

    name: str
    devices: tuple[str, ...]
    faults: float = 0.0
    options: tuple[tuple[str, Any], ...] = ()
    online: bool = False

    @property
    def plain(self) -> bool:
        """Whether the system is used as it is made for, by working devices, on a stream."""
        return not (self.online or self.options or self.faults)

    @property
    def ends(self) -> tuple[int, ...]:
        """Joints at the body's ends that carry a device, for the error of end effectors."""
        return tuple(JOINTS.index(_END_OF[name]) for name in self.devices if name in _END_OF)

    def has(self, devices: Sequence[str] | None) -> bool:
        """Whether it is of just these devices, wherever on the feet; None means any."""
        return devices is None or _on_feet(devices) == _on_feet(self.devices)


def _on_feet(devices: Sequence[str]) -> set[str]:
    """Devices, with trackers on toes and on ankles called alike."""
    return {device.replace("_toe_", "_foot_") for device in devices}


HANDS = ("left_controller", "right_controller")
SIX = (
    "pelvis_tracker", "headset", *HANDS, "left_foot_tracker", "right_foot_tracker",
)  # fmt: skip
SIX_TRACKERS = (Scenario("6", SENSOR_SETS["6T"]),)
"""Of a system that says nothing else."""


@dataclass(frozen=True)
class Variant:
    """A system without one of its parts.

    Attributes:
        name: for the table, and of its folder.
        what: what is left out, and where the ablation is from.
        set: values of the preset, as of ``--set``.
        options: of ``load_system``, for a variant that is the full system's weights run otherwise.
    """

    name: str
    what: str
    set: tuple[str, ...] = ()
    options: tuple[tuple[str, Any], ...] = ()
