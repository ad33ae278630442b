"""``questsim motions vary``: write a library of variations."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import tyro
from tqdm import tqdm

from questsim.errors import at_least
from questsim.motion.clip import Clip
from questsim.motion.library import save_library
from questsim.motion.motions_command import check_library_path
from questsim.motion.spec import load_motions
from questsim.motion.variation import SHORTEST_S, Tally, long_enough, variations

INTERRUPTED = 130
"""Exit code after Ctrl-C."""


@dataclass(frozen=True)
class VaryArgs:
    """Vary motions randomly in speed, posture, stance, path and arm movement."""

    spec: tyro.conf.Positional[str]
    """Motions to vary: a dataset (with :train), library, file, folder, or synthetic."""
    out: Path
    """The library to write, LIBRARY.npz."""
    count: int = 1000
    """How many variations."""
    seed: int = 0
    """Random seed; the same motions and seed give the same variations."""
    first: int = 0
    """Number of the first variation, to continue after an earlier library of this seed."""


def vary_motions(args: VaryArgs) -> int:
    """Write a library of variations; print a summary of them and of the rejected recipes.

    After Ctrl-C the library holds the variations made so far.

    Returns:
        the exit code.

    Raises:
        InputError: the motions cannot be varied, or the library cannot be written.
    """
    at_least(1, count=args.count)
    at_least(0, seed=args.seed, first=args.first)
    check_library_path(args.out)
    tally, made = Tally(), []
    numbers = range(args.first, args.first + args.count)
    clips = load_motions(args.spec, seed=args.seed)
    left_out = len(clips) - len(long_enough(clips))
    if left_out:
        print(f"{left_out} of {len(clips)} clips are shorter than {SHORTEST_S:g} s or need a chair")
    stream = variations(clips, numbers, args.seed, tally=tally)
    code = 0
    try:
        for clip in tqdm(stream, total=args.count, unit=" clips", disable=None):
            made.append(clip)
    except KeyboardInterrupt:
        if not made:
            raise
        code = INTERRUPTED
    save_library(args.out, [], made)
    _print_summary(made, tally)
    print(f"{len(made)} clips, {sum(clip.duration for clip in made):.0f} s, in {args.out}")
    if code:
        done = args.first + len(made)
        print(f"interrupted; go on with --first {done} --count {numbers.stop - done}")
    return code


def _print_summary(made: list[Clip], tally: Tally) -> None:
    ingredients = Counter(clip.kind.rpartition("+")[2] for clip in made)
    print("most of all: " + ", ".join(f"{name} {n}" for name, n in ingredients.most_common()))
    print(tally)
    licences = sorted({clip.licence or "not stated" for clip in made})
    print(f"licence: {', '.join(licences)}")
