"""Parsing of command lines by tyro, with one line for each error instead of tyro's boxes."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import fields, is_dataclass
from pathlib import Path
from textwrap import dedent
from typing import Any, TypeVar

from questsim.errors import InputError, finite

T = TypeVar("T")

_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_DEFAULT = re.compile(r"\s*\(default:\s*(?:None|False|'')?\)")
"""Default of options that are None, False or empty."""
_RULE = re.compile(r"[╭╰].*|[─-]{3,}")
"""The edges of a box, and the lines between its parts."""
_KINDS = {
    "INT": "a whole number",
    "INT INT": "two whole numbers",
    "FLOAT": "a number",
    "FLOAT FLOAT": "two numbers",
    "[INT [INT ...]]": "whole numbers",
    "[FLOAT [FLOAT ...]]": "numbers",
}
"""What tyro's abbreviations mean."""


def parse(
    kind: type[T],
    words: Sequence[str] | None = None,
    prog: str | None = None,
    description: str | None = None,
) -> T:
    """Parse the options of a command; ``--help`` prints them and exits.

    Args:
        kind: a dataclass of options.
        words: the command line; by default that of the process.
        prog: name of the command; by default that of the process.
        description: text above the options; by default the docstring of ``kind``.

    Raises:
        InputError: an option is unknown, missing, or has a value that it cannot have.
    """
    import tyro

    words = sys.argv[1:] if words is None else list(words)
    box, page = io.StringIO(), io.StringIO()
    options: dict[str, Any] = {"prog": prog, "description": description}
    try:
        with redirect_stderr(box), redirect_stdout(page):
            found = tyro.cli(kind, args=words, **options)
    except SystemExit as end:
        if not end.code:
            print(_plain(page.getvalue()), end="")
            raise
        command = prog or Path(sys.argv[0]).name
        raise _error(box.getvalue(), words, f"see {command} --help") from None
    _check_finite(found)
    _check_given(found, words, f"see {prog or Path(sys.argv[0]).name} --help")
    return found


def _check_given(args: Any, words: Sequence[str], fix: str) -> None:
    """Refuse an option of several values that is given without any: it would do nothing."""
    given = {word.partition("=")[0].replace("_", "-") for word in words if word.startswith("--")}
    for field in fields(args):
        option = f"--{field.name.replace('_', '-')}"
        if getattr(args, field.name) == () and option in given:
            raise InputError("needs a value", option, fix)


def _check_finite(args: Any, prefix: str = "--") -> None:
    """Refuse infinity and NaN in every option; no command has a use for them."""
    for field in fields(args):
        value = getattr(args, field.name)
        option = prefix + field.name.replace("_", "-")
        if is_dataclass(value):
            _check_finite(value, f"{option}.")
            continue
        for number in value if isinstance(value, tuple | list) else (value,):
            if isinstance(number, float):
                finite(option, number)


def _plain(page: str) -> str:
    """A page of help without tyro's marks for options that may be left out."""
    page = re.sub(r"\{None\}\|(.*?)( {2,}|\n)", rf"\1\2{' ' * len('{None}|')}", page)
    page = _DEFAULT.sub("", page).replace("{None,", "{")
    return "".join(line.rstrip() + "\n" for line in page.splitlines())


def _error(box: str, words: Sequence[str], fix: str) -> InputError:
    """The error in a box of tyro's; words are those of the command line."""
    parts: list[list[str]] = [[]]
    for line in _COLOUR.sub("", box).splitlines():
        inner = line.strip("│").rstrip()
        if _RULE.fullmatch(inner.strip()):
            parts.append([])
        elif inner.strip():
            parts[-1].append(inner)
    # Before the first rule there is nothing, or the title if the output is not UTF-8.
    parts = [dedent("\n".join(part)).split("\n") for part in parts[1:] if part]
    parts = [part for part in parts if not part[0].startswith("For full help")]
    text = " ".join(" ".join(line.strip() for line in part) for part in parts)
    heads = {part[0].partition(":")[0]: part for part in parts}
    for read in (_unknown, _wrong_value, _other):
        if (found := read(text, heads, words, fix)) is not None:
            return found
    return InputError(text or "the command line cannot be read", fix=fix)


