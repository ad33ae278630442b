"""Bodies of the user's own: an MJCF and a map of its links, instead of our humanoid.

``description`` reads the file, ``body_map`` compiles the MJCF and measures it, ``retarget`` makes
its clips from those of our avatar, ``torques`` their inverse dynamics. The names below are imported
on first use: few tasks have such a body.
"""

from typing import TYPE_CHECKING

from questsim.lazy import imported_on_use

if TYPE_CHECKING:
    from questsim.bodies.body_map import BodyMap, map_of, read_body
    from questsim.bodies.own_body import OwnBody
    from questsim.bodies.retarget import clip_for, clips_for

__all__ = ["BodyMap", "OwnBody", "clip_for", "clips_for", "map_of", "read_body"]

__getattr__ = imported_on_use(
    __name__,
    {
        "BodyMap": "questsim.bodies.body_map",
        "OwnBody": "questsim.bodies.own_body",
        "clip_for": "questsim.bodies.retarget",
        "clips_for": "questsim.bodies.retarget",
        "map_of": "questsim.bodies.body_map",
        "read_body": "questsim.bodies.body_map",
    },
)
