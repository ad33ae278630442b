"""Why a training stage stops before its time."""

from __future__ import annotations

from questsim.errors import InputError


class TrainingError(InputError):
    """Training cannot go on; what was saved before is good.

    Args:
        what: what went wrong, e.g. ``"the loss is not finite"``.
        steps: environment steps of the stage at which it was noticed.
    """

    def __init__(self, what: str, steps: int) -> None:
        super().__init__(what, f"training step {steps}", "the last checkpoint before it is kept")
