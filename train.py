"""Train: ``python train.py --preset cpu --motions bandai-namco-2:train --out runs/NAME``."""

from __future__ import annotations

import os
import sys

# Threads that spin while they wait for work starve the physics threads next to them.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from agents.commands.modes import TRAIN
from questsim.cli import run_modes

if __name__ == "__main__":
    sys.exit(run_modes(TRAIN))
