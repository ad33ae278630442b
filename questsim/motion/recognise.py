"""Maps a file's joints to ours by names, hierarchy and bone lengths together.

Limbs are chains of sided joints. For each chain, every choice of thigh, shin, foot and toe (or
collarbone, arm, forearm and hand) is scored by the words in the names and the bone lengths. The
best chains become legs and arms; if names do not say parts or sides, ``unsided`` finds them. The
spine lies between the joint that joins the legs and the one that joins the arms; the neck leads
from there to the head. Extra spine, neck and twist joints are folded into the mapped ones, whose
positions stay the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np

from questsim import rotations as rot
from questsim.errors import InputError
from questsim.motion.convert import global_pose
from questsim.motion.joint_names import ARM, HEAD, HIPS, LEG, NECK, fit
from questsim.motion.joint_tree import END, Tree, tree_of
from questsim.motion.recording import Recording
from questsim.motion.rest import some_frames
from questsim.motion.unsided import find_limbs
from questsim.skeleton import JOINTS

MAX_CHAIN = 9
MIN_POINTS = 1.0
"""A chain with a lower score of names and lengths is not a limb."""
MIN_FOOT_ANGLE = np.radians(25.0)
"""The end of a foot that lies in the shin's line within this angle is under the ankle, no toe."""
HELPER = 0.01
"""Decides between joints that fit equally well."""
SURE = 2.0
"""Points of a leg whose names say thigh, shin and foot."""
APART = 0.2
"""Leg lengths between the knees of two people."""
APPENDAGE = 0.3
HUMAN = 0.4
"""Logarithm of the largest ratio of thigh and shin, or arm and forearm, that is not unusual."""
MAPPING = "name the joints in a mapping file ('questsim motions mapping' writes a start)"


@dataclass(frozen=True)
class Roles:
    """The mapping from our joints to the file's.

    Attributes:
        joints: our joint's name to the file's.
        reasons: for each of our joints, why it was mapped so or why it is missing.
        recording: the recording; ends of leaf joints that have a role are joints of it.
    """

    joints: dict[str, str]
    reasons: dict[str, str]
    recording: Recording


def with_ends(recording: Recording) -> Recording:
    """The recording with the end of each leaf joint added as a joint that does not rotate."""
    tips = {j: tip for j, tip in recording.tips.items() if np.linalg.norm(tip) > 0}
    if not tips:
        return recording
    frames = len(recording.positions)
    ends = np.broadcast_to(np.array(list(tips.values())), (frames, len(tips), 3))
    still = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (frames, len(tips), 4))
    return replace(
        recording,
        names=(*recording.names, *(recording.names[j] + END for j in tips)),
        parents=np.concatenate([recording.parents, list(tips)]).astype(int),
        positions=np.concatenate([recording.positions, ends], axis=1),
        rotations=np.concatenate([recording.rotations, still], axis=1),
        tips={},
    )


def find_roles(recording: Recording) -> Roles:
    """Finds our joints among the file's.

    Raises:
        InputError: two legs, two arms or a head are not found; the message says which.
    """
    recording = with_ends(recording)
    tree = tree_of(recording)
    found: dict[str, int] = {}
    why: dict[str, str] = {}
    if not any(name.side and name.part for name in tree.names):
        limbs = find_limbs(recording, MAPPING)
        found, why = dict(limbs.joints), dict.fromkeys(limbs.joints, limbs.reason)
        _trunk(tree, found, recording)
        return _named(recording, found, why)
    legs, arms = (_limbs(tree, part, recording) for part in (LEG, ARM))
    missing = [
        f"{side} {limb}"
        for side in ("left", "right")
        for limb, chosen in (("leg", legs[side][0]), ("arm", arms[side][0]))
        if not chosen
    ]
    if missing:
        found, why = _by_place(recording, tree, missing[0])
        _trunk(tree, found, recording)
        return _named(recording, found, why)
    for side in ("left", "right"):
        for chosen, score in (legs[side], arms[side]):
            found |= {f"{side}_{role}": joint for role, joint in chosen.items()}
            reason = f"place in its chain, name and length ({score:.1f} points)"
            why |= {f"{side}_{role}": reason for role in chosen}
    _trunk(tree, found, recording)
    return _named(recording, found, why)


def _by_place(
    recording: Recording, tree: Tree, missing: str
) -> tuple[dict[str, int], dict[str, str]]:
    """Limbs by place and length, their sides by name or else by the front.

    Raises:
        InputError: there are no such limbs; the message says which limb is ``missing``.
    """
    for sides in ([name.side for name in tree.names], []):
        try:
            limbs = find_limbs(recording, MAPPING, sides)
        except InputError:
            continue
        return dict(limbs.joints), dict.fromkeys(limbs.joints, limbs.reason)
    what = f"no human skeleton is recognised: there is no {missing}"
    raise InputError(what, recording.path, MAPPING)


