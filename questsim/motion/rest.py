"""Finds the axes of a file's joints in our T-pose, from its offsets or from its motion.

If the zero pose or the first frame is a standing person with straight limbs (T, A or I pose, or
arms down), the axes are taken from it; ``convert`` rotates its limbs to the T-pose by the shortest
rotation. Otherwise the axes come from the motion: the hinge axes are those about which knees and
elbows bend; the trunk's up axis is the line from hips to shoulders, the head's is the vertical,
both averaged over the frames with an upright performer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from questsim import rotations as rot
from questsim.motion.convert import global_pose
from questsim.motion.recording import Recording
from questsim.skeleton import JOINT_PARENTS, JOINTS

SIDES = ("left", "right")
MAX_FRAMES = 300
SNAP = np.cos(np.radians(8.0))
SPLAY = np.cos(np.radians(12.0))
"""If the legs are further apart than this in the rest pose, the feet are splayed with the shins."""
TRUNK_ENDS = ("hip", "shoulder")
ON_FEET = 0.7
"""Cosine of the trunk to the vertical in frames that show how the feet stand."""
MIN_BEND = 0.1
"""Below this mean sine of the hinge angle, a limb bends too little to find its axis."""

Places = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Rest:
    """The rest pose's axes.

    Attributes:
        axes: for each of our joints that the file has, forward, left and up as columns in the
            joint's own frame ``(3, 3)``.
        how: how they were found.
        feet_follow_shins: whether the feet are splayed with the legs.
    """

    axes: dict[str, np.ndarray]
    how: str
    feet_follow_shins: bool = False


def some_frames(recording: Recording, count: int = MAX_FRAMES) -> Recording:
    """At most ``count`` frames, evenly spread; the first is always among them."""
    every = max(1, -(-len(recording.positions) // count))
    return replace(
        recording,
        positions=recording.positions[::every],
        rotations=recording.rotations[::every],
    )


def zero_pose(recording: Recording) -> Recording:
    """One frame of the skeleton with all rotations zero and its median offsets."""
    rotations = np.zeros((1, *recording.rotations.shape[1:]))
    rotations[..., 0] = 1.0
    positions = np.median(recording.positions, axis=0)[None]
    return replace(recording, positions=positions, rotations=rotations)


def find_rest(recording: Recording, joints: Mapping[str, str]) -> tuple[Rest | None, str]:
    """The axes of our joints, or None and why no pose shows a standing person.

    Args:
        recording: the motion.
        joints: our joint's name to the file's.
    """
    index = {ours: recording.names.index(theirs) for ours, theirs in joints.items()}
    zero = _places(zero_pose(recording), index)
    body, why = body_axes(zero, snap=True)
    splayed = body is not None and _splayed(zero, body)
    if body is not None:
        same = dict.fromkeys(index, body)
        return Rest(same, "the pose of all rotations zero", splayed), ""
    first = replace(recording, positions=recording.positions[:1], rotations=recording.rotations[:1])
    body, _ = body_axes(_places(first, index), snap=True)
    if body is not None:
        _, quat = global_pose(first)
        turns = rot.quat_to_matrix(quat[0])
        axes = {ours: turns[j].T @ body for ours, j in index.items()}
        return Rest(axes, "the first frame, a rest pose"), ""
    rest = _from_motion(some_frames(recording), index)
    return rest, "" if rest else why


def _places(pose: Recording, index: Mapping[str, int]) -> dict[str, np.ndarray]:
    position, _ = global_pose(pose)
    return {ours: position[0, j] for ours, j in index.items()}


def _both(places: Places, joint: str) -> tuple[np.ndarray, np.ndarray]:
    return places[f"left_{joint}"], places[f"right_{joint}"]


def body_axes(places: Places, *, snap: bool) -> tuple[np.ndarray | None, str]:
    """Forward, left and up as columns ``(3, 3)`` for a standing person with straight limbs.

    Args:
        places: positions of our joints ``(3,)``.
        snap: take the file's own axis for up and left where it is near.

    Returns:
        the axes, or None and the reason why it is not such a pose.
    """
    hips, shoulders = _both(places, "hip"), _both(places, "shoulder")
    middle, top = (hips[0] + hips[1]) / 2.0, (shoulders[0] + shoulders[1]) / 2.0
    ankles = sum(_both(places, "ankle")) / 2.0
    up = rot.unit(rot.unit(top - middle) + rot.unit(middle - ankles))
    if rot.unit(top - middle) @ rot.unit(middle - ankles) < 0.8:
        return None, "trunk and legs are not in line"
    if (places["head"] - top) @ up <= 0:
        return None, "the head is below the shoulders"
    lateral = rot.unit(hips[0] - hips[1]), rot.unit(shoulders[0] - shoulders[1])
    if lateral[0] @ lateral[1] < 0.8:
        return None, "hips and shoulders are twisted"
    axes = _axes(up, lateral[0] + lateral[1], snap)
    for side in SIDES:
        chain = {
            j: places[f"{side}_{j}"] for j in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
        }
        thigh, shin = (
            rot.unit(chain["knee"] - chain["hip"]),
            rot.unit(chain["ankle"] - chain["knee"]),
        )
        arm = rot.unit(chain["elbow"] - chain["shoulder"])
        forearm = rot.unit(chain["wrist"] - chain["elbow"])
        if thigh @ shin < 0.8 or -(thigh @ axes[:, 2]) < 0.75:
            return None, f"the {side} leg is not stretched"
        if arm @ forearm < 0.7:
            return None, f"the {side} arm is not stretched"
        outwards = arm @ axes[:, 1] * (1.0 if side == "left" else -1.0)
        if outwards < -0.2 or abs(arm @ axes[:, 0]) > 0.6 or arm @ axes[:, 2] > 0.5:
            return None, f"the {side} arm neither hangs nor points sideways"
    return axes, ""


def _axes(up: np.ndarray, left: np.ndarray, snap: bool) -> np.ndarray:
    """Forward, left and up as columns, from an exact up and an approximate left direction."""
    if snap:
        up = _snapped(up)
    left = rot.unit(left - (left @ up) * up)
    if snap:
        left = _snapped(left)
        left = rot.unit(left - (left @ up) * up)
    return np.stack([np.cross(left, up), left, up], axis=-1)


def _snapped(vector: np.ndarray) -> np.ndarray:
    """The nearest of the six axis directions, if it is within ``SNAP``."""
    axis = np.zeros(3)
    largest = int(abs(vector).argmax())
    axis[largest] = np.sign(vector[largest])
    return axis if vector @ axis > SNAP else vector


def _splayed(places: Places, body: np.ndarray) -> bool:
    drops = [-rot.unit(places[f"{s}_ankle"] - places[f"{s}_hip"]) @ body[:, 2] for s in SIDES]
    return bool(np.mean(drops) < SPLAY)


def world_up(places: Mapping[str, np.ndarray]) -> np.ndarray:
    """The file's axis ``(3,)`` along which the head is above the feet; positions ``(T, 3)``."""
    body = places["head"] - (places["left_ankle"] + places["right_ankle"]) / 2.0
    direction = np.median(rot.unit(body), axis=0)
    axis = np.zeros(3)
    largest = int(abs(direction).argmax())
    axis[largest] = np.sign(direction[largest])
    return axis


