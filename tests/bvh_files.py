"""A small BVH file of a person with CMU's joint names who shifts weight, to be damaged by tests."""

from __future__ import annotations

import math
from dataclasses import dataclass

# Name, and for each child a sub-tree; offsets in centimetres, y up, facing +z.
Joint = tuple[str, tuple[float, float, float], list]


def _leg(side: str, x: float) -> Joint:
    toe: Joint = (f"{side}ToeBase", (0, -6, 14), [])
    foot: Joint = (f"{side}Foot", (0, -42, 0), [toe])
    shin: Joint = (f"{side}Leg", (0, -42, 0), [foot])
    return (f"{side}UpLeg", (x, -4, 0), [shin])


def _arm(side: str, x: float) -> Joint:
    hand: Joint = (f"{side}Hand", (25 * x, 0, 0), [])
    forearm: Joint = (f"{side}ForeArm", (28 * x, 0, 0), [hand])
    arm: Joint = (f"{side}Arm", (14 * x, 0, 0), [forearm])
    return (f"{side}Shoulder", (4 * x, 10, 0), [arm])


TRUNK: Joint = (
    "LowerBack", (0, 8, 0),
    [("Spine", (0, 12, 0), [
        ("Spine1", (0, 14, 0), [
            ("Neck", (0, 20, 0), [("Head", (0, 10, 0), [])]),
            _arm("Left", 1), _arm("Right", -1),
        ]),
    ])],
)  # fmt: skip
PERSON: Joint = ("Hips", (0, 0, 0), [_leg("Left", 9), _leg("Right", -9), TRUNK])
HIPS_HEIGHT = 96.0


@dataclass(frozen=True)
class BvhText:
    """How to write the file.

    Attributes:
        frames: number of frames.
        fps: frames a second.
        scale: factor on all lengths; 1 is centimetres.
    """

    frames: int = 60
    fps: float = 30.0
    scale: float = 1.0

    def __str__(self) -> str:
        rows, count = [], len(list(_names(PERSON)))
        for frame in range(self.frames):
            sway = math.sin(2 * math.pi * frame / 60)
            position = [2 * sway * self.scale, HIPS_HEIGHT * self.scale, 0.0]
            angles = [0.0] * (3 * count)
            angles[1] = 3 * sway
            rows.append(" ".join(f"{value:.4f}" for value in position + angles))
        motion = ["MOTION", f"Frames: {self.frames}", f"Frame Time: {1 / self.fps:.6f}"]
        lines = ["HIERARCHY", *_hierarchy(PERSON, "ROOT", self.scale), *motion, *rows]
        return "\n".join(lines) + "\n"


def _names(joint: Joint):
    yield joint[0]
    for child in joint[2]:
        yield from _names(child)


def _hierarchy(joint: Joint, keyword: str, scale: float) -> list[str]:
    name, offset, children = joint
    position = "6 Xposition Yposition Zposition" if keyword == "ROOT" else "3"
    lines = [
        f"{keyword} {name}",
        "{",
        "OFFSET " + " ".join(f"{value * scale:.4f}" for value in offset),
        f"CHANNELS {position} Zrotation Yrotation Xrotation",
    ]
    for child in children:
        lines += _hierarchy(child, "JOINT", scale)
    if not children:
        lines += ["End Site", "{", "OFFSET 0.0 0.0 1.0", "}"]
    return [*lines, "}"]
