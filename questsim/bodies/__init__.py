"""Bodies of the user's own: an MJCF and a map of its links, instead of our humanoid.

``description`` reads the file, ``body_map`` compiles the MJCF and measures it, ``retarget`` makes
its clips from those of our avatar, ``torques`` their inverse dynamics.
"""

from questsim.bodies.body_map import BodyMap, OwnBody, map_of, read_body
from questsim.bodies.retarget import clip_for, clips_for

__all__ = ["BodyMap", "OwnBody", "clip_for", "clips_for", "map_of", "read_body"]
