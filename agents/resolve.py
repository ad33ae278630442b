"""What an agent's name means: the only place that knows names and how they are written.

A name is that of a shipped policy or kinematic system, of a kinematic system that needs no weights,
of a baseline, or ``package.module:Class`` of the user's own; a path is a checkpoint, stage or run
folder. A kinematic system followed by ``PHYSICS`` has physics behind it. Weights are loaded by
``agents.loading`` and ``agents.kinematic.store``.
"""

from __future__ import annotations

import importlib
import re
import sys
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from questsim.errors import InputError
from questsim.files import read_yaml

SHIPPED = Path(__file__).parent / "weights"
POLICY_CARD, SYSTEM_CARD = "policy.yaml", "system.yaml"
"""Says of a folder that it holds a torque policy, or a kinematic system."""

PHYSICS = "+physics"
"""After a kinematic system's name: that system with physics behind it."""
ZERO, RANDOM = BASELINES = ("zero", "random")
"""Agents to compare with."""
IK = "ik"
UNTRAINED = (IK,)
"""Kinematic systems that are complete without weights."""
DEFAULT_POLICY, DEFAULT_SYSTEM = "questsim", "hmdposer"
"""What commands use where none is named."""
ESTIMATE_TRACKER = "estimate-tracker"
"""The policy that follows a kinematic system's poses."""
SYNTHETIC_POLICY = "demo"
"""The shipped policy that has learnt the embedded motions alone."""

# Of the fine-tuning only what helped is a result, so its last state is none.
_POLICY_FOLDERS = (
    "", "best", "last", "finetune/best", "student/best", "student/last",
    "ppo/best", "ppo/last", "teacher/best", "teacher/last",
)  # fmt: skip
"""Where a checkpoint, a stage and a run keep their policy, best first."""

Kind = Literal["policy", "baseline", "own", "system", "physics"]


@dataclass(frozen=True)
class Resolved:
    """What a name means.

    Attributes:
        name: as it was given.
        kind: ``"policy"``, ``"baseline"`` or ``"own"`` for what answers an observation with
            torques; ``"system"`` for a kinematic system, the user's own included; ``"physics"``
            for a kinematic system with physics behind it.
        base: the name without ``PHYSICS``.
        folder: of the checkpoint; None without one.
        card: its description, unchecked; empty without one.
    """

    name: str
    kind: Kind
    base: str
    folder: Path | None = None
    card: dict[str, Any] = field(default_factory=dict)

    @property
    def torques(self) -> bool:
        """Whether it answers an observation with torques, as ``agents.agent.Agent`` does."""
        return self.kind in ("policy", "baseline", "own")

    @property
    def training(self) -> dict[str, Any]:
        """What its card says of its training."""
        training = self.card.get("training")
        return training if isinstance(training, dict) else {}


def resolve(path_or_name: str | Path) -> Resolved:
    """What a path or name means.

    Raises:
        InputError: it means nothing; the line lists what there is.
    """
    name = str(path_or_name)
    if not name:
        raise InputError("an empty name names no agent", fix=f"give a folder or {_known()}")
    base = base_of(name)
    if base is not None:
        system = resolve_system(base)
        return Resolved(name, "physics", base, system.folder, system.card)
    if name in BASELINES:
        return Resolved(name, "baseline", name)
    if name in UNTRAINED:
        return Resolved(name, "system", name)
    if _is_own(name):
        kind: Kind = "own" if hasattr(own_class(name), "act") else "system"
        return Resolved(name, kind, name)
    for place in (Path(name), SHIPPED / name):
        folder = system_folder(place)
        if folder is not None:
            return Resolved(name, "system", name, folder, _card(folder / SYSTEM_CARD))
        folder = policy_folder(place)
        if folder is not None:
            return Resolved(name, "policy", name, folder, _card(folder / POLICY_CARD))
    raise InputError("is no agent", name, f"name a run or checkpoint folder, or {_known()}")


