"""Single values of a preset, changed from the command line."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

import yaml

from questsim.errors import InputError

WHERE = "--set"

Preset = TypeVar("Preset")


def with_overrides(preset: Preset, assignments: Sequence[str]) -> Preset:
    """The preset with values changed.

    Args:
        preset: what to start from.
        assignments: ``path=value``, the path from the preset inwards, the value as in YAML, e.g.
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


def _value(text: str, path: str) -> Any:
    try:
        value = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise InputError(f"{text!r} is not a YAML value", f"{WHERE} {path}") from error
    if isinstance(value, str):
        # YAML 1.1 reads 6e-5 as text, for want of a point.
        with suppress(ValueError):
            return float(value)
    return value


def _changed(holder: Any, names: list[str], value: Any, path: str) -> Any:
    name, rest = names[0], names[1:]
    known = _children(holder)
    if name not in known:
        raise InputError(
            f"there is no {name!r} in the preset", f"{WHERE} {path}", f"it has {', '.join(known)}"
        )
    old = known[name]
    new = _changed(old, rest, value, path) if rest else _converted(old, value, path)
    return {**holder, name: new} if isinstance(holder, dict) else replace(holder, **{name: new})


def _children(holder: Any) -> dict[str, Any]:
    if isinstance(holder, dict):
        return holder
    if is_dataclass(holder):
        return {field.name: getattr(holder, field.name) for field in fields(holder)}
    return {}


def _converted(old: Any, value: Any, path: str) -> Any:
    """``value`` as the type of the value it replaces; what was None takes any number."""
    if is_dataclass(old) or isinstance(old, dict):
        raise InputError("names a group, not a value", f"{WHERE} {path}", "go on with a dot")
    if value is None:
        return value
    if old is None:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"{value!r} is no number", f"{WHERE} {path}", "it is now None")
        return value
    if isinstance(old, tuple) and isinstance(value, list):
        return tuple(value)
    if isinstance(old, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if type(value) is not type(old):
        raise InputError(
            f"{value!r} is no {type(old).__name__}", f"{WHERE} {path}", f"it is now {old!r}"
        )
    return value
