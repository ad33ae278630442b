"""The first page of help of a command with many options: examples, the most used, groups."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill
from typing import NamedTuple

WIDTH = 88
ALL = "--help-all"
"""The option that explains every option."""


class ShortHelp(NamedTuple):
    """What ``--help`` prints; ``--help-all`` explains every option.

    Attributes:
        about: one or two sentences on what the command does.
        examples: command lines, each with what it does.
        used: the most used options with their values, each with what it does.
        groups: what the other options are for, each with their names.
    """

    about: str
    examples: Sequence[tuple[str, str]]
    used: Sequence[tuple[str, str]]
    groups: Sequence[tuple[str, str]]

    def names(self) -> list[str]:
        """All options on the page, without dashes; ``starts.*`` stands for a group of options."""
        given = [option.split()[0] for option, _ in self.used]
        return [name.removeprefix("--") for name in given] + [
            name for _, names in self.groups for name in names.split()
        ]

    def text(self, prog: str) -> str:
        """The page, for the command ``prog``."""
        width = max(len(option) for option, _ in self.used)
        lines = [fill(self.about, WIDTH), "", "Examples:"]
        for words, what in self.examples:
            lines += [f"  {prog} {words}", f"      {what}"]
        lines += ["", "Most used options:"]
        hanging = " " * (width + 4)
        for option, what in self.used:
            lines.append(
                fill(what, WIDTH, initial_indent=f"  {option:{width}}  ", subsequent_indent=hanging)
            )
        lines += ["", "Other options:"]
        for title, names in self.groups:
            listed = ", ".join(f"--{name}" for name in names.split())
            lines.append(fill(f"{title}: {listed}", WIDTH, initial_indent="  ",
                              subsequent_indent="      ", break_on_hyphens=False))  # fmt: skip
        return "\n".join([*lines, "", f"{prog} {ALL} explains every option."])
