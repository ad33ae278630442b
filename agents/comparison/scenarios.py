"""What each kinematic system is given in a comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from agents.kinematic.dragposer.solver import DragPoser
from agents.kinematic.interface import KinematicSystem
from agents.kinematic.recurrent.poser import RecurrentPoser
from agents.kinematic.sparseposer.poser import SparsePoser
from questsim.joint_sensors import SensorSequence
from questsim.sensors import SENSOR_SETS
from questsim.skeleton import JOINTS

WINDOW = 40
"""Frames of the online protocol's sliding window (LGSIK-Poser)."""
SILENT_FRAMES = 100
"""A faulty tracker returns after so many frames (DragPoser)."""
RECURRENT_SETS = {"HMD": "H+2C", "HMD+2IMU": "H+2C+2IMU", "HMD+3IMU": "H+2C+3IMU"}
"""The papers' names of sets of sensors."""


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


_HANDS = ("left_controller", "right_controller")
SIX = (
    "pelvis_tracker", "headset", *_HANDS, "left_foot_tracker", "right_foot_tracker",
)  # fmt: skip

DRAG_SCENARIOS: tuple[Scenario, ...] = (
    Scenario("3 head+hands", ("headset", *_HANDS)),
    Scenario("3 hip+hands", ("pelvis_tracker", *_HANDS)),
    Scenario("4", SIX[:4]),
    Scenario("5 no left foot", (*SIX[:4], "right_foot_tracker")),
    Scenario("6", SIX),
    Scenario("6, 1 iteration", SIX, options=(("iterations", 1),)),
    Scenario("6 position only", SIX, options=(("rotations", False),)),
    Scenario("faulty 0.5 %", SIX, faults=0.005),
    Scenario("faulty 1 %", SIX, faults=0.01),
)
"""Those of DragPoser's table 2, and one iteration a frame."""


def scenarios(system: KinematicSystem) -> tuple[Scenario, ...]:
    """The scenarios that suit a system."""
    if isinstance(system, DragPoser):
        return DRAG_SCENARIOS
    if isinstance(system, RecurrentPoser):
        sets = [(name, SENSOR_SETS[key]) for name, key in RECURRENT_SETS.items()]
        return tuple(
            Scenario(name + (", window 40" if online else ""), devices, online=online)
            for online in (False, True)
            for name, devices in sets
        )
    if isinstance(system, SparsePoser):
        late = Scenario("6, 7 frames late", SENSOR_SETS["6T"], options=(("future_frames", 7),))
        return (Scenario("6", SENSOR_SETS["6T"]), late)
    return (Scenario("6", SENSOR_SETS["6T"]),)


def faulty(sequence: SensorSequence, probability: float, seed: int) -> SensorSequence:
    """Each frame one device falls silent with that probability, and returns after 100 frames.

    Source: DragPoser's faulty trackers. Never all of them: the first that is asked stays.
    """
    rng, present = np.random.default_rng(seed), sequence.present.copy()
    for frame in range(1, len(sequence)):
        if rng.random() < probability:
            device = int(rng.integers(present.shape[1]))
            if present[frame].sum() > 1:
                present[frame : frame + SILENT_FRAMES, device] = False
    return replace(sequence, present=present)
