"""Training of torque policies: stages, PPO, DAgger.

Public names are imported on first use, so that importing a submodule loads nothing else.
"""

from typing import TYPE_CHECKING

from questsim.lazy import imported_on_use

if TYPE_CHECKING:
    from agents.training.options import TrainArgs
    from agents.training.train_policy import train

_HOMES = {"TrainArgs": "agents.training.options", "train": "agents.training.train_policy"}
__all__ = ["TrainArgs", "train"]

__getattr__ = imported_on_use(__name__, _HOMES)