def _named(recording: Recording, found: dict[str, int], why: dict[str, str]) -> Roles:
    found = _without_soles(recording, found)
    reasons = {}
    for joint in JOINTS:
        if joint not in found:
            reasons[joint] = "the file has none"
        else:
            reasons[joint] = why.get(joint, "place between legs, arms and head")
    joints = {j: recording.names[found[j]] for j in JOINTS if j in found}
    ends = {name for name in joints.values() if name.endswith(END)}
    if not ends:
        recording = _without_ends(recording)
    return Roles(joints, reasons, recording)


def _without_soles(recording: Recording, found: dict[str, int]) -> dict[str, int]:
    """Without ends of feet that are straight under the ankles: they do not say where toes are."""
    soles = [
        toe
        for toe in ("left_toe", "right_toe")
        if toe in found and recording.names[found[toe]].endswith(END)
    ]
    if not soles:
        return found
    place, _ = global_pose(some_frames(recording))
    cosines = []
    for toe in soles:
        knee, ankle, end = (
            place[:, found[toe.replace("toe", joint)]] for joint in ("knee", "ankle", "toe")
        )
        cosines.append(np.sum(rot.unit(ankle - knee) * rot.unit(end - ankle), axis=-1))
    if np.median(cosines) < np.cos(MIN_FOOT_ANGLE):
        return found
    return {ours: joint for ours, joint in found.items() if ours not in soles}


def _without_ends(recording: Recording) -> Recording:
    keep = [j for j, name in enumerate(recording.names) if not name.endswith(END)]
    return replace(
        recording,
        names=tuple(recording.names[j] for j in keep),
        parents=recording.parents[keep],
        positions=recording.positions[:, keep],
        rotations=recording.rotations[:, keep],
    )


_Limb = tuple[dict[str, int], float]


def _limbs(tree: Tree, part: dict, recording: Recording) -> dict[str, _Limb]:
    """The best chain of each side for legs or arms; empty if there is none.

    Raises:
        InputError: there are legs of several people.
    """
    out: dict[str, _Limb] = {"left": ({}, MIN_POINTS), "right": ({}, MIN_POINTS)}
    found: list[tuple[str, _Limb]] = []
    for start, name in enumerate(tree.names):
        parent = tree.parents[start]
        if not name.side or (parent >= 0 and tree.names[parent].side == name.side):
            continue
        paths = [tree.path(leaf) for leaf in tree.leaves(start)]
        chains = {
            tuple(j for j in path[path.index(start) :] if tree.names[j].part)[:MAX_CHAIN]
            for path in paths
        }
        found += [(name.side, _best(tree, chain, part)) for chain in sorted(chains)]
    for side, limb in found:
        if limb[1] > out[side][1]:
            out[side] = limb
    if part is LEG and any(_of_another(tree, limb, out[side]) for side, limb in found):
        raise InputError(
            "several people are in one hierarchy: there is more than one pair of legs",
            recording.path,
            "keep one person in each file",
        )
    return out


def _of_another(tree: Tree, limb: _Limb, chosen: _Limb) -> bool:
    """Whether a leg is named as surely as the chosen one, but its knee is elsewhere.

    Rigs with several sets of bones have them in the same place.
    """
    if limb[1] < SURE or not chosen[0] or limb[0]["knee"] == chosen[0]["knee"]:
        return False
    leg = tree.length(chosen[0]["hip"], chosen[0]["ankle"])
    return tree.length(limb[0]["knee"], chosen[0]["knee"]) > APART * leg


def _best(tree: Tree, usable: tuple[int, ...], part: dict) -> _Limb:
    """The best assignment of a limb's roles to a chain of joints."""
    roles = list(part)
    optional = "toe" if part is LEG else "clavicle"
    needed = [role for role in roles if role != optional]
    best: _Limb = ({}, -np.inf)
    for wanted in (roles, needed):
        for joints in combinations(usable, len(wanted)):
            chosen = dict(zip(wanted, joints, strict=True))
            score = _points(tree, usable, chosen, part)
            if score > best[1]:
                best = (chosen, score)
    return best


def _points(tree: Tree, usable: tuple[int, ...], chosen: dict[str, int], part: dict) -> float:
    """The score of a choice from its names and bone lengths."""
    score = sum(fit(part[role], tree.names[joint].key) for role, joint in chosen.items())
    # Skipping a joint whose name fits a missing role costs points.
    score -= 0.3 * sum(
        max(fit(patterns, tree.names[joint].key) for patterns in part.values()) > 0.5
        for joint in usable
        if joint not in chosen.values()
    )
    near, middle, far = ("hip", "knee", "ankle") if part is LEG else ("shoulder", "elbow", "wrist")
    upper = tree.length(chosen[near], chosen[middle])
    lower = tree.length(chosen[middle], chosen[far])
    if min(upper, lower) <= 1e-9:
        return -1.0 + score
    score -= _unlike(float(abs(np.log(upper / lower))))
    if "toe" in chosen:
        foot = tree.length(chosen["ankle"], chosen["toe"]) / lower
        score -= 0.0 if 0.1 < foot < 0.9 else 0.7
    if "clavicle" in chosen:
        score -= 0.0 if tree.length(chosen["clavicle"], chosen["shoulder"]) < upper else 0.7
    score -= APPENDAGE * _appendages(tree, usable, chosen)
    return score - HELPER * _helpers(tree, usable, chosen)


