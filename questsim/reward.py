"""The reward: a table of terms, each a pure function of one step of a batch.

r = w . [r(q), r(qdot), r(x), r(xdot), r_f] with r(s) = exp(-k_s * error), QuestSim section 3.
The published error is a sum of squares. But k = 40 only makes sense for a mean: 0.1 rad per joint,
summed over 33 joints, would already give exp(-13). So errors here are means over joints or links.

To add a term, write a function ``(moment, k) -> (n,)`` and add a line to ``TERMS``, or call
``register_term`` from another package, as ``docs/examples/new_reward.py`` does. Its weight is then
an option: ``RewardConfig(NAME=0.1)``, ``train.py --set stages.teacher.reward.NAME=0.1``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import Field, field, fields, make_dataclass, replace
from numbers import Real
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from questsim.errors import InputError, value_text
from questsim.extensions import load_extensions, same_source
from questsim.skeleton import NUM_DOFS, NUM_LINKS


class Moment(NamedTuple):
    """Data of a step of ``n`` simulations for the reward terms; all in the world.

    Attributes:
        joint_angles, joint_velocities: ``(n, 33)`` rad, rad/s.
        link_positions, link_velocities: ``(n, 16, 3)`` m, m/s.
        link_quats: ``(n, 16, 4)`` wxyz.
        foot_force: ``(n, 2)`` vertical force of the floor on each foot, N.
        previous_foot_force: ``(n, 2)`` the same one step earlier.
        torque: ``(n, 33)`` N m of the joints' motors during the step.
        torque_limits: ``(n, 33)`` N m.
        reference: state of the reference.
    """

    joint_angles: np.ndarray
    joint_velocities: np.ndarray
    link_positions: np.ndarray
    link_velocities: np.ndarray
    link_quats: np.ndarray
    foot_force: np.ndarray
    previous_foot_force: np.ndarray
    torque: np.ndarray
    torque_limits: np.ndarray
    reference: ReferenceState


class ReferenceState(NamedTuple):
    """State of the reference in a ``Moment``; fields as there."""

    joint_angles: np.ndarray
    joint_velocities: np.ndarray
    link_positions: np.ndarray
    link_velocities: np.ndarray
    link_quats: np.ndarray


Function = Callable[[Moment, float], np.ndarray]


class Term(NamedTuple):
    """A line of the table.

    Attributes:
        function: function of a ``Moment`` and ``k`` that returns ``(n,)``, before weighting.
        weight: default weight.
        k: default k: kernel sharpness, or another parameter of the function.
    """

    function: Function
    weight: float
    k: float


def tracking(simulated: np.ndarray, reference: np.ndarray, k: float) -> np.ndarray:
    """exp(-k * mean square difference) ``(n,)`` of joint values ``(n, 33)``.

    For r(q) in rad and r(qdot) in rad/s; QuestSim section 3.
    """
    return np.exp(-k * np.mean((simulated - reference) ** 2, axis=-1))


def link_tracking(simulated: np.ndarray, reference: np.ndarray, k: float) -> np.ndarray:
    """exp(-k * mean over links of the squared distance) ``(n,)`` of vectors ``(n, 16, 3)``.

    For r(x) in m and r(xdot) in m/s; QuestSim section 3.
    """
    squared = np.sum((simulated - reference) ** 2, axis=-1)
    return np.exp(-k * np.mean(squared, axis=-1))


def turn_tracking(simulated: np.ndarray, reference: np.ndarray, k: float) -> np.ndarray:
    """exp(-k * mean over links of the squared angle) ``(n,)`` of quaternions ``(n, 16, 4)``.

    The angle in rad is that of the one rotation between the two, as in DeepMimic's pose reward
    (Peng et al. 2018, eq. 6), here in the world.
    """
    dot = np.abs(np.sum(simulated * reference, axis=-1))
    angle = 2.0 * np.arccos(np.minimum(dot, 1.0))
    return np.exp(-k * np.mean(angle**2, axis=-1))


def unloading(previous: np.ndarray, force: np.ndarray, k: float) -> np.ndarray:
    """exp(-k * sum over feet of max(0, f_prev - f)) ``(n,)`` of vertical forces ``(n, 2)`` in N.

    Penalises feet that leave the floor abruptly; QuestSim section 3.
    """
    return np.exp(-k * np.sum(np.maximum(0.0, previous - force), axis=-1))


TERMS: dict[str, Term] = {
    "joint_angles": Term(
        lambda m, k: tracking(m.joint_angles, m.reference.joint_angles, k), 0.4, 40.0
    ),
    "joint_velocities": Term(
        lambda m, k: tracking(m.joint_velocities, m.reference.joint_velocities, k), 0.1, 0.03
    ),
    "link_positions": Term(
        lambda m, k: link_tracking(m.link_positions, m.reference.link_positions, k), 0.2, 6.0
    ),
    "link_velocities": Term(
        lambda m, k: link_tracking(m.link_velocities, m.reference.link_velocities, k), 0.1, 0.5
    ),
    "contact": Term(lambda m, k: unloading(m.previous_foot_force, m.foot_force, k), 0.2, 0.01),
    "link_orientations": Term(
        lambda m, k: turn_tracking(m.link_quats, m.reference.link_quats, k), 0.0, 10.0
    ),
}
"""Every term by name, with its default weight and k.

