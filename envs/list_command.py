"""The command ``questsim envs``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from typing import Any

from envs.config import EnvConfig
from envs.layout import observation_layout, observation_size
from envs.registration import ENVIRONMENTS
from envs.terrain import RANGES, TERRAINS, Terrain, terrain_named
from questsim.errors import InputError

_GROUNDS = {
    "flat": "level ground",
    "rough": "bumps and hollows of up to 4 cm, a new height every 25 cm",
    "waves": "hills and hollows of up to 10 cm, 2 m long",
    "slope": "a slope of 8 degrees, walked in any direction",
    "stairs": "flights of five steps of 8 cm, up and down",
    "steps": "blocks of 80 cm, a step of 6 cm up or down or level",
    "gaps": "ditches of 20 cm, 80 cm apart",
    "course": "tiles of all these grounds, each row harder than the one before",
    "mixed": "for training: level floor, rough ground and slopes, changing by episode",
}
"""The terrains in words, as they are by default."""


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
            print(f"{name:{width}}  {_about(options)}")
        print(f"\nIn Python: gymnasium.make({next(iter(ENVIRONMENTS))!r}), after import envs.")
        print("All options of one: questsim envs --name QuestSimRough-v0")
        print(f"--terrain and --env also take a ground by name: {', '.join(TERRAINS)}")
    elif args.name in ENVIRONMENTS:
        _describe(args.name)
    elif args.name in TERRAINS:
        _print_options(TERRAINS[args.name])
    else:
        known = ", ".join([*ENVIRONMENTS, *TERRAINS])
        raise InputError(f"there is no {args.name!r}", "--name", f"choose from {known}")
    return 0


def _about(options: Mapping[str, Any]) -> str:
    """An environment in words."""
    terrain = str(options.get("terrain", "flat"))
    ground = _GROUNDS.get(terrain, f"the ground {terrain!r}")
    alone = "; the headset alone, without controllers" if options.get("sensors") == "H" else ""
    others = {k: v for k, v in options.items() if k != "terrain" and (k, v) != ("sensors", "H")}
    return ground + alone + "".join(f"; {key} = {value!r}" for key, value in others.items())


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