def _unknown(
    text: str, heads: dict[str, list[str]], words: Sequence[str], fix: str
) -> InputError | None:
    """Of an option that does not exist, or a word that belongs to none."""
    part = heads.get("Unrecognized options")
    if part is None:
        return None
    found = [word for word in re.split(r"[,\s]+", " ".join(part).partition(":")[2]) if word]
    option = next((word for word in found if word.startswith("--")), None)
    if option is None:
        return InputError(f"unexpected {(found or [''])[0]!r}: it belongs to no option", fix=fix)
    # The second title is that of several unknown options.
    titles = ("Perhaps you meant", f"Arguments similar to {option}")
    similar = [line for title in titles for line in heads.get(title, ())]
    near = [_option(line) for line in similar if line.startswith("    -")]
    meant = f"did you mean {near[0]}? " if near else ""
    return InputError(f"there is no option {option}", fix=meant + fix)


def _wrong_value(
    text: str, heads: dict[str, list[str]], words: Sequence[str], fix: str
) -> InputError | None:
    """Of a value that an option cannot have."""
    if match := re.match(r"invalid choice '(.*)' for argument '(\S+)'\. Expected .*\((.*)\)", text):
        value, option, choices = match.groups()
        listed = re.findall(r"'([^']*)'", choices)
        if "None" in listed:  # of a set, in any order
            listed = sorted(set(listed) - {"None"})
        return InputError(f"is {value!r}", option, f"choose from {', '.join(listed)}")
    if match := re.match(r"Missing value for argument '(\S+)'\. Expected (\d+)", text):
        option, count = match.groups()
        return InputError(
            "needs " + ("a value" if count == "1" else f"{count} values"), option, fix
        )
    if match := re.match(r"Error parsing (\S+): (.*)", text):
        where, reason = match.groups()
        usage = heads.get("Argument helptext")
        if usage is None:  # a dataclass of options has refused them, in one line
            return InputError(reason)
        option = _option(where)
        return InputError(f"is {_given(option, words)!r}, not {_kind_of(usage)}", option, fix)
    return None


def _other(
    text: str, heads: dict[str, list[str]], words: Sequence[str], fix: str
) -> InputError | None:
    """Of an option that is required."""
    for head, part in heads.items():
        if head.startswith("Missing from "):
            entries = re.split(r"\n {4}(?=\S)", "\n" + "\n".join(part[1:]))[1:]
            names = [_name(*entry.partition("\n")[::2]) for entry in entries]
            return InputError(f"missing: {', '.join(names)}", fix=fix)
    return None


def _name(usage: str, text: str) -> str:
    """A required option by its name, or a word without a name by its help."""
    about = " ".join(text.split()).removesuffix("(required)").strip(" .")
    return usage if usage.startswith("-") or not about else f"{usage} ({about})"


def _option(text: str) -> str:
    """The long name at the beginning of the usage of an option."""
    return re.split(r"[\s/,]+", text.strip())[0]


def _given(option: str, words: Sequence[str]) -> str:
    """The value of an option on the command line."""
    for place, word in enumerate(words):
        name, equals, value = word.partition("=")
        if name.replace("_", "-") == option:
            rest = []
            for other in words[place + 1 :]:
                if other.startswith("--"):
                    break
                rest.append(other)
            return value if equals else " ".join(rest)
    return ""


def _kind_of(usage: Sequence[str]) -> str:
    """The values of an option in words, from tyro's help."""
    kinds = usage[1].strip().partition(" ")[2]
    kinds = re.sub(r"\{None\}\|", "", kinds)
    if kinds.startswith("{") and kinds.endswith("}") and "|" not in kinds and "," not in kinds:
        kinds = kinds[1:-1]
    return _KINDS.get(kinds, kinds)
