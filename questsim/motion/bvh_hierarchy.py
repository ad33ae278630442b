"""The HIERARCHY block of a BVH file: joints, offsets and channels.

Keywords in any case and several of them on a line are accepted; anything else that deviates from
the format is an error that names the line.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from questsim.errors import InputError
from questsim.motion.recording import AGAIN, MAX_LENGTH

CHANNELS = tuple(f"{axis}{kind}" for kind in ("position", "rotation") for axis in "XYZ")
COUNTS = tuple("0123456")
_CHANNEL = {channel.lower(): channel for channel in CHANNELS}
_KEYWORDS = {
    word.upper(): word
    for word in ("HIERARCHY", "MOTION", "ROOT", "JOINT", "End", "OFFSET", "CHANNELS", "{", "}")
}
_SITE = -2
MAX_JOINTS = 2000


@dataclass
class Header:
    """What the HIERARCHY block declares, by joint."""

    names: list[str] = field(default_factory=list)
    parents: list[int] = field(default_factory=list)
    offsets: list[np.ndarray] = field(default_factory=list)
    channels: list[list[str]] = field(default_factory=list)
    tips: dict[int, np.ndarray] = field(default_factory=dict)

    @property
    def num_channels(self) -> int:
        """Values of a frame."""
        return sum(map(len, self.channels))

    @property
    def orders(self) -> dict[str, str]:
        """The order of each joint's rotation channels, by its name, e.g. ``"ZXY"``."""
        return {
            name: "".join(channel[0] for channel in channels if channel.endswith("rotation"))
            for name, channels in zip(self.names, self.channels, strict=True)
        }


def read_hierarchy(lines: list[str], path: Path) -> tuple[Header, int]:
    """The header, and the index of the line after ``MOTION``.

    The files of a data set often have the same hierarchy, which is then parsed once.
    """
    try:
        length = lines.index("MOTION") + 1
    except ValueError:
        return _parsed(lines, path)
    key = "\n".join(lines[:length])
    if key not in _HEADERS:
        found = _parsed(lines, path)
        if len(_HEADERS) >= MAX_HEADERS:
            _HEADERS.clear()
        _HEADERS[key] = found
    return _HEADERS[key]


_HEADERS: dict[str, tuple[Header, int]] = {}
"""Headers by the text of their lines; not to be changed."""
MAX_HEADERS = 16


def _parsed(lines: list[str], path: Path) -> tuple[Header, int]:
    reader = _HierarchyReader(path)
    for number, line in enumerate(lines):
        words = line.split()
        for part in _parts(words):
            if reader.take(part, number):
                return reader.header, number + 1
    raise InputError(
        "file ends inside the joint hierarchy: no MOTION block",
        f"{path}, line {len(lines)}",
        AGAIN,
    )


def _parts(words: list[str]) -> list[list[str]]:
    """Splits a line's words at braces and before the keywords OFFSET and CHANNELS."""
    parts: list[list[str]] = []
    for word in words:
        after_brace = bool(parts) and parts[-1][0] in "{}"
        new = word in "{}" or after_brace or word.upper() in ("OFFSET", "CHANNELS")
        if new or not parts:
            parts.append([word])
        else:
            parts[-1].append(word)
    return parts


