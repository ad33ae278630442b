"""Compile the loops into numba's cache: once, before several test processes need them at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agents.kinematic.interface import UserBody
from agents.kinematic.store import load_system
from envs import BatchSim, EnvConfig, Terrain
from questsim.bodies import read_body
from questsim.joint_sensors import readings
from questsim.motion.retarget_back import to_motion
from questsim.sensors import sensor_set
from tests.helpers import swaying_clip

GROUND = EnvConfig(terrain=Terrain("rough", size_m=10.0), height_scan=True)
BODY = replace(GROUND, body=read_body("gymnasium-humanoid"))
BATCHES = ((EnvConfig(), 1), (EnvConfig(), 2), (GROUND, 2), (BODY, 1))
"""Options and number of simulations: one simulation's arrays have another layout than several's."""


def main() -> None:
    """Run every loop with the types and layouts of arguments that it is used with."""
    clip = swaying_clip()
    for config, number in BATCHES:
        sim = BatchSim([clip], config, number)
        sim.reset()
        sim.step(np.zeros((number, len(sim.avatar.dofs))))
        sim.placed_clip(0, clip)
    motion = to_motion(clip)
    for name in ("hmdposer", "lgsik"):
        load_system(name).predict(readings(motion, sensor_set("H+2C")), UserBody.of(motion))


if __name__ == "__main__":
    main()
