"""The proportions of a motion's person, measured on the skeleton."""

from __future__ import annotations

import numpy as np

from questsim.body import DEFAULT_HEIGHT_M
from questsim.body_proportions import Proportions, default_places
from questsim.errors import InputError
from questsim.motion.motion import Motion
from questsim.skeleton import JOINT_PARENTS, JOINTS, LINKS

_SIDES = ("left", "right")
_MIN_NECK = 0.01
"""A neck joint that is not this far above the shoulders, as a share of the stature, lies inside
the chest (as in CMU's skeletons), where no head begins: the neck follows from the stature then."""


def own_body(motion: Motion, height: float) -> Proportions:
    """The proportions of a motion's person, left and right alike.

    Spine, chest, head and limbs begin where the skeleton's joints are in the rest pose. Feet and
    hands keep the default body's size for that stature.

    Args:
        motion: its skeleton is measured.
        height: the person's stature in metres.

    Raises:
        InputError: a part is shorter or longer than bodies may have it.
    """
    rest = _rest(motion.offsets) * (DEFAULT_HEIGHT_M / height)
    length = np.linalg.norm(motion.offsets, axis=-1) * (DEFAULT_HEIGHT_M / height)
    usual, places = default_places(), default_places()

    def both(name: str, values: np.ndarray) -> np.ndarray:
        """Mean of a left and the mirrored right joint."""
        left, right = (values[JOINTS.index(f"{side}_{name}")] for side in _SIDES)
        return (left + right * ([1.0, -1.0, 1.0] if np.ndim(left) else 1.0)) / 2.0

    spine, chest, neck = (
        rest[JOINTS.index(name)] * [1.0, 0.0, 1.0] for name in ("spine1", "spine2", "neck")
    )
    shoulder, hip = both("shoulder", rest), both("hip", rest)
    places[LINKS.index("spine")], places[LINKS.index("chest")] = spine, chest - spine
    for side, sign in zip(_SIDES, (1.0, -1.0), strict=True):
        mirrored = np.array([1.0, sign, 1.0])
        places[LINKS.index(f"{side}_upper_arm")] = (shoulder - chest) * mirrored
        places[LINKS.index(f"{side}_thigh")] = np.array([0.0, hip[1], 0.0]) * mirrored
        for joint, link in (
            ("knee", "shin"), ("ankle", "foot"), ("elbow", "forearm"), ("wrist", "hand"),
        ):  # fmt: skip
            row = LINKS.index(f"{side}_{link}")
            places[row] = usual[row] / np.linalg.norm(usual[row]) * both(joint, length)
    if neck[2] < shoulder[2] + _MIN_NECK * DEFAULT_HEIGHT_M:
        legs = sum(usual[LINKS.index(f"left_{n}"), 2] - places[LINKS.index(f"left_{n}"), 2]
                   for n in ("shin", "foot"))  # fmt: skip
        top = usual[[LINKS.index(n) for n in ("spine", "chest", "head")], 2].sum()
        neck = np.array([shoulder[0], 0.0, top + legs])
    places[LINKS.index("head")] = neck - chest
    try:
        return Proportions(tuple(map(tuple, places.tolist())))
    except InputError as error:
        raise InputError(error.what, motion.name, "leave out its own proportions") from None


def _rest(offsets: np.ndarray) -> np.ndarray:
    """``(22, 3)`` places of the joints in the rest pose, from midway between the hips."""
    place = np.zeros((len(JOINTS), 3))
    for joint in range(1, len(JOINTS)):
        place[joint] = place[JOINT_PARENTS[joint]] + offsets[joint]
    hips = [JOINTS.index(f"{side}_hip") for side in _SIDES]
    return place - place[hips].mean(axis=0)
