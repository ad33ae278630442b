"""Finds limbs by place and length alone, and left and right where names do not say them.

Limbs are pairs of sibling chains with equal bone lengths: the legs, and above them the arms. The
two longest consecutive bones of a chain are thigh and shin, or upper arm and forearm. Which chain
is left follows from up and the front, and the front from three signs: where the feet point, where
the knees bend to, and where the performer travels. Two signs must agree; feet and knees must not
contradict each other (travel may: people walk backwards). Where bones are split into several
joints, those at which a limb never bends are left out first.

Names in an unknown language or of numbers alone (``Cuisse_L``, ``Bone.01L``) may say the sides
without the parts; then only the sides are taken from them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from questsim import rotations as rot
from questsim.errors import InputError
from questsim.motion.convert import global_pose
from questsim.motion.recording import Recording
from questsim.motion.rest import some_frames, world_up

MAX_DIFFERENCE = 0.08
"""Bones of a left and a right limb differ by at most this share of the limb's length."""
CERTAIN = 0.4
"""A sign counts if its mean cosine with the front is larger."""
MIN_TRAVEL = 0.15
"""Travel counts in frames in which the hips move by more leg lengths a second."""
MIN_MOVING = 5
"""Travel counts if there are more such frames."""
MIN_BEND = 0.1
"""Knees count if they bend by more than this sine on average."""
MIN_FOOT, MAX_FOOT = 0.1, 0.9
"""Length of a foot as a share of its shin."""
MIN_LIMB = 0.45
"""The two longest bones are at least this share of a limb up to its toes or finger tips."""
LOWER = 0.9
"""Length of shin and thigh, and of forearm and upper arm, as a ratio."""
MAX_STRAIGHT = np.radians(3.0)
"""A joint of a split limb at which it never bends by more is within a bone."""
SIGNS = ("feet", "knees", "travel")


@dataclass(frozen=True)
class Limbs:
    """The limbs of a skeleton.

    Attributes:
        joints: ``left_hip``, ``right_wrist``, ...: the number of the file's joint.
        reason: how left and right were found.
    """

    joints: dict[str, int]
    reason: str


@dataclass(frozen=True)
class _Pair:
    above: int
    chains: tuple[list[int], list[int]]
    length: float


def find_limbs(recording: Recording, fix: str, sides: Sequence[str] = ()) -> Limbs:
    """Legs and arms of a recording whose names do not say which joint is which.

    Args:
        recording: with the ends of leaf joints as joints.
        fix: what to do if they are not found, for the error.
        sides: of each joint, ``"left"``, ``"right"`` or empty; if none are given, left and right
            follow from the front.

    Raises:
        InputError: there are no two legs and arms, or their sides are not certain.
    """

    def refuse(why: str) -> InputError:
        named = "the parts of limbs" if sides else "left and right"
        what = f"no human skeleton is recognised: the joints' names do not say {named}, and "
        return InputError(what + why, recording.path, fix)

    length = np.linalg.norm(np.median(recording.positions, axis=0), axis=-1)
    pairs = _legs_and_arms([int(parent) for parent in recording.parents], length)
    if pairs is None:
        raise refuse("there are no two pairs of equally long limbs")
    few = some_frames(recording)
    position, _ = global_pose(few)
    chains = [chain for pair in pairs for chain in pair.chains]
    if any(_is_split(chain, length) for chain in chains):
        chains, length = _unsplit(chains, position, length)
        if any(_is_split(chain, length) for chain in chains):
            raise refuse("bones of limbs are split into several joints")
    limbs = [_limb(chain, length) for chain in chains]
    legs, arms = limbs[:2], limbs[2:]
    if sides:
        turned = [_turned(pair, sides) for pair in (legs, arms)]
        if None in turned:
            raise refuse("limbs have no side")
        joints = _sided(legs, bool(turned[0]), length, legs=True)
        joints |= _sided(arms, bool(turned[1]), length, legs=False)
        return Limbs(joints, "place and length; its side by name")
    fps = recording.fps * len(few.positions) / len(recording.positions)
    front = _front(position, legs, pairs[1].above, fps, length)
    vote = _vote(front)
    across = [rot.unit(position[:, a[1]] - position[:, b[1]]) for a, b in (legs, arms)]
    same = float(np.sum(across[0] * across[1], axis=-1).mean())
    if vote and abs(same) < CERTAIN:
        raise refuse("hips and shoulders do not lie side by side: left and right arm are unknown")
    if vote == 0.0:
        said = ", ".join(f"{s} {c:+.2f}" for s, c in zip(SIGNS, front, strict=True))
        raise refuse(f"the front is not certain (cosines of {said}; two must agree)")
    joints = _sided(legs, vote < 0, length, legs=True)
    joints |= _sided(arms, vote * same < 0, length, legs=False)
    agree = [s for s, c in zip(SIGNS, front, strict=True) if c * vote > CERTAIN]
    return Limbs(joints, f"place and length; left is known from {' and '.join(agree)}")


