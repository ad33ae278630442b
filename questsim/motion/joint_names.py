"""Side and possible body parts of a joint, from its name.

Producers write the same joint in dozens of ways (``mixamorig:LeftUpLeg``, ``CC_Base_L_Thigh``,
``Bip01 L Thigh``, ``thigh.L``, ``lfemur``, ``J_Bip_L_UpperLeg``): names are cut into words, words
give a side and, by part of the body, how well the name fits each role.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

_WORD = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+|[^\x00-\x7f]+")
_SIDES = {
    "left": "left", "l": "left", "lft": "left", "lf": "left", "lt": "left", "links": "left",
    "right": "right", "r": "right", "rgt": "right", "rt": "right", "rechts": "right",
    "左": "left", "右": "right",
}  # fmt: skip

# Role to (pattern, how well it fits); the first pattern found counts. Patterns are searched in
# the name's words without side and digits, put together in lower case.
_Patterns = tuple[tuple[str, float], ...]
LEG: dict[str, _Patterns] = {
    "hip": (
        (r"hipjoint|buttock|足首|足先|ひざ|小腿", -0.5),
        (r"up(per)?leg|legup|thigh|femur|oberschenkel|大腿", 1.0),
        (r"low(er)?leg|leglow|loleg|foreleg|knee|shin|calf|tibia|ankle|foot|toe|脚", -1.0),
        (r"hip", 0.8),
        (r"leg|足", 0.6),
    ),
    "knee": (
        (r"low(er)?leg|leglow|loleg|knee|shin|calf|tibia|crus|unterschenkel|ひざ|膝|小腿", 1.0),
        (r"up(per)?leg|legup|thigh|femur|hip|ankle|foot|toe|足首|大腿|脚", -1.0),
        (r"leg", 0.6),
    ),
    "ankle": (
        (r"ankle|足首", 1.0),
        (r"toe|ball|leg|thigh|knee|shin|calf", -1.0),
        (r"foot|fuss|脚$", 0.9),
    ),
    "toe": ((r"toe|ball|つま先|趾", 1.0), (r"foot|midfoot", 0.5), (r"leg|ankle|knee", -1.0)),
}
ARM: dict[str, _Patterns] = {
    "clavicle": (
        (r"clav|collar|scapula|肩|锁骨", 1.0),
        (r"arm|elbow|hand|wrist|shldr", -1.0),
        (r"shoulder|schulter", 0.7),
    ),
    "shoulder": (
        (r"^u(pper|p)?arm|up(per)?arm|armup|humerus|oberarm|腕|上臂", 1.0),
        (r"shldr", 0.9),
        (
            r"^farm|fore?arm|low(er)?arm|armlow|loarm|elbow|radius|hand|wrist|clav|collar|ひじ|手|前臂",
            -1.0,
        ),
        (r"arm", 0.7),
        (r"shoulder", 0.6),
    ),
    "elbow": (
        (
            r"^farm|fore?arm|low(er)?arm|armlow|loarm|elbow|radius|ulna|unterarm|ひじ|肘|前臂|小臂",
            1.0,
        ),
        (r"arm|shoulder|shldr|hand|wrist|clav|collar", -1.0),
    ),
    "wrist": (
        (r"wrist|手首", 1.0),
        (r"arm|elbow|shoulder|radius|clav", -1.0),
        (r"hand|palm|paw|手$", 0.9),
    ),
}
HIPS = re.compile(r"hip|pelvis|下半身|センター")
NECK = re.compile(r"neck|cervical|首|颈")
HEAD = re.compile(r"head|skull|kopf|頭|头")

_OUT = re.compile(
    r"thumb|index|ring|pinky|pinkie|little|finger|metacarp|carpal|metatars|nub$|eye|jaw|"
    r"tongue|teeth|hair|breast|pectoral|helper|pole|ctrl|control|tail|weapon|prop|socket|heel|toe"
    r"nail|bigtoe|midtoe|dummy|camera|genital|glute|指|髪|目"
)
_OUT_WORDS = {
    "ear", "lip", "lid", "brow", "nose", "cheek", "mouth", "ik", "fk", "mid", "end", "tip", "top",
    "site", "eff", "effector", "ee", "leaf", "attachment", "locator", "grip", "target", "twist",
    "roll", "share", "捩", "null", "face", "chin", "skirt", "cloth", "hat", "inner",
    "outer", "out", "fwd", "bck", "corrective",
}  # fmt: skip
_OUT_WORDS_OF_TRUNK = {
    "end", "tip", "top", "site", "eff", "effector", "leaf", "ik", "face", "nose", "ear"
}  # fmt: skip
SHARED = 0.8
"""A first word that this share of the names has is the performer's or the producer's."""
MAX_SHARED = 4
MIN_NAMES = 10


@dataclass(frozen=True)
class Name:
    """A joint's name, understood.

    Attributes:
        side: ``"left"``, ``"right"`` or empty.
        key: its words without side and digits, put together in lower case.
        part: whether it can be one of our joints; fingers, faces, twist joints and ends cannot.
    """

    side: str
    key: str
    part: bool


def understand(names: Sequence[str]) -> list[Name]:
    """Side, words and use of each joint's name."""
    everything = {name.lower() for name in names}
    cut = _without_prefix([_words(name, everything) for name in names])
    return [_understand(name, words, everything) for name, words in zip(names, cut, strict=True)]


