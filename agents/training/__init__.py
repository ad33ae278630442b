"""Training of torque policies: stages, PPO, DAgger.

Public names are imported on first use, so that importing a submodule loads nothing else.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from agents.training.options import TrainArgs
    from agents.training.train_policy import train

_HOMES = {"TrainArgs": "agents.training.options", "train": "agents.training.train_policy"}
__all__ = ["TrainArgs", "train"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