The weights and the k of angles, positions and contact are QuestSim's. Its velocity kernels, 0.3
and 2, only reward good tracking: a joint velocity error of 3 rad/s already gives exp(-2.7). The
defaults are softer, so that an untrained policy is rewarded for progress too. Link orientations are
not a term of QuestSim; their default weight is zero. They penalise a teacher's turn or lean before
the position errors become large.
"""

COMPILED: tuple[str, ...] = tuple(TERMS)
"""Terms that ``envs.score_kernel.score`` computes as well, much faster; tests compare the two."""


_KERNELS = frozenset(f"k_{name}" for name in COMPILED)


def register_term(name: str, function: Function, weight: float = 0.0, k: float = 1.0) -> Function:
    """Add a term to the table, e.g. from a module that ``QUESTSIM_EXTENSIONS`` names.

    Args:
        name: a Python identifier; with a weight it is in ``info`` and TensorBoard by this name.
        function: ``(moment, k) -> (n,)``, pure and finite wherever the physics is.
        weight, k: defaults.

    Raises:
        InputError: the name is taken or is no identifier.
    """
    if name in COMPILED or (name in TERMS and not same_source(TERMS[name].function, function)):
        raise InputError(f"there is a reward term {name!r} already", "register_term", "rename it")
    if not name.isidentifier() or name.startswith(("k_", "_")):
        raise InputError(f"{name!r} is not a valid name of a reward term", "register_term")
    TERMS[name] = Term(function, float(weight), float(k))
    RewardConfig.__dataclass_fields__ = _options()
    return function


def _options() -> dict[str, Field[Any]]:
    """Fields of ``RewardConfig``: the weight of every term, then the k of every term."""
    defaults = {name: term.weight for name, term in TERMS.items()}
    defaults |= {f"k_{name}": term.k for name, term in TERMS.items()}
    made = make_dataclass("Options", [(n, float, field(default=d)) for n, d in defaults.items()])
    return made.__dataclass_fields__


class RewardConfig:
    """Weights and k of the terms: ``RewardConfig(contact=0.0, k_link_positions=60.0)``.

    A frozen dataclass whose fields are those of the table: each term's name for its weight, and
    ``k_`` before the name for its k. Omitted fields have the table's defaults.

    Raises:
        InputError: an unknown term, a value that is not a finite number, or a negative k of a
            kernel: its reward would grow with the error.
    """

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]] = _options()

    def __init__(self, **options: float) -> None:
        if not options.keys() <= self.__dataclass_fields__.keys():
            load_extensions()
        for name in options:
            if name not in self.__dataclass_fields__:
                known = ", ".join(TERMS)
                raise InputError(f"there is no reward term {name!r}", "reward", f"known: {known}")
        for name, value in options.items():
            if not (isinstance(value, Real) and np.isfinite(float(value))) or value is True:
                raise InputError(f"is {value_text(value)}, not a number", f"reward {name}")
            if value < 0.0 and name in _KERNELS:
                raise InputError(f"is {value:g}, not a number from 0 on", f"reward {name}")
        self.__dict__.update(options)

    def __setstate__(self, state: dict[str, float]) -> None:
        # In another process the extension with a term may not be loaded yet.
        RewardConfig.__init__(self, **state)

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> float: ...

    else:

        def __getattr__(self, name: str) -> float:
            option = type(self).__dataclass_fields__.get(name)
            if option is None:
                raise AttributeError(name)
            return option.default

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{name} of a RewardConfig cannot change; use dataclasses.replace")

    def _values(self) -> tuple[tuple[str, float], ...]:
        return tuple((option.name, getattr(self, option.name)) for option in fields(self))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RewardConfig) and self._values() == other._values()

    def __hash__(self) -> int:
        return hash(self._values())

    def __repr__(self) -> str:
        return f"RewardConfig({', '.join(f'{name}={value!r}' for name, value in self._values())})"

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the computed terms: the compiled ones, and others with a nonzero weight."""
        return (*COMPILED, *(n for n in TERMS if n not in COMPILED and getattr(self, n) != 0.0))

    @property
    def weights(self) -> np.ndarray:
        """Of ``terms``, in their order."""
        return np.array([getattr(self, term) for term in self.terms])

    @property
    def kernels(self) -> np.ndarray:
        """The k of ``terms``, in their order."""
        return np.array([getattr(self, f"k_{term}") for term in self.terms])


PAPER_REWARD = RewardConfig(k_joint_velocities=0.3, k_link_velocities=2.0)
"""The published kernels, on means over joints and links."""


def summed(config: RewardConfig) -> RewardConfig:
    """The same reward with errors summed over joints or links, as published, instead of means.

    A sum is the mean times the number of joints (33) or links (16), so only the k change.
    """
    counts = {"joint_angles": NUM_DOFS, "joint_velocities": NUM_DOFS}
    counts |= dict.fromkeys(("link_positions", "link_velocities", "link_orientations"), NUM_LINKS)
    return replace(
        config, **{f"k_{n}": getattr(config, f"k_{n}") * count for n, count in counts.items()}
    )


def extra_terms(config: RewardConfig, moment: Moment) -> np.ndarray:
    """Terms ``(n, e)`` that are not compiled, in the order of ``config.terms``.

    Raises:
        ValueError: a function's result has the wrong shape.
    """
    n, columns = len(moment.torque), []
    for name in config.terms[len(COMPILED) :]:
        values = np.asarray(TERMS[name].function(moment, getattr(config, f"k_{name}")), float)
        if values.shape != (n,):
            raise ValueError(f"reward term {name!r} gives {values.shape}, not ({n},)")
        columns.append(values)
    return np.stack(columns, axis=-1) if columns else np.zeros((n, 0))
