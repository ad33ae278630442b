"""Options of an environment in plain forms (names, numbers, mappings) as an ``EnvConfig``."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from envs.checks import is_number
from envs.config import EnvConfig
from envs.objects import WorldObject, objects_named
from envs.pushes import Pushes
from envs.randomisation import Randomisation
from envs.starts import Starts
from envs.terrain import Terrain, terrain_named
from questsim import bodies
from questsim.errors import InputError, value_text
from questsim.motion.clip import Clip
from questsim.reward import RewardConfig
from questsim.sensors import SensorNoise

Motions = str | Clip | Sequence[Clip]
"""What to follow: clips, or a motion argument such as ``"bandai-namco-2:train"``."""

_T = TypeVar("_T")


class UnknownOptionError(InputError, TypeError):
    """Error for an unknown keyword option.

    It is also a ``TypeError`` with Python's wording, because libraries probe constructors that way
    (TorchRL tries ``frameskip``). gymnasium re-raises such errors with all arguments appended;
    clips would fill the screen, so that part is dropped.
    """

    def __init__(self, name: Any, known: Sequence[str] = ()) -> None:
        if known:
            near = difflib.get_close_matches(str(name), known, 1)
            hint = f" (did you mean {near[0]}?)" if near else ""
            what = f"unexpected keyword argument {_shown(name)}{hint}"
            super().__init__(what, "options", f"there are {', '.join(known)}")
        else:
            super().__init__(str(name).partition(" was raised from the environment creator")[0])


def clips_of(motions: Any) -> Sequence[Clip]:
    """Return clips unchanged; load those that a motion argument names.

    Raises:
        InputError: neither clips nor a motion argument, or no such motions.
    """
    if isinstance(motions, Clip):
        return [motions]
    listed: list[Any] = [motions] if isinstance(motions, str) else _listed(motions)
    if listed and all(isinstance(part, str) for part in listed):
        from questsim.motion.spec import load_motions

        return load_motions(motions)
    for number, clip in enumerate(listed):
        if not isinstance(clip, Clip):
            raise InputError(
                f"is {_shown(clip)}, not a Clip",
                f"motions[{number}]",
                'give clips, or a motion argument such as "synthetic:walk"',
            )
    return listed


def _listed(motions: Any) -> list[Any]:
    if isinstance(motions, Sequence):
        return list(motions)
    raise InputError(
        f"is {_shown(motions)}, not a list of clips",
        "motions",
        'give clips, or a motion argument such as "synthetic:walk"',
    )


def config_from(options: Mapping[str, Any]) -> EnvConfig:
    """Make a config from keyword options in plain forms.

    For example ``{"terrain": "rough:seed=3", "objects": ("chair",), "heights": 1.7,
    "pushes": (0, 100), "reward": {"contact": 0.5}}``. A terrain or an object is given by its name;
    one height applies to all; two numbers are the range of the pushes' force in newtons; a mapping
    contains the fields that differ from their defaults. One number is a range of that number alone.
    NumPy's numbers and arrays are taken as Python's.

    Raises:
        InputError: an unknown option, or an invalid value.
    """
    known = [field.name for field in fields(EnvConfig)]
    for name in options:
        if name not in known:
            raise UnknownOptionError(name, known)
    return EnvConfig(**{name: _PLAIN.get(name, _same)(_python(v)) for name, v in options.items()})


def config_of(config: Any, options: Mapping[str, Any]) -> EnvConfig:
    """Combine the config and the keyword options of a constructor.

    Args:
        config: an ``EnvConfig``, a mapping of its fields, or None.
        options: keyword options, among them those of an id such as ``QuestSimRough-v0``.

    Raises:
        InputError: the two contradict each other, or an option is invalid (see ``config_from``).
    """
    if config is None:
        return config_from(options)
    if isinstance(config, Mapping):
        config = config_from(config)
    if not isinstance(config, EnvConfig):
        raise InputError(f"is {_shown(config)}, not an EnvConfig", "config")
    wanted = config_from(options)
    for name in options:
        if getattr(config, name) != getattr(wanted, name):
            raise InputError(
                f"has {name}={_shown(getattr(config, name))}, but the id or a keyword asks for "
                f"{_shown(getattr(wanted, name))}",
                "config",
                f"leave config out and give its fields as keywords, or set {name} in it",
            )
    return config


def _same(value: Any) -> Any:
    return value


def _python(value: Any) -> Any:
    """A NumPy number or array as Python's; anything else unchanged."""
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else value


def _terrain(value: Any) -> Any:
    if isinstance(value, str):
        return terrain_named(value)
    return _fields_of(Terrain, value, "terrain")


def _body(value: Any) -> Any:
    return bodies.read_body(str(value)) if isinstance(value, str | Path) else value


def _objects(value: Any) -> Any:
    objects = [value] if isinstance(value, str | Mapping | WorldObject) else value
    if not isinstance(objects, Sequence):
        return value
    return tuple(
        objects_named([obj])[0] if isinstance(obj, str) else _fields_of(WorldObject, obj, "objects")
        for obj in objects
    )


def _pushes(value: Any) -> Any:
    if is_number(value):
        return Pushes(force_n=(value, value))
    if isinstance(value, Sequence) and not isinstance(value, str):
        return Pushes(force_n=tuple(value))  # type: ignore[arg-type]  # checked there
    return _fields_of(Pushes, value, "pushes")


def _heights(value: Any) -> Any:
    if is_number(value):
        return (float(value), float(value))
    return tuple(value) if isinstance(value, list) else value


def _frames(value: Any) -> Any:
    if isinstance(value, int) and not isinstance(value, bool):
        return (value,)
    return tuple(value) if isinstance(value, list) else value


def _fields_of(kind: type[_T], value: Any, where: str) -> Any:
    """Make a dataclass from a mapping; anything else is returned for ``EnvConfig`` to check."""
    if not isinstance(value, Mapping):
        return value
    known = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    for name in value:
        if name not in known:
            raise InputError(_unknown(name, known), where, f"it has {', '.join(known)}")
    values: dict[str, Any] = {}
    for field in fields(kind):  # type: ignore[arg-type]
        given = _python(value.get(field.name, field.default))
        if is_number(field.default) and not (is_number(given) and np.isfinite(given)):
            raise InputError(f"is {_shown(given)}, not a number", f"{where} {field.name}")
        if field.name in value:
            values[field.name] = _ranged(given, field.default)
    return kind(**values)


def _ranged(value: Any, default: Any) -> Any:
    """A list as a tuple; where a range is wanted, one number as the range of that number alone."""
    if isinstance(value, list):
        return tuple(value)
    pair = isinstance(default, tuple) and len(default) == 2
    return (value, value) if pair and is_number(value) else value


_PLAIN: dict[str, Callable[[Any], Any]] = {
    "terrain": _terrain,
    "body": _body,
    "objects": _objects,
    "pushes": _pushes,
    "heights": _heights,
    "privileged_frames": _frames,
    "reward": lambda value: _fields_of(RewardConfig, value, "reward"),
    "noise": lambda value: _fields_of(SensorNoise, value, "noise"),
    "randomisation": lambda value: _fields_of(Randomisation, value, "randomisation"),
    "starts": lambda value: _fields_of(Starts, value, "starts"),
}


def _unknown(name: Any, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(str(name), known, 1)
    return f"there is no {_shown(name)}" + (f" (did you mean {near[0]}?)" if near else "")


def _shown(value: Any) -> str:
    return f"the terrain {value.kind!r}" if isinstance(value, Terrain) else value_text(value)
