"""Estimates of a kinematic system in whose states training episodes begin."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence

import numpy as np

from agents.training.options import TrainArgs
from questsim.body import DEFAULT_HEIGHT_M
from questsim.errors import InputError
from questsim.motion.clip import Clip

FAR_M = 0.5
"""An estimate whose links are further than this from the motion's, on average, is of another."""
SPARE_FRAMES = 2
"""Recordings of other frame rates may end this many frames earlier or later."""


def load_estimates(libraries: str, seed: int) -> Iterator[Clip]:
    """The clips of several libraries of estimates, by their own names.

    Clips of two libraries may have one name: estimates of one system with other devices.

    Args:
        libraries: as in ``load_motions``, joined by commas.
        seed: of synthetic motions.
    """
    from questsim.motion.spec import load_motions, parts_of

    for library in parts_of(libraries):
        yield from load_motions(library, seed=seed)


def start_estimates(
    args: TrainArgs, clips: Sequence[Clip], shown: Mapping[str, tuple[Clip, Clip]] | None = None
) -> dict[str, Clip] | None:
    """The estimates of ``--start-estimates`` by the names of their clips; None without any.

    Of several estimates of one clip, the last is used. A tracker that observes ``--estimates``
    begins in the estimate that it observes.

    Args:
        args: of the training.
        clips: the motions.
        shown: with ``--estimates``, true and observed clip by name.

    Raises:
        InputError: only one of the two options is given, or an estimate is of other motions.
    """
    if shown is not None:
        if args.start_estimates is not None:
            what = "does not go with --estimates: episodes begin in the estimate that is observed"
            raise InputError(what, "--start-estimates", "leave it out")
        if args.starts.estimate == 0.0:
            return None
        return {name: seen for name, (truth, seen) in shown.items() if seen is not truth}
    if args.starts.estimate > 0.0 and args.start_estimates is None:
        raise InputError("needs estimates", "--starts.estimate", "add --start-estimates LIBRARY")
    if args.start_estimates is None:
        return None
    if args.starts.estimate == 0.0:
        fix = "add --starts.estimate SHARE"
        raise InputError("is not used without a share", "--start-estimates", fix)
    known = {clip.name: clip for clip in clips}
    found = {}
    for estimate in load_estimates(args.start_estimates, args.seed):
        user = estimated_clip_name(estimate, known, args.start_estimates)
        found[user] = _checked(estimate, known[user], args.start_estimates)
    return found


def estimated_clip_name(estimate: Clip, known: Container[str], where: str) -> str:
    """The name of the clip that ``questsim estimate`` made an estimate of.

    Raises:
        InputError: it is none of ``known``, the clips of ``--motions``.
    """
    user, at, _ = estimate.name.rpartition("@")
    if not at or user not in known:
        raise InputError(
            f"{estimate.name!r} is not an estimate of one of --motions",
            where,
            "name a library that questsim estimate made of them",
        )
    return user


def _checked(estimate: Clip, clip: Clip, where: str) -> Clip:
    """An estimate, no longer than its clip."""
    frames = min(len(estimate), len(clip))
    common, truth = (c.scaled(DEFAULT_HEIGHT_M).link_position[:frames] for c in (estimate, clip))
    apart = float(np.linalg.norm(common - truth, axis=-1).mean())
    if len(estimate) - len(clip) > SPARE_FRAMES or apart > FAR_M:
        raise InputError(
            f"{estimate.name!r} is not an estimate of this motion: {len(estimate)} frames for "
            f"{len(clip)}, {apart:.2f} m apart",
            where,
            "make it again by questsim estimate",
        )
    return estimate.first(frames)
