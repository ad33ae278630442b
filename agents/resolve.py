"""Resolve agent names and paths. No other module interprets agent names.

A name is one of: a shipped policy or kinematic system, a kinematic system without weights, a
baseline, or the user's own ``package.module:Class``. A path is a checkpoint, stage or run folder. A
name ``hf:USER/REPO`` is an agent on the Hugging Face Hub, see ``agents.hub``. A
kinematic system's name followed by ``PHYSICS`` adds the tracker on simulated physics. Weights are
loaded by ``agents.loading`` and ``agents.kinematic.store``.
"""

from __future__ import annotations

import importlib
import re
import sys
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from typing_extensions import Doc

from agents.hub import PREFIX, downloaded
from questsim.errors import InputError, did_you_mean
from questsim.files import read_yaml

SHIPPED = Path(__file__).parent / "weights"
POLICY_CARD, SYSTEM_CARD = "policy.yaml", "system.yaml"
"""Files that mark a folder as a torque policy or a kinematic system."""

PHYSICS = "+physics"
"""Suffix of a kinematic system's name: a tracker follows its poses on simulated physics."""
ZERO, RANDOM = BASELINES = ("zero", "random")
"""Baseline agents."""
IK = "ik"
UNTRAINED = (IK,)
"""Kinematic systems without weights."""
DEFAULT_POLICY, DEFAULT_SYSTEM = "questsim", "hmdposer"
"""Default agent of the commands."""
LIVE_POLICY = "questsim"
"""Default agent on a live headset: the best of validation clips with errors of the devices."""
ESTIMATE_TRACKER = "estimate-tracker"
"""The policy that follows the poses of a kinematic system."""
SYNTHETIC_POLICY = "demo"
"""The shipped policy that was trained only on the embedded motions."""

# Only an improved policy is a result of fine-tuning, so its last checkpoint does not count.
_POLICY_FOLDERS = (
    "", "best", "last", "finetune/best", "student/best", "student/last",
    "ppo/best", "ppo/last", "teacher/best", "teacher/last",
)  # fmt: skip
"""Policy folders inside a checkpoint, stage or run folder, best first."""

_FOLDER = "a run, stage or checkpoint folder"
_OWN = "your own package.module:Class"
_HUB = "hf:USER/REPO of the Hugging Face Hub"
ANY_AGENT = (
    f"{_FOLDER}; the name of a shipped policy or kinematic system (see questsim agents); "
    f"{ZERO} or {RANDOM}; {_OWN}; {_HUB}; or a kinematic system followed by {PHYSICS}, "
    f"e.g. {DEFAULT_SYSTEM}{PHYSICS}"
)
"""What ``resolve`` accepts, for help texts."""
AgentName = Annotated[str, Doc(f"Agent: {ANY_AGENT}.")]
"""Option of a command that takes every agent, with its help text."""
TorqueAgentName = Annotated[
    str,
    Doc(f"Agent: {_FOLDER}; the name of a shipped policy; {ZERO} or {RANDOM}; {_HUB}; or {_OWN}."),
]
"""Option of a command that takes agents that output torques, with its help text."""

Kind = Literal["policy", "baseline", "own", "system", "physics"]


@dataclass(frozen=True)
class Resolved:
    """A resolved agent name.

    Attributes:
        name: the name as given.
        kind: ``"policy"``, ``"baseline"`` or ``"own"`` for agents that output torques;
            ``"system"`` for a kinematic system, including the user's own; ``"physics"`` for a
            kinematic system with ``PHYSICS``.
        base: the name without ``PHYSICS``.
        folder: the checkpoint's folder; None without a checkpoint.
        card: the checkpoint's description, unchecked; empty without a checkpoint.
    """

    name: str
    kind: Kind
    base: str
    folder: Path | None = None
    card: dict[str, Any] = field(default_factory=dict)

    @property
    def torques(self) -> bool:
        """Whether it maps observations to torques, as ``agents.agent.Agent`` does."""
        return self.kind in ("policy", "baseline", "own")

    @property
    def simulated(self) -> bool:
        """Whether its avatar moves by physics; a kinematic system alone outputs poses."""
        return self.kind != "system"

    @property
    def training(self) -> dict[str, Any]:
        """The training record in its card."""
        training = self.card.get("training")
        return training if isinstance(training, dict) else {}


def resolve(path_or_name: str | Path | Resolved) -> Resolved:
    """Resolve a path or name; a resolved one is returned as it is.

    Raises:
        InputError: no such agent; the message lists the known ones.
    """
    if isinstance(path_or_name, Resolved):
        return path_or_name
    name = str(path_or_name)
    if not name:
        raise InputError("the agent's name is empty", fix=f"give a folder or {_known()}")
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
    on_hub = name.startswith(PREFIX)
    for place in (downloaded(name),) if on_hub else (Path(name), SHIPPED / name):
        folder = system_folder(place)
        if folder is not None:
            return Resolved(name, "system", name, folder, _card(folder / SYSTEM_CARD))
        folder = policy_folder(place)
        if folder is not None:
            return Resolved(name, "policy", name, folder, _card(folder / POLICY_CARD))
    if on_hub:
        raise InputError("holds no agent of questsim", name)
    near = did_you_mean(name, _names())
    fix = f"{near}name a run or checkpoint folder, or {_known()}"
    raise InputError("is not an agent", name, fix)