class _Moving:
    """Joint motion over time, and vectors that are constant in a joint's frame."""

    def __init__(self, recording: Recording, index: Mapping[str, int]) -> None:
        position, quat = global_pose(recording)
        self.places = {ours: position[:, j] for ours, j in index.items()}
        self.turns = {ours: rot.quat_to_matrix(quat[:, j]) for ours, j in index.items()}

    def bone(self, near: str, far: str) -> np.ndarray:
        """Directions ``(T, 3)`` in the world."""
        return rot.unit(self.places[far] - self.places[near])

    def own(self, joint: str, world: np.ndarray, frames: np.ndarray | None = None) -> np.ndarray:
        """The mean in the joint's frame ``(3,)`` of world vectors ``(T, 3)``."""
        local = np.einsum("tji,tj->ti", self.turns[joint], world)
        return local[frames].mean(axis=0) if frames is not None else local.mean(axis=0)


def _from_motion(recording: Recording, index: Mapping[str, int]) -> Rest | None:
    """Axes from the motion; None if the knees or hips do not show any."""
    moving = _Moving(recording, index)
    up = world_up(moving.places)
    trunk = moving.bone("root", "head") if "root" in index else moving.bone("left_hip", "head")
    upright = trunk @ up
    # In a constant pose every frame is as upright as the best one.
    stands = upright >= min(0.9, float(np.percentile(upright, 60)))
    if not stands.any():  # NaN: bones around the trunk have no length
        return None
    # The feet of someone who lies before getting up are low and still, but not level.
    on_feet = upright >= min(ON_FEET, float(np.percentile(upright, 60)))
    up_world = np.broadcast_to(up, trunk.shape)
    left_world = moving.places["left_hip"] - moving.places["right_hip"]
    shoulders = moving.places["left_shoulder"] - moving.places["right_shoulder"]
    axes: dict[str, np.ndarray] = {}
    # Who leans all the time must not be taken for upright: hips to shoulders are the trunk's up.
    middle = [(moving.places[f"left_{j}"] + moving.places[f"right_{j}"]) / 2 for j in TRUNK_ENDS]
    along = rot.unit(middle[1] - middle[0])
    for joint in ("root", "spine1", "spine2", "spine3", "neck", "head"):
        if joint in index:
            left = left_world if joint in ("root", "spine1") else shoulders
            axes[joint] = _axes(
                rot.unit(
                    moving.own(joint, up_world if joint in ("neck", "head") else along, stands)
                ),
                moving.own(joint, rot.unit(left), stands),
                snap=False,
            )
    for side in SIDES:
        sign = 1.0 if side == "left" else -1.0
        legs = _hinge(moving, side, ("hip", "knee", "ankle"))
        arms = _hinge(moving, side, ("shoulder", "elbow", "wrist"))
        for i, joint in enumerate(("hip", "knee")):
            name = f"{side}_{joint}"
            bone = moving.own(name, moving.bone(name, f"{side}_{('knee', 'ankle')[i]}"))
            hinge = legs[i] if legs else moving.own(name, rot.unit(left_world), stands)
            axes[name] = _axes(-rot.unit(bone), hinge, snap=False)
        for i, joint in enumerate(("shoulder", "elbow")):
            name = f"{side}_{joint}"
            bone = moving.own(name, moving.bone(name, f"{side}_{('elbow', 'wrist')[i]}"))
            # The left elbow bends about -z of the T-pose, the right one about +z.
            hinge = -sign * arms[i] if arms else moving.own(name, up_world, stands)
            axes[name] = _lateral(sign * rot.unit(bone), hinge)
        _ends(moving, index, side, up_world, axes, on_feet)
    return Rest(axes, "how the performer moves")


