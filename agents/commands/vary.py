"""``questsim motions vary``, also on the workers of a Ray cluster."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from tqdm import tqdm

from questsim.errors import at_least
from questsim.motion import vary_command
from questsim.motion.clip import Clip
from questsim.motion.library import save_library
from questsim.motion.motions_command import check_library_path
from questsim.motion.spec import load_motions
from questsim.motion.variation import Tally, long_enough, variations

PART = 8
"""Variations that a worker makes at a time."""


@dataclass(frozen=True)
class VaryArgs(vary_command.VaryArgs):
    """Vary motions randomly in speed, posture, stance, path and arm movement."""

    workers: int = 0
    """Ray workers that share the variations (docs/scaling.md); 0 for none."""
    ray: str | None = None
    """Address of a Ray cluster for --workers, by default one of this machine alone."""


def vary_motions(args: VaryArgs) -> int:
    """See ``questsim.motion.vary_command``; workers make the same variations.

    Raises:
        InputError: as there, or Ray or the cluster cannot be used.
    """
    if not args.workers and args.ray is None:
        return vary_command.vary_motions(args)
    # Imported here: this loads PyTorch, which variations on this machine alone do not need.
    from agents.training.ray_session import ray_map

    at_least(1, count=args.count)
    at_least(0, seed=args.seed, first=args.first, workers=args.workers)
    check_library_path(args.out)
    clips = load_motions(args.spec, seed=args.seed)
    long_enough(clips)
    numbers = range(args.first, args.first + args.count)
    parts = [numbers[i : i + PART] for i in range(0, len(numbers), PART)]
    made, tally = [], Tally()
    with ray_map(args.workers, args.ray) as mapper:
        results = mapper(partial(_part, clips, args.seed), parts)
        for variants, counted in tqdm(results, total=len(parts), disable=None):
            made += variants
            tally.tried += counted.tried
            for why, count in counted.rejected.items():
                tally.rejected[why] += count
    save_library(args.out, [], made)
    print(tally)
    print(f"{len(made)} clips, {sum(clip.duration for clip in made):.0f} s, in {args.out}")
    return 0


def _part(clips: Sequence[Clip], seed: int, numbers: range) -> tuple[list[Clip], Tally]:
    tally = Tally()
    return list(variations(clips, numbers, seed, tally=tally)), tally