class _HierarchyReader:
    """Parses the HIERARCHY block line by line.

    Attributes:
        header: what has been read.
        open: joints whose braces are open; ``_SITE`` for an End Site.
        pending: what the next brace opens; None for nothing.
        expected: the keyword that has to come next; empty for any.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.header = Header()
        self.open: list[int] = []
        self.pending: int | None = None
        self.expected = "HIERARCHY"
        self.number = 0

    def refuse(self, what: str, fix: str = AGAIN) -> InputError:
        return InputError(what, f"{self.path}, line {self.number + 1}", fix)

    def take(self, words: list[str], number: int) -> bool:
        """One line's words; True at ``MOTION``."""
        self.number = number
        keyword = _KEYWORDS.get(words[0].upper(), words[0])
        if self.expected and keyword != self.expected:
            found = f"{self.expected} expected, found {words[0][:40]!r}"
            raise self.refuse(found, "give a BVH file")
        self.expected = ""
        if keyword == "MOTION":
            if self.open or not self.header.names:
                raise self.refuse("MOTION before the end of the joint hierarchy")
            return True
        take = {
            "ROOT": self._joint, "JOINT": self._joint, "End": self._end, "{": self._opened,
            "}": self._closed, "OFFSET": self._offset, "CHANNELS": self._channels,
            "HIERARCHY": lambda _: None,
        }.get(keyword)  # fmt: skip
        if take is None:
            raise self.refuse(f"unknown keyword {words[0][:40]!r}", "give a BVH file")
        take([keyword, *words[1:]])
        return False

    def _joint(self, words: list[str]) -> None:
        header, name = self.header, " ".join(words[1:])
        if not name:
            raise self.refuse(f"{words[0]} needs a name")
        if (words[0] == "ROOT") == bool(header.names):
            raise self.refuse("a BVH file has exactly one ROOT", "keep one person in each file")
        name = _fresh(name, header.names)
        parent = self.open[-1] if self.open else -1
        if words[0] == "JOINT" and (not self.open or parent == _SITE):
            raise self.refuse(f"joint {name[:40]!r} is not inside another joint")
        if len(header.names) >= MAX_JOINTS:
            raise self.refuse(f"more than {MAX_JOINTS} joints")
        self.pending, self.expected = len(header.names), "{"
        header.names.append(name)
        header.parents.append(parent)
        header.offsets.append(np.zeros(3))
        header.channels.append([])

    def _end(self, _: list[str]) -> None:
        if not self.open or self.open[-1] == _SITE:
            raise self.refuse("End Site is not inside a joint")
        self.pending, self.expected = _SITE, "{"

    def _opened(self, _: list[str]) -> None:
        if self.pending is None:
            raise self.refuse("unexpected { (no joint's name before it)")
        self.open.append(self.pending)
        self.pending, self.expected = None, "OFFSET"

    def _closed(self, _: list[str]) -> None:
        if not self.open:
            raise self.refuse("one closing brace too many")
        self.open.pop()

    def _offset(self, words: list[str]) -> None:
        offset = finite_numbers(words[1:], 3, self.refuse)
        if abs(offset).max() > MAX_LENGTH:
            raise self.refuse(f"OFFSET {' '.join(words[1:])[:60]} is too large for a bone")
        if not self.open:
            raise self.refuse("OFFSET is not inside a joint")
        joint = self.open[-1]
        if joint == _SITE:
            self.header.tips.setdefault(self.open[-2], offset)
        else:
            self.header.offsets[joint] = offset
            self.expected = "CHANNELS"

    def _channels(self, words: list[str]) -> None:
        if not self.open or self.open[-1] == _SITE:
            raise self.refuse("CHANNELS are not inside a joint")
        count, names = words[1:2], words[2:]
        if not count or count[0] not in COUNTS:
            raise self.refuse(
                f"CHANNELS needs a number of channels up to 6, not {' '.join(count)[:40]!r}"
            )
        if len(names) != int(count[0]):
            raise self.refuse(f"CHANNELS {count[0]} is followed by {len(names)} names")
        channels = [_CHANNEL.get(name.lower(), "") for name in names]
        if "" in channels or len(set(channels)) != len(channels):
            raise self.refuse(
                f"{' '.join(names)[:80]!r} are not channels", "write Xposition, Zrotation, ..."
            )
        self.header.channels[self.open[-1]] = channels


def _fresh(name: str, taken: list[str]) -> str:
    """The name, numbered from 2 on if it is taken: joints are told apart by their place."""
    fresh, count = name, 1
    while fresh in taken:
        count += 1
        fresh = f"{name}-{count}"
    return fresh


def finite_numbers(words: list[str], count: int, refuse: Callable[[str], InputError]) -> np.ndarray:
    """The words as ``count`` finite numbers.

    Raises:
        InputError: they are not; made by ``refuse`` from what is wrong.
    """
    try:
        values = np.array(words, float)
    except ValueError:
        raise refuse(f"{' '.join(words)[:40]!r} is not {count} numbers") from None
    if len(values) != count or not np.isfinite(values).all():
        raise refuse(f"{' '.join(words)[:40]!r} is not {count} finite numbers")
    return values
