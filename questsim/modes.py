"""Commands with several modes: each mode has its own options and rejects those of the others."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import NamedTuple, get_args, get_type_hints

from questsim.errors import InputError
from questsim.lazy import imported
from questsim.parsing import parse
from questsim.short_help import ALL, ShortHelp


def one_of(names: Iterable[str]) -> str:
    """A choice for the help of an option: ``"a, b or c"``."""
    *others, last = names
    return f"{', '.join(others)} or {last}" if others else last


class Mode(NamedTuple):
    """One mode of a command.

    Attributes:
        name: the option that selects it, for messages, e.g. ``--compare``.
        args: the dataclass of its options.
        function: ``"package.module:name"`` of the function that runs the mode; the dataclass is its
            only argument. It is imported when the mode runs.
        help: what ``--help`` prints; by default the explanation of every option.
    """

    name: str
    args: type
    function: str
    help: ShortHelp | None = None

    def options(self) -> set[str]:
        """Its options as on the command line, e.g. ``--video`` and ``--no-video``."""
        return option_names(self.args)


class Modes(NamedTuple):
    """The modes of a command, and the function that selects one.

    Attributes:
        modes: all modes; the first is the default.
        choose: function from the words of a command line to the mode and the words of its options.
    """

    modes: tuple[Mode, ...]
    choose: Callable[[Sequence[str]], tuple[Mode, list[str]]]

    def chosen(self, words: Sequence[str]) -> tuple[Mode, list[str]]:
        """The mode of a command line, and the words of its options.

        Raises:
            InputError: an option of another mode, or two modes at once.
        """
        mode, rest = self.choose(words)
        own = mode.options()
        for word in rest:
            option = word.partition("=")[0].replace("_", "-")
            if not option.startswith("--") or option in own:
                continue
            homes = [other.name for other in self.modes if option in other.options()]
            if homes:
                fix = f"leave it out; it is an option of {', '.join(homes)}"
                raise InputError(f"does not go with {mode.name}", option, fix)
        return mode, rest

    def run(self, words: Sequence[str], prog: str | None = None) -> object:
        """Parse a command line and run its mode; returns the mode's result.

        Raises:
            InputError: see ``chosen``; also errors of the mode itself.
        """
        mode, rest = self.chosen(words)
        if mode.help is not None and {"-h", "--help"} & set(rest):
            print(mode.help.text(prog or f"python {Path(sys.argv[0]).name}"))
            return 0
        rest = ["--help" if word == ALL else word for word in rest]
        others = "; ".join(other.name for other in self.modes if other is not mode)
        text = f"{(mode.args.__doc__ or '').strip()} For other options: {others}, each with --help."
        args = parse(mode.args, rest, prog, text)
        return imported(mode.function, say=True)(args)


def option_names(args: type, prefix: str = "--") -> set[str]:
    """Options that tyro makes from a dataclass, nested ones as ``--outer.inner``."""
    names: set[str] = set()
    hints = get_type_hints(args)
    for field in fields(args):
        name = field.name.replace("_", "-")
        kinds = [hints[field.name], *get_args(hints[field.name])]
        inner = next((kind for kind in kinds if is_dataclass(kind)), None)
        if isinstance(inner, type):
            names |= option_names(inner, f"{prefix}{name}.")
        names.add(f"{prefix}{name}")
        if bool in kinds:
            head, _, last = f"{prefix}{name}".rpartition(".")
            names.add(f"{head}.no-{last}" if head else f"--no-{name}")
    return names
