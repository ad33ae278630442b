"""Retargeting of estimates as on a stream: floor and ankle from what has been seen so far."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from questsim.motion.checks import stature
from questsim.motion.clip import FPS, Clip
from questsim.motion.footing import ANKLES, leg_targets, measure_footing
from questsim.motion.kinematics import clip_from_qpos, sole_positions
from questsim.motion.limbs import SIDES, fill_arm, fill_trunk, hips_of, leg_m
from questsim.motion.motion import Motion
from questsim.motion.retarget_stream import StreamRetargeter
from questsim.motion.stance import lowest_point
from questsim.motion.stance_stream import StancePlanter
from questsim.skeleton import NUM_DOFS

EVERY_FRAMES = 18
"""Frames at 36 Hz between two estimates of the footing, and over which the new one takes effect."""
MEMORY_FRAMES = 30 * int(FPS)
"""Frames of which the footing is estimated."""


class RunningRetargeter(StreamRetargeter):
    """``StreamRetargeter`` whose footing is estimated anew while the stream goes on.

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
        angles = np.zeros((len(poses), NUM_DOFS))
        links = fill_trunk(quat, angles)
        for side in SIDES:
            fill_arm(side, poses, position, quat, links, self._height, angles)
        root, ankles = self._targets(poses, position, quat, share)
        feet, bears = quat[:, ANKLES], np.zeros(ankles.shape[:2])
        if self._planter is not None:
            hips = hips_of(root, quat, self._height)
            ankles, feet, rise, bears = self._planter(hips, ankles, feet, leg_m(self._height))
            root[:, 2] += rise
        # As in the base class; a pose that needs no second solution keeps the first one.
        allowed = np.minimum(lowest_point(ankles, feet, self._height), 0.0)
        qpos = self._with_legs(root, quat, ankles, feet, angles)
        wanted = sole_positions(ankles, feet, self._height).mean(axis=-2)
        soles = sole_positions(*self._feet(qpos), self._height)
        lowest = soles[..., 2].min(axis=-1)
        ankles[..., 2] += np.maximum(allowed - lowest, 0.0)
        ankles[..., :2] += bears[..., None] * (wanted - soles.mean(axis=-2))[..., :2]
        again = (lowest < allowed).any(axis=1) | bears.any(axis=1)
        second = self._with_legs(root, quat, ankles, feet, angles)
        return np.where(again[:, None], second, qpos)

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
