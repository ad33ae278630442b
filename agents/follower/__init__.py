"""The avatar follows a live device stream: ``Follower``, ``Calibration`` and their parts.

Public names are imported on first use, so that importing a submodule loads nothing else.
"""

from typing import TYPE_CHECKING

from questsim.lazy import imported_on_use

if TYPE_CHECKING:
    from agents.follower.calibration import Calibration, calibrate
    from agents.follower.follower import Follower

_HOMES = {
    "Calibration": "agents.follower.calibration",
    "Follower": "agents.follower.follower",
    "calibrate": "agents.follower.calibration",
}
__all__ = ["Calibration", "Follower", "calibrate"]

__getattr__ = imported_on_use(__name__, _HOMES)