def _words(name: str, everything: set[str]) -> list[str]:
    """The words of a name in lower case; LFArm is L, FArm if there is an RFArm."""
    out: list[str] = []
    for word in _WORD.findall(name.rpartition(":")[2]):
        lower = word.lower()
        if lower == "lf" and name.lower().replace("lf", "rf", 1) in everything:
            out += ["l", "f"]
        else:
            out.append(lower)
    return out


def _without_prefix(words: list[list[str]]) -> list[list[str]]:
    """The words without first ones that nearly all names share: Footman_LeftArm has no foot."""
    for _ in range(MAX_SHARED if len(words) >= MIN_NAMES else 0):
        first = Counter(name[0] for name in words if len(name) > 1)
        word, count = first.most_common(1)[0] if first else ("", 0)
        if count < SHARED * len(words) or word in _SIDES:
            break
        words = [name[1:] if len(name) > 1 and name[0] == word else name for name in words]
    return words


def _understand(name: str, words: list[str], everything: set[str]) -> Name:
    # In Japanese the side is the first letter; in names such as lfemur too, if there is rfemur.
    apart: list[str] = []
    for word in words:
        apart += [word[0], word[1:]] if word[0] in "左右" and len(word) > 1 else [word]
    side = next((_SIDES[word] for word in apart if word in _SIDES), "")
    rest = [word for word in apart if word not in _SIDES and not word.isdigit()]
    if side and not rest and not _has_counterpart(name, everything):
        # Vertebrae are called L5 and L3.
        side, rest = "", apart
    if not side and rest:
        side, rest = _glued_side(name, rest, everything)
    key = "".join(rest)
    out_words = _OUT_WORDS if side else _OUT_WORDS_OF_TRUNK
    part = not (_OUT.search(key) or out_words & set(rest) or (side and "middle" in key))
    return Name(side, key, part)


def _has_counterpart(name: str, everything: set[str]) -> bool:
    """Whether there is the same name with the other side."""
    lower = name.lower()
    swapped = (
        re.sub(rf"(?<![a-z]){word}(?![a-z])", other, lower)
        for word, side in _SIDES.items()
        for other, their in _SIDES.items()
        if side != their
    )
    return any(other != lower and other in everything for other in swapped)


def _glued_side(name: str, words: list[str], everything: set[str]) -> tuple[str, list[str]]:
    """The side where it is one word with the rest (``lhip``, ``leftarm``, ``handr``)."""
    lower = name.lower()
    for left, right in (("left", "right"), ("l", "r")):
        for mine, other, side in ((left, right, "left"), (right, left, "right")):
            for i, word in enumerate(words):
                for stem, there in (
                    (word.removeprefix(mine), lower.replace(word, other + word[len(mine) :])),
                    (word.removesuffix(mine), lower.replace(word, word[: -len(mine)] + other)),
                ):
                    if stem and stem != word and there in everything and there != lower:
                        return side, [*words[:i], stem, *words[i + 1 :]]
    return "", words


def fit(patterns: _Patterns, key: str) -> float:
    """How well a name fits a role: 1 surely, 0 does not say, -1 surely not."""
    return next((score for pattern, score in patterns if re.search(pattern, key)), 0.0)