def _is_own(name: str) -> bool:
    """Whether a name is written as a class of the user's own is."""
    return re.fullmatch(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*", name) is not None


def resolve_policy(path_or_name: str | Path) -> Resolved:
    """As ``resolve``, of a torque policy with a checkpoint.

    Raises:
        InputError: it means nothing, or something else.
    """
    found = resolve(path_or_name)
    if found.kind != "policy":
        fix = f"name a policy's folder or one of {', '.join(shipped_policies())}"
        raise InputError("is no torque policy", path_or_name, fix)
    return found


def resolve_system(path_or_name: str | Path) -> Resolved:
    """As ``resolve``, of a kinematic system without physics.

    Raises:
        InputError: it means nothing, or something else.
    """
    name, found = str(path_or_name), None
    with suppress(InputError) if not _is_own(name) else nullcontext():
        found = resolve(name)
    if found is None or found.kind != "system":
        fix = f"name a system's folder or one of {', '.join(shipped_systems())}"
        raise InputError("is no kinematic system", path_or_name, fix)
    return found


def base_of(name: str) -> str | None:
    """The kinematic system of a name that ends with ``PHYSICS``; None for other names."""
    return name.removesuffix(PHYSICS) if name.endswith(PHYSICS) else None


def from_anywhere(path: Path | None) -> Path | None:
    """A path so that a run's record means it in any folder; names stay names.

    A folder that merely has a shipped policy's name, as the package ``questsim`` has, is no path.
    """
    if path is None or not path.exists():
        return path
    try:
        found = resolve(path)
    except InputError:  # refused later, by what needs it
        return path.absolute()
    inside = found.folder is not None and found.folder.is_relative_to(path)
    return path.absolute() if inside else path


def policy_folder(place: Path) -> Path | None:
    """The folder of the best policy in a checkpoint, stage or run folder, if there is one."""
    folders = (place / part for part in _POLICY_FOLDERS)
    return next((folder for folder in folders if (folder / POLICY_CARD).exists()), None)


def system_folder(place: Path) -> Path | None:
    """The folder of the kinematic system in a checkpoint, stage or run folder, if there is one.

    Of a run that of the last stage that has one: the one that was trained in the most stages.
    """
    for folder in (place, place / "best", place / "last"):
        if (folder / SYSTEM_CARD).exists():
            return folder
    cards = [*place.glob(f"*/best/{SYSTEM_CARD}"), *place.glob(f"*/last/{SYSTEM_CARD}")]
    # Of equals ``max`` takes the first: the best before the last.
    return max((card.parent for card in cards), key=_stages, default=None)


def _stages(folder: Path) -> int:
    training = _card(folder / SYSTEM_CARD).get("training")
    return len(training.get("trained", ())) if isinstance(training, dict) else 0


def _card(path: Path) -> dict[str, Any]:
    """A description as it is; empty where it cannot be read, which what loads it refuses."""
    try:
        return read_yaml(path, "description")
    except (OSError, InputError):
        return {}


def shipped_policies() -> tuple[str, ...]:
    """Names of the shipped torque policies."""
    return _shipped_with(POLICY_CARD)


def shipped_systems() -> tuple[str, ...]:
    """Names of the kinematic systems that are shipped or need no weights."""
    return (*_shipped_with(SYSTEM_CARD), *UNTRAINED)


def with_physics(systems: tuple[str, ...] | list[str] | None = None) -> tuple[str, ...]:
    """Names of kinematic systems, by default all that there are, with physics behind them."""
    return tuple(f"{name}{PHYSICS}" for name in systems or shipped_systems())


def _shipped_with(card: str) -> tuple[str, ...]:
    return tuple(sorted(path.parent.name for path in SHIPPED.glob(f"*/{card}")))


def _known() -> str:
    names = ", ".join((*shipped_policies(), *shipped_systems(), *BASELINES))
    return f"{names}, package.module:Class, or a kinematic system and {PHYSICS}"


def own_class(name: str) -> type:
    """The user's class of a name ``package.module:Class``, looked for in the current folder too.

    Raises:
        InputError: there is no such module or class, or the class is neither an ``Agent`` nor a
            ``KinematicSystem``.
    """
    module_name, _, class_name = name.partition(":")
    if "" not in sys.path and str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module_name}.".startswith(f"{error.name}."):
            raise InputError(f"needs the module {error.name}, which is missing", name) from error
        raise InputError(f"there is no module {error.name}", name, "check PYTHONPATH") from error
    found = getattr(module, class_name, None)
    if not isinstance(found, type):
        own = [n for n, value in vars(module).items() if _is_agent(value, module_name)]
        fix = f"it has {', '.join(own)}" if own else "name a class of it"
        raise InputError(f"{module_name} has no class {class_name}", name, fix)
    if not _is_agent(found):
        raise InputError(
            "is neither an Agent nor a KinematicSystem", name,
            "give it needs, bind, reset and act (agents.agent.Agent)",
        )  # fmt: skip
    return found


def _is_agent(value: Any, module: str | None = None) -> bool:
    """Whether it is a class with the methods of an agent or a kinematic system, of a module."""
    if not isinstance(value, type) or module not in (None, value.__module__):
        return False
    methods = ("bind", "reset", "act"), ("usable", "reset", "step", "predict")
    return any(all(callable(getattr(value, name, None)) for name in each) for each in methods)


def own_object(name: str) -> Any:
    """An object of the user's class of a name; see ``own_class``.

    Raises:
        InputError: there is none, or it cannot be made without arguments.
    """
    found = own_class(name)
    try:
        return found()
    except TypeError as error:
        raise InputError(f"cannot be made without arguments ({error})", name) from error
