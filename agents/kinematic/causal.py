"""Retargeting of estimates as on a stream: floor and ankle from what has been seen so far."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from questsim.motion.checks import stature
from questsim.motion.clip import FPS, Clip
from questsim.motion.footing import measure_footing
from questsim.motion.kinematics import clip_from_qpos
from questsim.motion.motion import Motion
from questsim.motion.retarget_stream import StreamRetargeter
from questsim.motion.stance_stream import StancePlanter

EVERY_FRAMES = 18
"""Frames at 36 Hz between two estimates of the footing, and over which the new one takes effect."""
MEMORY_FRAMES = 30 * int(FPS)
"""Frames of which the footing is estimated."""


class RunningRetargeter(StreamRetargeter):
    """``StreamRetargeter`` whose footing is estimated anew while the stream goes on.

    Args:
        first: the stream's first pose.
        height_m: the avatar's stature.
    """

    def __init__(self, first: Motion, height_m: float) -> None:
        super().__init__(first, height_m)
        self._from = self._next = self._footing

    def learn(self, past: Motion) -> None:
        """Estimate the footing from past poses at 36 Hz; it takes effect step by step."""
        self._from, self._next = self._footing, measure_footing(past, self._height)
        if self._planter is None and self._next.soles.flat:
            self._planter = StancePlanter(self._next.soles, self._height)

    def at(self, share: float) -> None:
        """Use a mixture of the last footing and the new one."""
        floor, rise = (
            (1 - share) * getattr(self._from, name) + share * getattr(self._next, name)
            for name in ("floor_m", "rise_m")
        )
        self._footing = replace(self._next, floor_m=floor, rise_m=rise)


def causal_clip(motion: Motion) -> Clip:
    """``to_clip`` without knowledge of later frames.

    The footing of the first half second is that of the first pose. After that it is estimated twice
    a second from the poses of the last half minute.
    """
    height = round(stature(motion), 3)
    poses = motion.resampled(FPS)
    retargeter = RunningRetargeter(_frames(poses, 0, 1), height)
    qpos = []
    for frame in range(len(poses)):
        block, within = divmod(frame, EVERY_FRAMES)
        if block and not within:
            retargeter.learn(_frames(poses, max(frame - MEMORY_FRAMES, 0), frame))
        if block:
            retargeter.at((within + 1) / EVERY_FRAMES)
        qpos.append(retargeter(_frames(poses, frame, frame + 1))[0])
    about = {"kind": motion.kind, "style": motion.style}
    return clip_from_qpos(motion.name, np.stack(qpos), height, **about)


def _frames(motion: Motion, first: int, end: int) -> Motion:
    return replace(
        motion,
        root_position=motion.root_position[first:end],
        rotations=motion.rotations[first:end],
    )
