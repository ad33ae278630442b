"""Retargeting of estimates as on a stream: floor and ankle from what has been seen so far."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from questsim.motion.checks import stature
from questsim.motion.clip import FPS, Clip
from questsim.motion.footing import leg_targets, measure_footing
from questsim.motion.kinematics import clip_from_qpos
from questsim.motion.motion import Motion
from questsim.motion.retarget_stream import StreamRetargeter
from questsim.motion.stance_stream import StancePlanter

EVERY_FRAMES = 18
"""Frames at 36 Hz between two estimates of the footing, and over which the new one takes effect."""
MEMORY_FRAMES = 30 * int(FPS)
"""Frames of which the footing is estimated."""


class RunningRetargeter(StreamRetargeter):
    """``StreamRetargeter`` whose footing is estimated again and again during the stream.

    Several poses that arrive after each other are computed at once, with the result of one after
    the other.

    Args:
        first: the stream's first pose.
        height_m: the avatar's stature.
    """

    def __init__(self, first: Motion, height_m: float) -> None:
        super().__init__(first, height_m)
        self._from = self._next = self._footing

    def learn(self, past: Motion) -> None:
        """Estimate the footing from past poses at 36 Hz; it takes effect step by step."""
        self._from, self._next = self._next, measure_footing(past, self._height)
        if self._planter is None and self._next.soles.flat:
            self._planter = StancePlanter(self._next.soles, self._height)

    def follow(self, poses: Motion, share: np.ndarray) -> np.ndarray:
        """The avatar's ``qpos`` ``(T, 40)`` of the next poses ``(T)``.

        Args:
            poses: at 36 Hz.
            share: ``(T,)`` how much of the new footing is in effect at each, from 0 to 1.
        """
        position, quat = poses.forward_kinematics()
        return self._followed(poses, position, quat, *self._targets(poses, position, quat, share))

    def _targets(
        self, poses: Motion, position: np.ndarray, quat: np.ndarray, share: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """``leg_targets`` over the floor, each pose with its own footing."""
        found = []
        for t, part in enumerate(share):
            floor, rise = (
                (1 - part) * getattr(self._from, name) + part * getattr(self._next, name)
                for name in ("floor_m", "rise_m")
            )
            one = slice(t, t + 1)
            root, ankles = leg_targets(poses, position[one], quat[one], self._height, rise)
            found.append((root - [0.0, 0.0, floor], ankles - [0.0, 0.0, floor]))
        roots, ankles = zip(*found, strict=True)
        return np.concatenate(roots), np.concatenate(ankles)


def causal_clip(motion: Motion, at_once: int = EVERY_FRAMES) -> Clip:
    """``to_clip`` without knowledge of later frames.

    The footing of the first half second is that of the first pose. After that it is estimated twice
    a second from the poses of the last half minute.

    Args:
        motion: the poses.
        at_once: poses computed together, at most ``EVERY_FRAMES``; 1 as they come on a stream. The
            result is the same.
    """
    height = round(stature(motion), 3)
    poses = motion.resampled(FPS)
    retargeter = RunningRetargeter(_frames(poses, 0, 1), height)
    qpos = []
    for begin in range(0, len(poses), EVERY_FRAMES):
        if begin:
            retargeter.learn(_frames(poses, max(begin - MEMORY_FRAMES, 0), begin))
        end = min(begin + EVERY_FRAMES, len(poses))
        for first in range(begin, end, at_once):
            block = _frames(poses, first, min(first + at_once, end))
            share = (np.arange(first, first + len(block)) - begin + 1.0) / EVERY_FRAMES
            qpos.append(retargeter.follow(block, share))
    return clip_from_qpos(
        motion.name, np.concatenate(qpos), height, kind=motion.kind, style=motion.style
    )


def _frames(motion: Motion, first: int, end: int) -> Motion:
    return replace(
        motion,
        root_position=motion.root_position[first:end],
        rotations=motion.rotations[first:end],
    )
