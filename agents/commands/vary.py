"""``questsim motions vary``: write a library of variations, here or on the workers of Ray."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial

from tqdm import tqdm

from agents.training.watched import beside_ray
from questsim.errors import INTERRUPTED, at_least, usable_seed
from questsim.motion.clip import Clip
from questsim.motion.library import bare, save_library
from questsim.motion.motions_command import check_library_path
from questsim.motion.spec import load_motions
from questsim.motion.variation import SHORTEST_S, Tally, long_enough, variations
from questsim.motion_options import VaryArgs

PART = 8
"""Variations that a worker makes at a time."""


@beside_ray
def vary_motions(args: VaryArgs) -> int:
    """Write a library of variations; print a summary of them and of the rejected recipes.

    Workers make the same variations. After Ctrl-C the library holds the variations made so far.

    Returns:
        the exit code.

    Raises:
        InputError: the motions cannot be varied, the library cannot be written, or Ray or its
            cluster cannot be used.
    """
    at_least(1, count=args.count)
    at_least(0, first=args.first, workers=args.workers)
    usable_seed(args.seed)
    check_library_path(args.out, args.spec)
    clips = load_motions(args.spec, seed=args.seed)
    left_out = len(clips) - len(long_enough(clips))
    if left_out:
        print(f"{left_out} of {len(clips)} clips are shorter than {SHORTEST_S:g} s or need a chair")
    numbers = range(args.first, args.first + args.count)
    tally, made, code = Tally(), [], 0
    if args.workers or args.ray is not None:
        stream = _from_workers(args, clips, numbers, tally)
    else:
        stream = variations(clips, numbers, args.seed, tally=tally)
    try:
        for clip in tqdm(stream, total=args.count, unit=" clips", disable=None):
            made.append(bare(clip))
    except KeyboardInterrupt:
        if not made:
            raise
        code = INTERRUPTED
    save_library(args.out, [], made)
    _print_summary(made, tally)
    clips_made = "1 clip" if len(made) == 1 else f"{len(made)} clips"
    print(f"{clips_made}, {sum(clip.duration for clip in made):.0f} s, in {args.out}")
    if code:
        done = args.first + len(made)
        print(f"interrupted; continue with --first {done} --count {numbers.stop - done}")
    return code


def _from_workers(
    args: VaryArgs, clips: Sequence[Clip], numbers: range, tally: Tally
) -> Iterator[Clip]:
    """The variations in order, made on the workers of Ray; counts them in ``tally``."""
    # Imported here: this loads PyTorch, which variations on this machine alone do not need.
    from agents.training.ray_session import ray_map

    parts = [numbers[i : i + PART] for i in range(0, len(numbers), PART)]
    with ray_map(args.workers, args.ray) as mapper:
        for variants, counted in mapper(partial(_part, clips, args.seed), parts):
            tally.tried += counted.tried
            for why, count in counted.rejected.items():
                tally.rejected[why] += count
            yield from variants


def _part(clips: Sequence[Clip], seed: int, numbers: range) -> tuple[list[Clip], Tally]:
    tally = Tally()
    return list(variations(clips, numbers, seed, tally=tally)), tally


def _print_summary(made: list[Clip], tally: Tally) -> None:
    ingredients = Counter(clip.kind.rpartition("+")[2] for clip in made)
    print("most of all: " + ", ".join(f"{name} {n}" for name, n in ingredients.most_common()))
    print(tally)
    licences = sorted({clip.licence or "not stated" for clip in made})
    print(f"licence: {', '.join(licences)}")
