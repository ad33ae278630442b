"""Change single values of a preset from the command line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from types import NoneType
from typing import Any, TypeVar, get_args, get_type_hints

from questsim.errors import InputError
from questsim.files import parse_yaml

WHERE = "--set"
MAY_BE_ZERO = ("mix_steps", "critic_warmup_steps")
"""Counts for which 0 means off, whatever the preset's value; a count that is now 0 may stay 0."""
LARGEST = 1_000_000_000

PresetT = TypeVar("PresetT")


def with_overrides(preset: PresetT, assignments: Sequence[str]) -> PresetT:
    """The preset with values changed.

    Args:
        preset: the preset to change.
        assignments: ``path=value``: dotted field names from the preset down, and a YAML value, e.g.
            ``"stages.teacher.learning.desired_kl=0.06"`` or ``"num_envs=64"``.

    Raises:
        InputError: no such field, or a value of another type.
    """
    for assignment in assignments:
        path, equals, text = assignment.partition("=")
        if not equals:
            raise InputError(f"{assignment!r} is not path=value", WHERE)
        preset = _changed(preset, path.split("."), _value(text, path), path)
    return preset


def refuse_repeated(assignments: Sequence[str]) -> None:
    """Refuse assignments of which a later one undoes an earlier one.

    Raises:
        InputError: a path is given twice.
    """
    paths = [assignment.partition("=")[0] for assignment in assignments]
    for path in paths:
        if paths.count(path) > 1:
            raise InputError("is given twice", f"{WHERE} {path}", "give it once")


def overridden(assignments: Sequence[str], by: Sequence[str]) -> tuple[str, ...]:
    """Assignments followed by others, without those whose paths the others assign."""
    paths = {assignment.partition("=")[0] for assignment in by}
    return (*(one for one in assignments if one.partition("=")[0] not in paths), *by)


def value_at(preset: Any, path: str) -> Any:
    """The value of a preset at a path of ``with_overrides``, which has checked it."""
    for name in path.split("."):
        preset = _children(preset)[name]
    return preset


def _value(text: str, path: str) -> Any:
    try:
        value = parse_yaml(text)
    except ValueError as error:
        raise InputError(f"{text!r} is not a YAML value", f"{WHERE} {path}") from error
    if isinstance(value, str):
        # YAML 1.1 reads 6e-5 as text, since it has no decimal point.
        with suppress(ValueError):
            return float(value)
    return value


def _changed(holder: Any, names: list[str], value: Any, path: str) -> Any:
    name, rest = names[0], names[1:]
    known = _children(holder)
    if name not in known:
        fix = f"it has {', '.join(known)}"
        if path.endswith(f".reward.{name}"):
            fix += "; for a term of your own, name its module in QUESTSIM_EXTENSIONS"
        raise InputError(f"there is no {name!r} in the preset", f"{WHERE} {path}", fix)
    old = known[name]
    if not rest and value is None and not _may_be_none(holder, name):
        raise InputError("needs a value", f"{WHERE} {path}", f"it is now {old!r}")
    new = _changed(old, rest, value, path) if rest else _converted(old, value, path)
    if isinstance(holder, dict):
        return {**holder, name: new}
    try:
        return replace(holder, **{name: new})
    except InputError as error:  # the dataclass refuses the value
        where = error.where if str(error.where).startswith(WHERE) else f"{WHERE} {path}"
        raise InputError(error.what, where, error.fix) from error


def _may_be_none(holder: Any, name: str) -> bool:
    """Whether a field of a dataclass may be None."""
    return is_dataclass(holder) and NoneType in get_args(get_type_hints(type(holder)).get(name))


def _children(holder: Any) -> dict[str, Any]:
    if isinstance(holder, dict):
        return holder
    if is_dataclass(holder):
        return {field.name: getattr(holder, field.name) for field in fields(holder)}
    return {}


def _converted(old: Any, value: Any, path: str) -> Any:
    """``value`` converted to the type of the old value; None may be replaced by any number."""
    if is_dataclass(old) or isinstance(old, dict):
        raise InputError("names a group, not a value", f"{WHERE} {path}", "add a dot and a name")
    if value is None:
        return value
    if old is None:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"{value!r} is not a number", f"{WHERE} {path}", "it is now None")
        _check_number(value, old, path)
        return value
    if isinstance(old, tuple) and isinstance(value, list):
        for one in value:
            _check_number(one, old[0] if old else None, path)
        return tuple(value)
    if isinstance(old, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if type(value) is not type(old):
        raise InputError(
            f"{value!r} is not of type {type(old).__name__}",
            f"{WHERE} {path}",
            f"it is now {old!r}",
        )
    _check_number(value, old, path)
    return value


def _check_number(value: Any, old: Any, path: str) -> None:
    """Refuse numbers that are invalid in every preset.

    Raises:
        InputError: a number is not finite, or a count is negative, zero where at least one is
            needed, or larger than ``LARGEST``.
    """
    where, now = f"{WHERE} {path}", f"it is now {old!r}"
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError("is not a finite number", where, now)
    if isinstance(value, bool) or not isinstance(value, int):
        return
    least = 0 if old == 0 or path.rpartition(".")[2] in MAY_BE_ZERO else 1
    if not least <= value <= LARGEST:
        raise InputError(f"is {str(value)[:20]}, not {least} to {LARGEST}", where, now)