def _lateral(left: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Forward, left and up as columns, from an exact left and an approximate up direction."""
    up = rot.unit(up - (up @ left) * left)
    return np.stack([np.cross(left, up), left, up], axis=-1)


def _hinge(
    moving: _Moving, side: str, chain: tuple[str, str, str]
) -> tuple[np.ndarray, np.ndarray] | None:
    """The axis about which a limb bends, in its upper and its lower joint's frame ``(3,)``."""
    near, middle, far = (f"{side}_{joint}" for joint in chain)
    cross = np.cross(moving.bone(near, middle), moving.bone(middle, far))
    if np.linalg.norm(cross, axis=-1).mean() < MIN_BEND:
        return None
    axes = moving.own(near, cross), moving.own(middle, cross)
    if min(np.linalg.norm(axis) for axis in axes) < 0.3 * np.linalg.norm(cross, axis=-1).mean():
        return None
    return rot.unit(axes[0]), rot.unit(axes[1])


def _ends(
    moving: _Moving,
    index: Mapping[str, int],
    side: str,
    up_world: np.ndarray,
    axes: dict[str, np.ndarray],
    on_feet: np.ndarray,
) -> None:
    """Adds collarbone, hand, foot and toes, aligned on average with their neighbours."""
    parents = {
        "clavicle": "spine3", "wrist": f"{side}_elbow", "ankle": f"{side}_knee",
        "toe": f"{side}_ankle",
    }  # fmt: skip
    for joint, parent in parents.items():
        name = f"{side}_{joint}"
        if name not in index:
            continue
        near = parent if parent in axes else _above(name, axes)
        turned = moving.turns[near] @ axes[near]
        mean = np.einsum("tji,tjk->tik", moving.turns[name], turned).mean(axis=0)
        if joint == "ankle":
            _foot(moving, side, up_world, axes, on_feet)
            continue
        u, _, v = np.linalg.svd(mean)
        axes[name] = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v


def _above(joint: str, axes: Mapping[str, np.ndarray]) -> str:
    number = JOINTS.index(joint)
    while number:
        number = JOINT_PARENTS[number]
        if JOINTS[number] in axes:
            return JOINTS[number]
    return "root"


def _foot(
    moving: _Moving,
    side: str,
    up_world: np.ndarray,
    axes: dict[str, np.ndarray],
    on_feet: np.ndarray,
) -> None:
    """The foot's axes: level while it is still and low, pointing towards the toes."""
    name, knee = f"{side}_ankle", f"{side}_knee"
    place = moving.places[name]
    height = np.sum(place * up_world, axis=-1)
    speed = np.linalg.norm(np.gradient(place, axis=0), axis=-1) if len(place) > 1 else height * 0
    low = on_feet & (height <= np.percentile(height[on_feet], 40))
    rests = low & (speed <= np.percentile(speed[low], 60))
    up = rot.unit(moving.own(name, up_world, rests))
    if f"{side}_toe" in moving.places:
        ahead = moving.own(name, moving.bone(name, f"{side}_toe"))
    else:
        ahead = moving.own(name, (moving.turns[knee] @ axes[knee])[..., 0], rests)
    forward = rot.unit(ahead - (ahead @ up) * up)
    axes[name] = np.stack([forward, np.cross(up, forward), up], axis=-1)
