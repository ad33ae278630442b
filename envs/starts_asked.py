"""Validation of the options and seeds of ``reset``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from envs.checks import is_whole
from envs.reference import Reference
from questsim.errors import InputError


def asked_start(
    reference: Reference, options: Any, where: str = "options"
) -> tuple[int, int] | None:
    """Clip and first frame that the options of one episode ask for; None if they are random.

    Args:
        reference: the clips.
        options: None, or a mapping with ``clip`` (a name or an index) and ``frame`` (default 0).
            ``frame`` requires ``clip`` unless there is only one clip.
        where: source of the options, for error messages.

    Raises:
        InputError: an unknown option, clip or frame.
    """
    if options is None:
        return None
    if not isinstance(options, dict):
        raise InputError(f"is of the type {type(options).__name__}, not a dict", where)
    unknown = sorted(str(name) for name in options if name not in ("clip", "frame"))
    if unknown:
        raise InputError(f"there is no {unknown[0][:80]!r}", where, "it takes clip and frame")
    clip, frame = options.get("clip"), options.get("frame")
    if clip is None and frame is None:
        return None
    if clip is None and len(reference.names) > 1:
        raise InputError("a frame needs a clip", f"{where}['frame']", "give clip as well")
    index = 0 if clip is None else _clip_index(reference, clip, f"{where}['clip']")
    return index, _first_frame(reference, index, 0 if frame is None else frame, where)


def _clip_index(reference: Reference, clip: Any, where: str) -> int:
    names = reference.names
    if isinstance(clip, str):
        if clip not in names:
            some = ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")
            raise InputError(f"no clip is named {clip[:80]!r}", where, f"there are {some}")
        return names.index(clip)
    if not is_whole(clip):
        raise InputError(f"is {str(clip)[:80]!r}", where, "it takes a clip's name or its index")
    if not 0 <= int(clip) < len(names):
        raise InputError(f"is {clip}, not 0 to {len(names) - 1}", where)
    return int(clip)


def _first_frame(reference: Reference, clip: int, frame: Any, where: str) -> int:
    where = f"{where}['frame']"
    last = int(reference.end[clip] - reference.start[clip]) - 2
    if not is_whole(frame):
        raise InputError(f"is {str(frame)[:80]!r}", where, "it takes a whole number")
    if not 0 <= int(frame) <= last:
        raise InputError(f"is {frame}, not 0 to {last} of clip {reference.names[clip]!r}", where)
    return int(frame)


def split_options(options: Any, count: int) -> list[dict[str, Any] | None]:
    """Options of a vector environment for each of its simulations.

    Args:
        options: a mapping whose values are for all, or sequences with one entry for each
            simulation; None means random. ``reset_mask`` is ignored.
        count: number of simulations.

    Raises:
        InputError: a sequence of the wrong length.
    """
    if options is None:
        return [None] * count
    if not isinstance(options, dict):
        raise InputError(f"is of the type {type(options).__name__}, not a dict", "options")
    each: list[dict[str, Any] | None] = [{} for _ in range(count)]
    for name, value in options.items():
        if name == "reset_mask":
            continue
        values = [value] * count
        if isinstance(value, np.ndarray):
            value = value.tolist()
        if isinstance(value, Sequence) and not isinstance(value, str):
            values = list(value)
        if len(values) != count:
            where = f"options[{str(name)[:80]!r}]"
            raise InputError(f"has {len(values)} entries for {count} simulations", where)
        for mine, entry in zip(each, values, strict=True):
            assert mine is not None
            mine[name] = entry
    return each


def reset_mask(options: Any, count: int) -> np.ndarray:
    """``(count,)`` bool, the simulations that ``options["reset_mask"]`` selects; default: all.

    Raises:
        InputError: not an array of ``count`` bools, or no simulation is selected.
    """
    if not isinstance(options, dict) or "reset_mask" not in options:
        return np.ones(count, bool)
    mask = options["reset_mask"]
    where = "options['reset_mask']"
    if not isinstance(mask, np.ndarray) or mask.dtype != bool or mask.shape != (count,):
        raise InputError(f"is not a NumPy array of {count} bools", where)
    if not mask.any():
        raise InputError("is False everywhere", where, "leave out the reset")
    return mask


def seeds_of(seed: Any, count: int) -> list[int | None]:
    """A seed for each simulation: ``seed + i`` for one seed, as in gymnasium, or a sequence.

    Raises:
        InputError: the wrong number of seeds, or one that is not a whole number from 0 on.
    """
    if seed is None:
        return [None] * count
    if is_whole(seed) and int(seed) >= 0:
        return [int(seed) + i for i in range(count)]
    if isinstance(seed, np.ndarray):
        seed = seed.tolist()
    if not isinstance(seed, Sequence) or isinstance(seed, str):
        raise InputError(f"is {str(seed)[:80]!r}, not a whole number from 0 on", "seed")
    if len(seed) != count:
        raise InputError(f"has {len(seed)} entries for {count} simulations", "seed")
    for i, one in enumerate(seed):
        if one is not None and not (is_whole(one) and int(one) >= 0):
            raise InputError(f"is {str(one)[:80]!r}, not a whole number from 0 on", f"seed[{i}]")
    return [None if one is None else int(one) for one in seed]


def check_begun(begun: bool) -> None:
    """Reject a step before the first ``reset``.

    Raises:
        InputError: no episode has begun.
    """
    if not begun:
        raise InputError("no episode has begun", "step", "call reset before the first step")


def entropy() -> int:
    """A random 63-bit seed of the operating system."""
    return int(np.random.SeedSequence().generate_state(1, np.uint64)[0] >> np.uint64(1))
