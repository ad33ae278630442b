"""Run agents on clips and score them.

Public names are imported on first use, so that importing a submodule loads nothing else.
"""

from typing import TYPE_CHECKING

from questsim.lazy import imported_on_use

if TYPE_CHECKING:
    from agents.commands.evaluate import evaluate
    from agents.evaluation.options import EvaluateArgs
    from agents.evaluation.report import evaluation_context
    from agents.evaluation.rollout import Recorder, env_config, roll_out

_HOMES = {
    "EvaluateArgs": "agents.evaluation.options",
    "evaluate": "agents.commands.evaluate",
    "Recorder": "agents.evaluation.rollout",
    "evaluation_context": "agents.evaluation.report",
    "env_config": "agents.evaluation.rollout",
    "roll_out": "agents.evaluation.rollout",
}
__all__ = ["EvaluateArgs", "Recorder", "env_config", "evaluate", "evaluation_context", "roll_out"]

__getattr__ = imported_on_use(__name__, _HOMES)
