"""From a mocap file to a clip of the avatar: readers, retargeting, libraries, synthesis."""

from questsim.motion.clip import FPS, Clip
from questsim.motion.motion import Motion

__all__ = ["FPS", "Clip", "Motion"]