def _is_own(name: str) -> bool:
    """Whether a name has the form of a user's class, ``package.module:Class``."""
    form = re.fullmatch(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*", name)
    return form is not None and not name.startswith(PREFIX)


def resolve_policy(path_or_name: str | Path | Resolved) -> Resolved:
    """Like ``resolve``, but only torque policies with a checkpoint.

    Raises:
        InputError: no such agent, or it is of another kind.
    """
    found = resolve(path_or_name)
    if found.kind != "policy":
        near = did_you_mean(found.name, shipped_policies())
        fix = f"{near}name a policy's folder or one of {', '.join(shipped_policies())}"
        raise InputError("is not a torque policy", found.name, fix)
    return found


def resolve_system(path_or_name: str | Path | Resolved) -> Resolved:
    """Like ``resolve``, but only kinematic systems without physics.

    Raises:
        InputError: no such agent, or it is of another kind.
    """
    if isinstance(path_or_name, Resolved) and path_or_name.kind == "system":
        return path_or_name
    name = path_or_name.name if isinstance(path_or_name, Resolved) else str(path_or_name)
    found = None
    with suppress(InputError) if not (_is_own(name) or name.startswith(PREFIX)) else nullcontext():
        found = resolve(name)
    if found is None or found.kind != "system":
        near = did_you_mean(name, shipped_systems())
        fix = f"{near}name a system's folder or one of {', '.join(shipped_systems())}"
        raise InputError("is not a kinematic system", name, fix)
    return found


def base_of(name: str) -> str | None:
    """The kinematic system in a name that ends with ``PHYSICS``; None for other names."""
    return name.removesuffix(PHYSICS) if name.endswith(PHYSICS) else None


def from_anywhere(path: Path | None) -> Path | None:
    """Make a path absolute, so that a run's record is valid in any folder; keep names unchanged.

    A folder that has a shipped policy's name, such as the package ``questsim``, is not a path.
    """
    if path is None or not path.exists():
        return path
    try:
        found = resolve(path)
    except InputError:  # the caller that needs it refuses it later
        return path.absolute()
    inside = found.folder is not None and found.folder.is_relative_to(path)
    return path.absolute() if inside else path


def policy_folder(place: Path) -> Path | None:
    """The folder of the best policy in a checkpoint, stage or run folder, if there is one."""
    folders = (place / part for part in _POLICY_FOLDERS)
    return next((folder for folder in folders if (folder / POLICY_CARD).exists()), None)


def system_folder(place: Path) -> Path | None:
    """The folder of the kinematic system in a checkpoint, stage or run folder, if there is one.

    For a run, it is the last stage's: the system that went through the most stages.
    """
    for folder in (place, place / "best", place / "last"):
        if (folder / SYSTEM_CARD).exists():
            return folder
    cards = [*place.glob(f"*/best/{SYSTEM_CARD}"), *place.glob(f"*/last/{SYSTEM_CARD}")]
    # Of equal items ``max`` returns the first: ``best`` before ``last``.
    return max((card.parent for card in cards), key=_stages, default=None)


def _stages(folder: Path) -> int:
    training = _card(folder / SYSTEM_CARD).get("training")
    return len(training.get("trained", ())) if isinstance(training, dict) else 0


def _card(path: Path) -> dict[str, Any]:
    """An unchecked card; empty if it cannot be read (loading it then raises an error)."""
    try:
        return read_yaml(path, "description")
    except (OSError, InputError):
        return {}


def shipped_policies() -> tuple[str, ...]:
    """Names of the shipped torque policies."""
    return _shipped_with(POLICY_CARD)


def shipped_systems() -> tuple[str, ...]:
    """Names of the kinematic systems that are shipped or have no weights."""
    return (*_shipped_with(SYSTEM_CARD), *UNTRAINED)


def with_physics(systems: tuple[str, ...] | list[str] | None = None) -> tuple[str, ...]:
    """Names of kinematic systems (by default all) with ``PHYSICS`` appended."""
    return tuple(f"{name}{PHYSICS}" for name in systems or shipped_systems())


def _shipped_with(card: str) -> tuple[str, ...]:
    return tuple(sorted(path.parent.name for path in SHIPPED.glob(f"*/{card}")))


def _names() -> tuple[str, ...]:
    return (*shipped_policies(), *shipped_systems(), *BASELINES)


def _known() -> str:
    return f"{', '.join(_names())}, package.module:Class, or a kinematic system and {PHYSICS}"


def own_class(name: str) -> type:
    """The user's class ``package.module:Class``; the current folder is searched as well.

    Raises:
        InputError: no such module or class, or the class is neither an ``Agent`` nor a
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
    """Whether it is a class of the module with the methods of an agent or kinematic system."""
    if not isinstance(value, type) or module not in (None, value.__module__):
        return False
    methods = ("bind", "reset", "act"), ("usable", "reset", "step", "predict")
    return any(all(callable(getattr(value, name, None)) for name in each) for each in methods)


def own_object(name: str) -> Any:
    """An instance of the user's class; see ``own_class``.

    Raises:
        InputError: no such class, or its constructor needs arguments.
    """
    found = own_class(name)
    try:
        return found()
    except TypeError as error:
        raise InputError(f"cannot be made without arguments ({error})", name) from error
