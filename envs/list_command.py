"""The command ``questsim envs``."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields
from typing import Any

from envs.config import EnvConfig
from envs.layout import observation_layout, observation_size
from envs.registration import ENVIRONMENTS
from envs.terrain import RANGES, TERRAINS, Terrain, terrain_named
from questsim.errors import InputError


@dataclass(frozen=True)
class ListEnvsArgs:
    """List the environments and their options."""

    name: str | None = None
    """Describe this environment or terrain in full."""


def list_environments(args: ListEnvsArgs) -> int:
    """Print the ids with their differences from the defaults, or all options of one id.

    Returns:
        The exit code.

    Raises:
        InputError: there is no such environment or terrain.
    """
    if args.name is None:
        width = max(map(len, ENVIRONMENTS))
        for name, options in ENVIRONMENTS.items():
            text = ", ".join(f"{key}={value!r}" for key, value in options.items())
            print(f"{name:{width}}  {text or 'flat ground, headset and two controllers'}")
        print(f"terrains: {', '.join(TERRAINS)}; options: questsim envs --name NAME")
    elif args.name in ENVIRONMENTS:
        _describe(args.name)
    elif args.name in TERRAINS:
        _print_options(TERRAINS[args.name])
    else:
        known = ", ".join([*ENVIRONMENTS, *TERRAINS])
        raise InputError(f"there is no {args.name!r}", "--name", f"there are {known}")
    return 0


def _describe(name: str) -> None:
    options: dict[str, Any] = dict(ENVIRONMENTS[name])
    if "terrain" in options:
        options["terrain"] = terrain_named(options["terrain"])
    config = EnvConfig(**options)
    print(f"{name}: {observation_size(observation_layout(config))} numbers, 33 torques, 36 Hz")
    for field in fields(EnvConfig):
        value = getattr(config, field.name)
        if isinstance(value, Terrain):
            print(f"  {field.name} = {value.kind!r}, with")
            _print_options(value, "    ")
        else:
            print(f"  {field.name} = {value!r}")


def _print_options(terrain: Terrain, indent: str = "  ") -> None:
    for field in fields(terrain):
        value = getattr(terrain, field.name)
        if field.default is MISSING or field.name == "kind":
            continue
        least_most = RANGES.get(field.name)
        within = "" if least_most is None else f"  ({least_most[0]:g} to {least_most[1]:g})"
        print(f"{indent}{field.name} = {value!r}{within}")