def _turned(pair: list[list[int]], sides: Sequence[str]) -> bool | None:
    """Whether the second limb of a pair is the left one; None if names do not say that."""
    first, second = ({sides[joint] for joint in limb if joint >= 0} - {""} for limb in pair)
    if (first, second) == ({"left"}, {"right"}):
        return False
    return True if (first, second) == ({"right"}, {"left"}) else None


def _sided(
    pair: list[list[int]], turned: bool, length: np.ndarray, *, legs: bool
) -> dict[str, int]:
    """``left_knee`` and so on to the file's joints; ``turned`` if the first limb is the right."""
    return {
        f"{side}_{part}": joint
        for side, limb in zip(("left", "right"), pair[::-1] if turned else pair, strict=True)
        for part, joint in _roles(limb, legs, length).items()
    }


def _legs_and_arms(parents: Sequence[int], length: np.ndarray) -> tuple[_Pair, _Pair] | None:
    """The longest pair of chains that has another pair above it, beside its own chains."""
    pairs = _pairs(parents, length)
    best, most = None, 0.0
    for legs in pairs:
        for arms in pairs:
            path = _path(parents, arms.above)
            own = {chain[0] for chain in legs.chains}
            if legs.above not in path or legs.above == arms.above or own & set(path):
                continue
            if legs.length + arms.length > most:
                best, most = (legs, arms), legs.length + arms.length
    return best


def _path(parents: Sequence[int], joint: int) -> list[int]:
    out = [joint]
    while parents[out[-1]] >= 0:
        out.append(parents[out[-1]])
    return out


def _pairs(parents: Sequence[int], length: np.ndarray) -> list[_Pair]:
    """Pairs of sibling chains with at least three joints and equal bones."""
    children: dict[int, list[int]] = {}
    for joint, parent in enumerate(parents):
        children.setdefault(parent, []).append(joint)
    chain: dict[int, list[int]] = {}
    reach: dict[int, float] = {}
    for joint in reversed(range(len(parents))):  # parents come before their children
        below = max(children.get(joint, []), key=lambda c: reach[c] + length[c], default=None)
        chain[joint] = [joint] + (chain[below] if below is not None else [])
        reach[joint] = reach[below] + float(length[below]) if below is not None else 0.0
    out = []
    for above, siblings in children.items():
        for a, b in combinations(siblings, 2):
            whole = max(reach[a], reach[b])
            if above < 0 or whole <= 0 or len(chain[a]) != len(chain[b]) or len(chain[a]) < 3:
                continue
            bones = length[chain[a][1:]] - length[chain[b][1:]]
            if abs(bones).max() <= MAX_DIFFERENCE * whole:
                out.append(_Pair(above, (chain[a], chain[b]), whole))
    return out


def _limb(chain: list[int], length: np.ndarray) -> list[int]:
    """The chain from the joint before thigh or upper arm on; -1 if there is none.

    Thigh and shin, or upper arm and forearm, are the consecutive bones that are long together and
    about equal: a long collarbone and a short forearm must not be taken for them.
    """
    bones = [length[chain[i + 1 : i + 3]] for i in range(len(chain) - 2)]
    fit = [
        np.log(max(upper + lower, 1e-9))
        - 0.5 * abs(np.log(max(lower, 1e-9) / max(upper, 1e-9) / LOWER))
        for upper, lower in bones
    ]
    first = int(np.argmax(fit))
    return [chain[first - 1] if first else -1, *chain[first:]]


def _is_split(chain: list[int], length: np.ndarray) -> bool:
    """Whether there are no two bones that are long enough for the whole limb."""
    if len(chain) < 3:
        return True
    limb = _limb(chain, length)
    return bool(length[limb[2:4]].sum() < MIN_LIMB * length[chain[1:]].sum())


