"""The avatar follows a live stream of devices: ``Follower``, ``Calibration`` and what they use."""

from agents.follower.calibration import Calibration, calibrate
from agents.follower.follower import Follower

__all__ = ["Calibration", "Follower", "calibrate"]
