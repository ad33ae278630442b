"""The avatar follows a live device stream: ``Follower``, ``Calibration`` and their parts."""

from agents.follower.calibration import Calibration, calibrate
from agents.follower.follower import Follower

__all__ = ["Calibration", "Follower", "calibrate"]