def _unsplit(
    chains: list[list[int]], position: np.ndarray, length: np.ndarray
) -> tuple[list[list[int]], np.ndarray]:
    """The chains without the joints within bones, and the lengths of the whole bones.

    Args:
        chains: joints from the trunk outwards; left and right in turn.
        position: of all joints ``(T, J, 3)``.
        length: of each joint's bone ``(J,)``.
    """

    def bend(before: int, joint: int, after: int) -> float:
        upper = rot.unit(position[:, joint] - position[:, before])
        lower = rot.unit(position[:, after] - position[:, joint])
        cosine = np.clip(np.sum(upper * lower, axis=-1), -1.0, 1.0)
        return float(np.percentile(np.arccos(cosine), 95))

    length, out = length.copy(), []
    for first, second in (chains[:2], chains[2:]):
        bends = [
            max(bend(*chain[i - 1 : i + 2]) for chain in (first, second))
            for i in range(1, len(first) - 1)
        ]
        whole = [0, *(i + 1 for i, angle in enumerate(bends) if angle > MAX_STRAIGHT)]
        whole.append(len(first) - 1)
        for chain in (first, second):
            bones = length[chain]
            for start, end in pairwise(whole):
                length[chain[end]] = bones[start + 1 : end + 1].sum()
            out.append([chain[i] for i in whole])
    return out, length


def _roles(limb: list[int], is_leg: bool, length: np.ndarray) -> dict[str, int]:
    """Our parts of a limb, e.g. ``hip``, to the file's joints."""
    if not is_leg:
        arm = zip(("clavicle", "shoulder", "elbow", "wrist"), limb, strict=False)
        return {part: joint for part, joint in arm if joint >= 0}
    parts = ("hip", "knee", "ankle", "toe") if _has_foot(limb, length) else ("hip", "knee", "ankle")
    return dict(zip(parts, limb[1:], strict=False))


def _has_foot(leg: list[int], length: np.ndarray) -> bool:
    return len(leg) > 4 and MIN_FOOT < length[leg[4]] / max(length[leg[3]], 1e-9) < MAX_FOOT


def _front(
    position: np.ndarray, legs: list[list[int]], chest: int, fps: float, length: np.ndarray
) -> list[float]:
    """Mean cosine of each sign with the front that follows if the first leg is the left one.

    Args:
        position: of all joints ``(T, J, 3)``.
        legs: both legs, as ``_limb`` has them.
        chest: the joint above the arms.
        fps: frames a second of ``position``.
        length: of each joint's bone ``(J,)``.
    """
    hips, knees, ankles = (np.stack([position[:, leg[n]] for leg in legs], 1) for n in (1, 2, 3))
    up = world_up(
        {"head": position[:, chest], "left_ankle": ankles[:, 0], "right_ankle": ankles[:, 1]}
    )
    front = rot.unit(np.cross(hips[:, 0] - hips[:, 1], up))

    def along(direction: np.ndarray) -> float:
        level = direction - (direction @ up)[..., None] * up
        return float(np.mean(np.sum(rot.unit(level) * front, axis=-1)))

    feet = knee = travel = 0.0
    if all(_has_foot(leg, length) for leg in legs):
        toes = np.stack([position[:, leg[4]] for leg in legs], 1)
        feet = along((toes - ankles).sum(axis=1))
    bend = (rot.unit(knees - hips) - rot.unit(ankles - knees)).sum(axis=1)
    if np.linalg.norm(bend, axis=-1).mean() > MIN_BEND:
        knee = along(bend)
    if len(position) > 2:
        middle = hips.mean(axis=1)
        speed = np.gradient(middle, axis=0) * fps
        level = speed - (speed @ up)[:, None] * up
        leg = length[legs[0][2]] + length[legs[0][3]]
        moves = np.linalg.norm(level, axis=-1) > MIN_TRAVEL * leg
        if moves.sum() > MIN_MOVING:
            travel = float(np.mean(np.sum(rot.unit(level) * front, axis=-1)[moves]))
    return [feet, knee, travel]


def _vote(front: Sequence[float]) -> float:
    """1 if the first leg is left, -1 if it is right, 0 if that is not certain."""
    votes = [np.sign(cosine) if abs(cosine) > CERTAIN else 0.0 for cosine in front]
    if votes[0] * votes[1] < 0 or abs(sum(votes)) + (votes[0] * votes[1] > 0) < 2:
        return 0.0
    return float(np.sign(sum(votes)))
