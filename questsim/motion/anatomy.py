"""Checks that a motion has human bone proportions and joints that bend the right way."""

from __future__ import annotations

import numpy as np

from questsim import rotations as rot
from questsim.motion.motion import Motion
from questsim.skeleton import JOINT_PARENTS, JOINTS

RATIOS: tuple[tuple[str, tuple[str, ...], tuple[str, ...], float, float], ...] = (
    ("shin and thigh", ("ankle",), ("knee",), 0.6, 1.6),
    ("forearm and upper arm", ("wrist",), ("elbow",), 0.45, 1.6),
    ("arm and leg", ("elbow", "wrist"), ("knee", "ankle"), 0.35, 1.1),
    ("foot and shin", ("toe",), ("ankle",), 0.05, 0.9),
)
"""Name, compared bones (each named by its lower joint), smallest and largest ratio.

Of people they are 0.8-1.1, 0.7-0.9, 0.6-0.75 and 0.4-0.5 (Drillis and Contini 1966); skeletons of
mocap software differ more, because their joints are placed differently.
"""
TRUNK_RATIO = (0.3, 0.9)
"""Hips to shoulders, as a share of thigh and shin. In skeletons of people measured 0.46-0.68, of
quadrupeds 1.1-1.2."""
PAIRS = (("thigh", "knee"), ("shin", "ankle"), ("upper arm", "elbow"), ("forearm", "wrist"))
MAX_ASYMMETRY = 0.3
"""Largest difference between a left and a right bone as a share of their mean."""
MIN_ELBOW = 0.4
"""An implausible mean backward bend of both elbows; hands behind the back stay below it."""
MIN_BEND = 0.2
"""A limb must bend by this much (sine) on average before its direction counts."""


def anatomy_problems(motion: Motion) -> list[str]:
    """One clause for each anatomical implausibility; empty if there is none."""
    return proportion_problems(motion) + _bends(motion)


def proportion_problems(motion: Motion) -> list[str]:
    """One clause for each bone whose length, compared with others, is not human."""
    length = {
        name: float(np.linalg.norm(motion.offsets[joint])) for joint, name in enumerate(JOINTS)
    }
    out = []
    for name, above, below, low, high in RATIOS:
        ratio = _total(length, above) / max(_total(length, below), 1e-9)
        if not low <= ratio <= high:
            out.append(f"{name} are as {ratio:.2f} to 1, not {low:g}-{high:g}")
    ratio = _trunk(motion) / max(_total(length, ("knee", "ankle")) / 2.0, 1e-9)
    if not TRUNK_RATIO[0] <= ratio <= TRUNK_RATIO[1]:
        out.append(
            f"trunk and leg are as {ratio:.2f} to 1, not {TRUNK_RATIO[0]:g}-{TRUNK_RATIO[1]:g}: "
            "not a person's skeleton"
        )
    for part, bone in PAIRS:
        sides = [length[f"{side}_{bone}"] for side in ("left", "right")]
        if abs(sides[0] - sides[1]) > MAX_ASYMMETRY * sum(sides) / 2.0:
            out.append(f"the left and right {part} are {sides[0]:.2f} and {sides[1]:.2f} m long")
    return out


def _total(length: dict[str, float], bones: tuple[str, ...]) -> float:
    return sum(length[f"{side}_{bone}"] for side in ("left", "right") for bone in bones)


def _trunk(motion: Motion) -> float:
    """Metres from the middle of the hips to the middle of the shoulders in the T-pose."""
    place = np.zeros((len(JOINTS), 3))
    for joint, parent in enumerate(JOINT_PARENTS):
        if joint:
            place[joint] = place[parent] + motion.offsets[joint]

    def middle(part: str) -> np.ndarray:
        return (place[JOINTS.index(f"left_{part}")] + place[JOINTS.index(f"right_{part}")]) / 2.0

    return float(np.linalg.norm(middle("shoulder") - middle("hip")))


def _bends(motion: Motion) -> list[str]:
    """Knees and elbows that bend backwards relative to the front given by hips and toes."""
    position, _ = motion.forward_kinematics()

    def at(name: str) -> np.ndarray:
        return position[:, JOINTS.index(name)]

    out = []
    for side in ("left", "right"):
        thigh, shin = (
            at(f"{side}_{b}") - at(f"{side}_{a}") for a, b in (("hip", "knee"), ("knee", "ankle"))
        )
        foot = at(f"{side}_toe") - at(f"{side}_ankle")
        # The toes must point to the side where the knee is off the line from hip to ankle.
        ahead = rot.unit(thigh) - rot.unit(shin)
        along = rot.unit(shin)
        foot = rot.unit(foot - np.sum(foot * along, axis=-1, keepdims=True) * along)
        bend = np.sum(ahead * foot, axis=-1)
        if np.mean(abs(bend)) > MIN_BEND and np.mean(bend) < -0.5 * np.mean(abs(bend)):
            out.append(f"the {side} knee bends backwards: its axes or left and right are wrong")
    left = at("left_shoulder") - at("right_shoulder")
    front = rot.unit(np.cross(left, at("neck") - at("spine1")))
    elbows = np.stack(
        [
            rot.unit(at(f"{side}_wrist") - at(f"{side}_elbow"))
            - rot.unit(at(f"{side}_elbow") - at(f"{side}_shoulder"))
            for side in ("left", "right")
        ]
    )
    bend = np.sum(elbows * front, axis=-1)
    if (bend.mean(axis=1) < -MIN_ELBOW).all() and (bend < 0).mean() > 0.9:
        out.append("both elbows bend backwards: the axes or left and right are wrong")
    return out
