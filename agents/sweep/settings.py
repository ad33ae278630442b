"""The settings that a sweep trains: a grid of values, or proposals of Optuna."""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from agents.overrides import refuse_repeated, value_at, with_overrides
from agents.sweep.options import SweepArgs
from agents.training.presets import PRESETS
from questsim.errors import InputError

TRIALS = 10
"""Default number of settings of a search."""
RANDOM = 5
"""Random settings before Optuna's sampler learns from the results."""
BATCH = 4
"""Proposals that a search makes at once. It does not depend on the number of workers, so that the
same seed gives the same proposals on every machine."""


@dataclass(frozen=True)
class Setting:
    """Values of the preset that all runs of one setting share.

    Attributes:
        number: position in the sweep.
        values: value by path, as on the command line.
    """

    number: int
    values: dict[str, str]

    @property
    def label(self) -> str:
        """For tables: ``desired_kl=0.06``, or ``preset`` for the unchanged preset."""
        pairs = (f"{path.rpartition('.')[2]}={v}" for path, v in self.values.items())
        return " ".join(pairs) or "preset"

    @property
    def folder(self) -> str:
        """Start of the names of its run folders; the same values always have the same."""
        digest = hashlib.sha256(repr(sorted(self.values.items())).encode()).hexdigest()
        return f"{self.label.replace(' ', ',')[:80]}-{digest[:6]}" if self.values else "preset"

    @property
    def overrides(self) -> tuple[str, ...]:
        """The values as ``--set`` takes them."""
        return tuple(f"{path}={value}" for path, value in self.values.items())


class SettingSource(Protocol):
    """A source of settings, in batches; the results of a batch may decide about the next."""

    def batches(self) -> Iterator[list[Setting]]:
        """The settings; ``tell`` must be called for every setting before the next batch."""
        ...

    def tell(self, setting: Setting, score: float) -> None:
        """Report the mean score of a setting over its seeds."""
        ...


def settings_of(args: SweepArgs) -> SettingSource:
    """The settings that the options describe.

    Raises:
        InputError: a value or range does not fit the preset, or Optuna is not installed.
    """
    if args.values and args.search:
        raise InputError("does not go with --search", "--values", "give one of them")
    if args.trials is not None and not args.search:
        raise InputError("does nothing without --search", "--trials", "add --search path=LOW:HIGH")
    if args.search:
        return Search(args)
    return Grid(args)


class Grid:
    """All combinations of the listed values; without values, the preset alone."""

    def __init__(self, args: SweepArgs) -> None:
        listed: dict[str, list[str]] = {}
        for text in args.values:
            path, values = _assigned(text, "--values", "path=VALUE,VALUE")
            if path in listed:
                raise InputError(f"{path} is given twice", "--values", "list all its values once")
            listed[path] = values.split(",")
            if len(set(listed[path])) < len(listed[path]):
                raise InputError(f"a value of {path} is given twice", "--values", "leave one out")
        combinations = itertools.product(*listed.values())
        self._all = [
            Setting(number, dict(zip(listed, values, strict=True)))
            for number, values in enumerate(combinations)
        ]
        for setting in self._all:
            _check(args, setting)

    def batches(self) -> Iterator[list[Setting]]:
        """All settings at once."""
        yield self._all

    def tell(self, setting: Setting, score: float) -> None:
        """Does nothing: a grid does not depend on its results."""


class Search:
    """Settings proposed by Optuna's TPE sampler, seeded with ``--seed``.

    Nothing of the study is saved: the same seed and results give the same proposals, so that a
    resumed sweep repeats them and finds their finished runs.
    """

    def __init__(self, args: SweepArgs) -> None:
        try:
            import optuna
        except ModuleNotFoundError:
            fix = "pip install 'questsim[sweep]'"
            raise InputError("needs Optuna, which is not installed", "--search", fix) from None
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self._ranges = dict(_range(text) for text in args.search)
        if len(self._ranges) < len(args.search):
            raise InputError("a path is given twice", "--search", "leave one out")
        refuse_repeated((*args.set, *self._ranges))
        preset = PRESETS[args.preset]
        for path, (low, high, _) in self._ranges.items():
            for end in (low, high):
                with_overrides(preset, (*args.set, f"{path}={end!r}"))
        self._distributions: dict[str, Any] = {
            path: optuna.distributions.IntDistribution(int(low), int(high), log=log)
            if isinstance(value_at(preset, path), int)
            else optuna.distributions.FloatDistribution(low, high, log=log)
            for path, (low, high, log) in self._ranges.items()
        }
        self._count = TRIALS if args.trials is None else args.trials
        sampler = optuna.samplers.TPESampler(seed=args.seed, n_startup_trials=RANDOM)
        self._study = optuna.create_study(direction="maximize", sampler=sampler)
        self._asked: dict[int, Any] = {}
        self._told: dict[int, float] = {}

    def batches(self) -> Iterator[list[Setting]]:
        """Batches of proposals."""
        for first in range(0, self._count, BATCH):
            yield [self._propose(n) for n in range(first, min(first + BATCH, self._count))]

    def _propose(self, number: int) -> Setting:
        # Told in the order of the settings, since the order of the results varies.
        for done in sorted(self._told):
            self._study.tell(self._asked[done], self._told[done])
        self._told = {}
        trial = self._asked[number] = self._study.ask(self._distributions)
        values = {path: _short(trial.params[path]) for path in self._ranges}
        return Setting(number, values)

    def tell(self, setting: Setting, score: float) -> None:
        """Report the mean score of a setting over its seeds."""
        self._told[setting.number] = score


def _short(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.6g}"


def _check(args: SweepArgs, setting: Setting) -> None:
    """Refuse values that do not fit the preset, before anything is trained."""
    refuse_repeated((*args.set, *setting.overrides))
    with_overrides(PRESETS[args.preset], (*args.set, *setting.overrides))


def _assigned(text: str, where: str, form: str) -> tuple[str, str]:
    path, equals, rest = text.partition("=")
    if not (path and equals and rest):
        raise InputError(f"{text!r} is not {form}", where)
    return path, rest


def _range(text: str) -> tuple[str, tuple[float, float, bool]]:
    """Path, lowest and highest value, and whether the scale is logarithmic."""
    form = "path=LOW:HIGH or path=LOW:HIGH:log"
    path, rest = _assigned(text, "--search", form)
    parts = rest.split(":")
    log = len(parts) == 3 and parts[2] == "log"
    try:
        low, high = (_number(part) for part in parts[: len(parts) - log])
    except ValueError:
        raise InputError(f"{text!r} is not {form}", "--search") from None
    if not low < high:
        raise InputError(f"{path} goes from {low:g} to {high:g}", "--search", "LOW below HIGH")
    if log and low <= 0:
        raise InputError(f"{path} begins at {low:g}", "--search", "log needs LOW above 0")
    return path, (low, high, log)


def _number(text: str) -> float:
    try:
        return int(text)
    except ValueError:
        value = float(text)
    if not math.isfinite(value):
        raise ValueError(text)
    return value
