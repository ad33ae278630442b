"""Loads the motions of a motion argument: dataset, library, file, folder or ``synthetic``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from questsim.errors import InputError
from questsim.motion.clip import Clip
from questsim.motion.mixture import (
    is_mixture,
    load_mixture,
    mixture_reads_seed,
    mixture_sources,
)
from questsim.motion.motion import Motion
from questsim.motion.naming import (
    SYNTHETIC,
    is_synthetic,
    named,
    place,
    split_parts,
    unique_names,
)
from questsim.waiting import said_if_slow

if TYPE_CHECKING:
    from questsim.motion.library import Library

RANDOM, HELD_OUT = "random", "held-out"
RANDOM_COUNT = 100
"""Number of clips of ``synthetic:random`` and ``synthetic:held-out`` if not given."""
MAX_DIGITS = 9
"""Most digits of a given number of clips."""

_T = TypeVar("_T", Motion, Clip)


def load_motions(
    spec: str | Sequence[str],
    *,
    height_m: float | None = None,
    mirrored: bool = False,
    seed: int = 0,
    strict: bool = False,
    own_proportions: bool = False,
) -> list[Clip]:
    """The avatar's clips that a motion argument names.

    Files are read and retargeted once; the result is kept in the cache. Unusable
    files in a folder or zip are skipped and named on stderr. Everything runs in this process,
    unless the caller allows more (``questsim.processes``).

    Args:
        spec: ``synthetic`` (or some of its kinds, ``synthetic:walk+bow``, or ``synthetic:all``,
            ``synthetic:random:500``, ``synthetic:held-out:40``), a dataset
            (``bandai-namco-2``, ``bandai-namco-2:train``, ``bandai-namco-2:test``), a library, a
            BVH or AMASS file, a folder of these, a part of a mixture file (``FILE.toml:PART``),
            or several, joined by commas or as a sequence; a file's or folder's own name may
            have commas.
        height_m: scale all clips to this stature; by default each keeps its performer's.
        mirrored: add a mirrored copy of each clip after the clip itself.
        seed: of the synthetic motions.
        strict: reject a folder that contains an unusable file.
        own_proportions: each clip's avatar has its performer's proportions, not only the stature.
            Such clips are retargeted anew in each call; synthetic ones are of the default body.

    Raises:
        InputError: nothing has this name, a dataset is not fetched, a file named directly
            is unusable, or all files of a folder are; a library has clips without motions, or a
            performer's body is none that the avatar can have, with ``own_proportions``.
    """

    def of(part: str, seed: int) -> list[Clip]:
        if is_synthetic(part):
            return _synthetic(part, seed)
        if not own_proportions:
            return _load(part, strict).clips
        from questsim.motion.retarget import to_clip

        motions = _load(part, strict, _without_motion).motions
        return [to_clip(motion, own_proportions=True) for motion in motions]

    clips = _all_parts(spec, seed, of)
    if height_m is not None:
        clips = [clip.scaled(height_m) for clip in clips]
    if mirrored:
        from questsim.motion.retarget import mirror_clip

        clips = [copy for clip in clips for copy in (clip, mirror_clip(clip))]
    return clips


def _without_motion(clip: Clip) -> Motion:
    what = "has no motion, whose body could be measured"
    raise InputError(what, clip.name, "leave it out, or import its file again with this version")


def load_recordings(
    spec: str | Sequence[str], *, mirrored: bool = False, seed: int = 0, strict: bool = False
) -> list[Motion]:
    """Like ``load_motions``, but motions on the 22-joint skeleton, as recorded or generated.

    A library of variations or estimates holds clips alone: motions are made from these.

    Args:
        spec: as in ``load_motions``.
        mirrored: add a mirrored copy of each motion after the motion itself.
        seed: of the synthetic motions.
        strict: as in ``load_motions``.

    Raises:
        InputError: as ``load_motions``.
    """
    from questsim.motion.retarget_back import to_motion

    def of(part: str, seed: int) -> list[Motion]:
        if is_synthetic(part):
            return [to_motion(clip) for clip in _synthetic(part, seed)]
        return _load(part, strict, to_motion).motions

    motions = _all_parts(spec, seed, of)
    if not motions:
        raise InputError(f"no motions in {spec}", fix="name a library or folder that holds some")
    if mirrored:
        motions = [copy for motion in motions for copy in (motion, motion.mirrored())]
    return motions


def _all_parts(
    spec: str | Sequence[str], seed: int, of: Callable[[str, int], Sequence[_T]]
) -> list[_T]:
    """What ``of`` loads for each part of a motion argument, also for the parts of mixtures."""

    def several(spec: str | Sequence[str], seed: int) -> list[_T]:
        return _with_unique_names([(part, one(part, seed)) for part in parts_of(spec)])

    def one(part: str, seed: int) -> Sequence[_T]:
        if is_mixture(part):
            return _with_unique_names(load_mixture(part, several, seed))
        return of(part, seed)

    return several(spec, seed)


def _load(part: str, strict: bool, motion_of: Callable[[Clip], Motion] | None = None) -> Library:
    from questsim.motion.loaded import load_part  # late: embedded motions need no readers

    return load_part(part, strict, motion_of)


def reads_file(spec: str | Sequence[str], file: Path) -> bool:
    """Whether a motion argument names a file, or a folder or a mixture with it.

    Raises:
        InputError: no motions are named, or a mixture file cannot be read.
    """
    places = file.resolve(), *file.resolve().parents
    return any(
        any(reads_file(source, file) for source in mixture_sources(part))
        if is_mixture(part)
        else not is_synthetic(part) and Path(part).resolve() in places
        for part in parts_of(spec)
    )


def check_seed(spec: str | Sequence[str], seed: int) -> None:
    """Refuse the option ``--seed`` where none of the motions depends on it.

    Raises:
        InputError: the seed is not 0, and no motions are embedded or drawn at random.
    """
    if seed and not any(map(_reads_seed, parts_of(spec))):
        what = "has no effect: it is the seed of embedded motions, and none is among these"
        raise InputError(what, "--seed", "leave it out")


def check_own_proportions(spec: str | Sequence[str]) -> None:
    """Refuse the option ``--own-proportions`` where all motions are embedded.

    Raises:
        InputError: they are.
    """
    if all(map(is_synthetic, parts_of(spec))):
        what = "has no effect: embedded motions are of the default body"
        raise InputError(what, "--own-proportions", "leave it out, or name motions of people")


def _reads_seed(part: str) -> bool:
    return mixture_reads_seed(part) if is_mixture(part) else is_synthetic(part)


def parts_of(spec: str | Sequence[str]) -> list[str]:
    """The parts of a motion argument, each an argument of its own.

    Raises:
        InputError: there is none.
    """
    parts = split_parts(spec)
    if not parts:
        from questsim.motion.loaded import choices

        raise InputError("no motions named", fix=choices())
    return parts


@said_if_slow("making embedded motions, which are then kept in the cache ...")
def _synthetic(part: str, seed: int) -> list[Clip]:
    """All of ``synthetic``, the kinds in ``synthetic:KIND+KIND``, or random clips."""
    from questsim.motion.synthesis import random_clips as random
    from questsim.motion.synthesis.synthetic import (
        ACTIONS,
        KINDS,
        SEATED,
        seated_clips,
        synthetic_clips,
    )

    _, colon, kinds = part.partition(":")
    if not colon:
        return synthetic_clips(seed)
    first, counted, number = kinds.partition(":")
    if first in (RANDOM, HELD_OUT):
        make = random.random_clips if first == RANDOM else random.held_out_clips
        return make(_count(number, part) if counted else RANDOM_COUNT, seed)
    if kinds == "all":
        return synthetic_clips(seed) + random.action_clips(tuple(ACTIONS), seed)
    wanted, known = first.split("+"), (*KINDS, *ACTIONS, *SEATED)
    if "all" in wanted:
        what = "all stands alone, without other kinds and without a count"
        raise InputError(what, part, f"write {SYNTHETIC}:all, or {SYNTHETIC}:{RANDOM}:500")
    for kind in wanted:
        if kind not in known:
            choices = ", ".join((*known, "all", f"{RANDOM}:COUNT", f"{HELD_OUT}:COUNT"))
            raise InputError(f"there is no kind {kind!r}", part, f"choose from {choices}")
        if wanted.count(kind) > 1:
            raise InputError(f"has the kind {kind!r} twice", part, "write it once")
    if counted:
        return _random_clips(part, wanted, _count(number, part), seed)
    # Each is generated only on request.
    clips = synthetic_clips(seed, kinds=wanted)
    clips += random.action_clips([kind for kind in ACTIONS if kind in wanted], seed)
    clips += seated_clips(seed) if set(wanted) & set(SEATED) else []
    return [clip for clip in clips if clip.kind in wanted]


def _random_clips(part: str, kinds: Sequence[str], count: int, seed: int) -> list[Clip]:
    """Random clips of some kinds; those with a chair differ by the seed alone."""
    from questsim.motion.synthesis.random_clips import random_clips
    from questsim.motion.synthesis.synthetic import SEATED, seated_clips

    if count < len(kinds):
        what = f"{count} clip{'s' if count > 1 else ''} cannot be of {len(kinds)} kinds"
        raise InputError(what, part, f"ask for {len(kinds)} or more")
    seated = set(kinds) & set(SEATED)
    if seated and not seated.issuperset(kinds):
        raise InputError("some kinds need a chair, and some do not", part, "write two parts")
    if not seated:
        return random_clips(count, seed, kinds)
    clips: list[Clip] = []
    for one in range(seed, seed + count):
        if len(clips) >= count:
            break
        clips += [named(c, f"{c.name}-{one}") for c in seated_clips(one) if c.kind in seated]
    return clips[:count]


def _count(text: str, part: str) -> int:
    if not text.isdecimal() or len(text) > MAX_DIGITS or int(text) < 1:
        what = f"{text!r} is not a number of clips, 1 or more with up to {MAX_DIGITS} digits"
        raise InputError(what, part, f"write {':'.join(part.split(':')[:2])}:500")
    return int(text)


def _with_unique_names(parts: Sequence[tuple[str, Sequence[_T]]]) -> list[_T]:
    """The items of all parts; repeated names get a folder's name or a number."""
    items = [item for _, members in parts for item in members]
    places = [place(part) for part, members in parts for _ in members]
    names = unique_names([item.name for item in items], places)
    return [named(item, name) for item, name in zip(items, names, strict=True)]
