"""The file of a body: ``NAME.toml`` with an MJCF and the roles of its links."""

from __future__ import annotations

import difflib
import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from questsim.assets import mjcf_path
from questsim.errors import InputError
from questsim.files import read_toml
from questsim.skeleton import LINKS

TOES: tuple[str, str] = ("left_toes", "right_toes")
ROLES: tuple[str, ...] = (*LINKS, *TOES)
"""Links of our avatar that a body may have, and toes, which only other bodies have."""
OPTIONAL: tuple[str, ...] = ("spine", "chest", *TOES)
OURS = "questsim"
SHIPPED = Path(__file__).parent / "shipped"
_PACKAGE = "package:"
_FIELDS = ("name", "mjcf", "height_m", "substeps", "links", "torque_limits", "masses", "rest")
MAX_SUBSTEPS = 50


class Place(NamedTuple):
    """Where a role is on the body.

    Attributes:
        body: name of a body of the MJCF.
        at: ``(3,)`` the role's origin in that body's frame in metres.
    """

    body: str
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Description:
    """A checked description.

    Attributes:
        path: the file.
        name: of the body.
        mjcf: path of the MJCF.
        links: place of each role.
        torque_limits: N m by hinge, where they differ from the MJCF's.
        masses: kg by body, where they differ from the MJCF's.
        rest: angles in degrees by hinge of the pose in which the body stands upright with its arms
            hanging; empty to compute it.
        height_m: stature in metres; None to measure it.
        substeps: physics steps in each 1/36 s step of the policy.
    """

    path: Path
    name: str
    mjcf: Path
    links: Mapping[str, Place]
    torque_limits: Mapping[str, float] = field(default_factory=dict)
    masses: Mapping[str, float] = field(default_factory=dict)
    rest: Mapping[str, float] = field(default_factory=dict)
    height_m: float | None = None
    substeps: int = 4


def read_description(file: str | Path) -> Description:
    """Read ``NAME.toml``, or a shipped description by its name.

    Raises:
        InputError: the file, with its field, that cannot be used.
    """
    path = Path(file)
    if not path.suffix and not path.exists() and (SHIPPED / f"{path}.toml").exists():
        path = SHIPPED / f"{path}.toml"
    shipped = ", ".join(sorted(p.stem for p in SHIPPED.glob("*.toml")))
    fix = f"name a TOML file of a body (docs/body.md), or {shipped}"
    table = read_toml(path, "description of a body", fix)
    for key in table:
        if key not in _FIELDS:
            raise InputError(_unknown(key, _FIELDS), path, f"it may have {', '.join(_FIELDS)}")
    mjcf = _mjcf(path, table.get("mjcf"))
    return Description(
        path=path.resolve(),
        name=_text(path, "name", table.get("name", path.stem)),
        mjcf=mjcf,
        links=_links(path, table),
        torque_limits=_numbers(path, table, "torque_limits", above=0.0),
        masses=_numbers(path, table, "masses", above=0.0),
        rest=_numbers(path, table, "rest"),
        height_m=_height(path, table.get("height_m")),
        substeps=_substeps(path, table.get("substeps", 4)),
    )


def _unknown(name: str, known: tuple[str, ...]) -> str:
    near = difflib.get_close_matches(name, known, 1)
    return f"there is no field {name!r}" + (f" (did you mean {near[0]}?)" if near else "")


def _text(path: Path, key: str, value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise InputError(f"{key} is {value!r}, not a text", path)
    return value


def _number(path: Path, key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(f"{key} is {value!r}, not a number", path)
    return float(value)


def _mjcf(path: Path, value: Any) -> Path:
    """The MJCF: a path beside the description, ``package:NAME/PATH``, or ``questsim``."""
    text = _text(path, "mjcf", value if value is not None else "")
    if text == OURS:
        return mjcf_path("humanoid.xml")
    found = path.parent / text
    if text.startswith(_PACKAGE):
        package, _, rest = text[len(_PACKAGE) :].partition("/")
        spec = importlib.util.find_spec(package) if package.isidentifier() else None
        if spec is None or spec.origin is None:
            raise InputError(f"there is no package {package!r}", path, f"pip install {package}")
        found = Path(spec.origin).parent / rest
    if not found.is_file():
        raise InputError(f"there is no file of mjcf {text!r}", path, f"looked for {found}")
    return found


def _links(path: Path, table: dict[str, Any]) -> dict[str, Place]:
    given = table.get("links", {})
    if not isinstance(given, dict):
        raise InputError("links is not a table of roles", path, "write [links]")
    for role in given:
        if role not in ROLES:
            raise InputError(_unknown(role, ROLES), f"{path}, links", f"roles: {', '.join(ROLES)}")
    # Our own names need no map.
    own = {role: Place(role) for role in LINKS} if table.get("mjcf") == OURS else {}
    links = own | {role: _place(path, role, value) for role, value in given.items()}
    missing = [role for role in LINKS if role not in links and role not in OPTIONAL]
    if missing:
        fix = f"name the body that is the {missing[0]}, or {{ body = ..., at = [x, y, z] }} on one"
        raise InputError(f"lacks {', '.join(missing)}", f"{path}, links", fix)
    return links


def _place(path: Path, role: str, value: Any) -> Place:
    where = f"links.{role}"
    if isinstance(value, str):
        return Place(_text(path, where, value))
    if not isinstance(value, dict) or not {"body"} <= set(value) <= {"body", "at"}:
        fix = 'write "BODY" or { body = "BODY", at = [x, y, z] }'
        raise InputError(f"{where} is {value!r}", path, fix)
    at = value.get("at", [0.0, 0.0, 0.0])
    if not isinstance(at, list) or len(at) != 3:
        raise InputError(f"{where}.at is {at!r}, not three numbers", path)
    x, y, z = (_number(path, f"{where}.at", part) for part in at)
    return Place(_text(path, where, value["body"]), (x, y, z))


def _numbers(
    path: Path, table: dict[str, Any], key: str, above: float | None = None
) -> dict[str, float]:
    given = table.get(key, {})
    if not isinstance(given, dict):
        raise InputError(f"{key} is not a table of numbers", path, f"write [{key}]")
    numbers = {name: _number(path, f"{key}.{name}", value) for name, value in given.items()}
    for name, value in numbers.items():
        if above is not None and not value > above:
            raise InputError(f"{key}.{name} is {value:g}, not above {above:g}", path)
    return numbers


def _height(path: Path, value: Any) -> float | None:
    if value is None:
        return None
    height = _number(path, "height_m", value)
    if not 0.2 <= height <= 5.0:
        raise InputError(f"height_m is {height:g}, not within 0.2-5", path, "give it in metres")
    return height


def _substeps(path: Path, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= MAX_SUBSTEPS:
        raise InputError(f"substeps is {value!r}, not 1 to {MAX_SUBSTEPS}", path)
    return value