def _unlike(difference: float) -> float:
    """Points lost for bones whose lengths differ by that logarithm.

    Within what people and their skeletons have, names decide.
    """
    return min(0.2 * difference + 2.0 * max(difference - HUMAN, 0.0), 3.0)


def _appendages(tree: Tree, usable: tuple[int, ...], chosen: dict[str, int]) -> int:
    """How many chosen joints have the name of one above them and more: HandGun of Hand."""
    taken = set(chosen.values())
    return sum(
        any(
            tree.names[above].key
            and tree.names[joint].key != tree.names[above].key
            and tree.names[joint].key.startswith(tree.names[above].key)
            for above in usable[: usable.index(joint)]
            if above not in taken
        )
        for joint in taken
    )


def _helpers(tree: Tree, usable: tuple[int, ...], chosen: dict[str, int]) -> int:
    """How many chosen joints only place the next one, which has their name and is not chosen."""
    follows = dict(pairwise(usable))
    return sum(
        follows.get(joint, joint) not in chosen.values()
        and tree.names[follows[joint]].key == tree.names[joint].key
        and (role == "clavicle" or tree.length(joint, follows[joint]) < 1e-9)
        for role, joint in chosen.items()
    )


def _trunk(tree: Tree, found: dict[str, int], recording: Recording) -> None:
    """Adds root, spine, neck and head to ``found``."""
    hips = tree.meet(found["left_hip"], found["right_hip"])
    limbs = {joint for name, joint in found.items() if name not in ("root",)}
    begins = [found.get(f"{s}_clavicle", found[f"{s}_shoulder"]) for s in ("left", "right")]
    chest = tree.meet(*begins)
    head = _head(tree, chest, limbs, recording)
    found["root"] = hips
    low = tree.meet(hips, chest)
    spine = [joint for joint in tree.path(chest) if joint not in tree.path(low)]
    spine = [joint for joint in spine if tree.names[joint].part]
    # Some skeletons hang the arms on the neck.
    high = [joint for joint in spine if NECK.search(tree.names[joint].key)]
    spine = [joint for joint in spine if joint not in high]
    above = tree.path(head)
    begin = above.index(tree.meet(head, chest)) + 1
    neck = high + [joint for joint in above[begin:-1] if tree.names[joint].part]
    found["head"] = head
    neck = [joint for joint in neck if joint != head]
    if neck:
        found["neck"] = neck[0]
    if chest != hips and chest in tree.path(hips):
        found["spine3"] = chest  # the hierarchy begins at the chest
    _fold(tree, spine, hips, neck[0] if neck else head, found)


def _fold(tree: Tree, spine: list[int], hips: int, neck: int, found: dict[str, int]) -> None:
    """Adds up to three of the file's spine joints: first, middle and last."""
    if not spine:
        return
    total = max(tree.length(hips, neck), 1e-9)
    share = [tree.length(hips, joint) / total for joint in spine]
    if len(spine) == 1:
        found["spine1" if share[0] < 0.35 else "spine2"] = spine[0]
    elif len(spine) == 2:
        found["spine1"], found["spine2"] = spine
    else:
        halfway = (share[0] + share[-1]) / 2.0
        between = range(1, len(spine) - 1)
        middle = min(between, key=lambda i: (abs(share[i] - halfway), i))
        found |= {"spine1": spine[0], "spine2": spine[middle], "spine3": spine[-1]}


def _head(tree: Tree, chest: int, limbs: set[int], recording: Recording) -> int:
    """The head: by name, or else the last joint of the chain above the chest."""
    named = [
        joint
        for joint, name in enumerate(tree.names)
        if name.part and not name.side and HEAD.search(name.key) and joint not in limbs
    ]
    # A headset beside the performer is no head.
    named = [joint for joint in named if chest in tree.path(joint)[:-1]] or named
    if named:
        return min(named, key=lambda joint: (len(tree.path(joint)), joint))
    below = [
        joint
        for joint, name in enumerate(tree.names)
        if chest in tree.path(joint)[:-1]
        and name.part
        and not name.side
        and not recording.names[joint].endswith(END)
        and not limbs & set(tree.path(joint))
        and not HIPS.search(name.key)
    ]
    if not below:
        raise InputError(
            "no human skeleton is recognised: there is no head", recording.path, MAPPING
        )
    top = max(below, key=lambda joint: (len(tree.path(joint)), -joint))
    # Where the chain forks, there is a face.
    above = tree.path(top)[tree.path(top).index(tree.meet(chest, top)) + 1 :]
    return next((joint for joint in above if len(tree.children(joint)) > 1), top)
