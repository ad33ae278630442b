"""A recording's joints as a tree: their names, places, paths and distances."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from questsim.motion.convert import global_pose
from questsim.motion.joint_names import Name, understand
from questsim.motion.recording import Recording
from questsim.motion.rest import some_frames

END = " End Site"
"""How the name of a leaf joint's end goes on."""


@dataclass(frozen=True)
class Tree:
    """Joints by number.

    Attributes:
        names: of the joints, understood.
        parents: -1 for none.
        place: positions ``(T, J, 3)`` of the joints in some of the frames. With all rotations zero,
            joints that have axes of their own lie anywhere.
        lengths: distances that have been asked for.
    """

    names: list[Name]
    parents: list[int]
    place: np.ndarray
    lengths: dict[tuple[int, int], float] = field(default_factory=dict)

    def children(self, joint: int) -> list[int]:
        """The joints right below."""
        return [j for j, parent in enumerate(self.parents) if parent == joint]

    def path(self, joint: int) -> list[int]:
        """From the file's root to the joint."""
        out = [joint]
        while self.parents[out[-1]] >= 0:
            out.append(self.parents[out[-1]])
        return out[::-1]

    def meet(self, a: int, b: int) -> int:
        """The lowest common ancestor of two joints."""
        shared = [x for x, y in zip(self.path(a), self.path(b), strict=False) if x == y]
        return shared[-1]

    def leaves(self, joint: int) -> list[int]:
        """The joints below that have none below them; a leaf is its own."""
        below = self.children(joint)
        return [leaf for child in below for leaf in self.leaves(child)] if below else [joint]

    def length(self, a: int, b: int) -> float:
        """Median distance of two joints."""
        if (a, b) not in self.lengths:
            distance = np.linalg.norm(self.place[:, b] - self.place[:, a], axis=-1)
            self.lengths[a, b] = float(np.median(distance))
        return self.lengths[a, b]


def tree_of(recording: Recording) -> Tree:
    """The joints of a recording; ends of leaf joints have no words in their names."""
    parents = [int(parent) for parent in recording.parents]
    names = understand([name.removesuffix(END) for name in recording.names])
    ended = [n.endswith(END) for n in recording.names]
    names = [
        replace(name, key="", part=name.part) if end else name
        for name, end in zip(names, ended, strict=True)
    ]
    place, _ = global_pose(some_frames(recording))
    return Tree(names, parents, place)
