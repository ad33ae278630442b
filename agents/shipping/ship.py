"""Copy trained weights to the shipped ones and write their model card."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import yaml

from agents.kinematic.store import CARD_FILE as SYSTEM_CARD
from agents.kinematic.store import WEIGHTS_FILE as SYSTEM_WEIGHTS
from agents.kinematic.store import read_system_card
from agents.licence import UNKNOWN
from agents.policy.checkpoint import (
    CARD_FILE,
    CRITIC_FILE,
    WEIGHTS_FILE,
    load_policy,
)
from agents.resolve import BASELINES, UNTRAINED, resolve
from agents.shipping.model_card import model_card, read_metrics
from agents.shipping.options import ShipArgs
from agents.shipping.provenance import provenance
from agents.shipping.system_card import comparison_lines, system_card, system_provenance
from questsim.errors import InputError
from questsim.evaluation_report import check_writable

MODEL_CARD = "README.md"
MAX_BYTES = 10_000_000
"""Upper limit of a shipped file's size: weights are part of the source repository."""

RESERVED = (*BASELINES, *UNTRAINED)
"""Names of agents without weights."""


def ship(args: ShipArgs) -> int:
    """Copy weights and card, replacing older ones of that name; returns the exit code.

    Raises:
        InputError: see ``ship_folder``.
    """
    size, licence = ship_folder(args)
    print(f"written to {args.into / args.name}: {size / 1e6:.1f} MB, {licence}")
    return 0


def ship_folder(args: ShipArgs) -> tuple[int, str]:
    """Write the folder ``args.into / args.name``; size of the weights in bytes, and licence.

    Raises:
        InputError: there are no weights, their data or licence is unknown, they are too large, or
            a report belongs to other weights.
    """
    check_name(args.name)
    check_writable(args.into)
    found = resolve(args.run)
    if found.folder is None or found.kind not in ("policy", "system"):
        raise InputError("has no weights to ship", args.run, "name a run folder")
    return (_ship_policy if found.kind == "policy" else _ship_system)(args, found.folder)


def _ship_policy(args: ShipArgs, source: Path) -> tuple[int, str]:
    agent = load_policy(source)
    if "stages" in agent.card["training"]:
        fix = "name the folder of the run that trained it"
        raise InputError("is a shipped policy, not one of a run", source, fix)
    size = _checked_size(source / WEIGHTS_FILE)
    training = agent.card["training"]
    metrics = [read_metrics(path, training) for path in args.metrics]
    behind = provenance(source, _called(args))
    motions = {"motions": behind["stages"][-1]["motions"]}
    agent.card["training"] = training | motions | behind
    licence = _checked_licence(agent.card["training"], source)
    card = model_card(args.name, agent, size, metrics)
    _write(args, source, (WEIGHTS_FILE, CRITIC_FILE), (CARD_FILE, agent.card), card)
    return size, licence


def _ship_system(args: ShipArgs, source: Path) -> tuple[int, str]:
    description = read_system_card(source)
    size = _checked_size(source / SYSTEM_WEIGHTS)
    training = description["training"]
    figures = [line for path in args.metrics for line in comparison_lines(path, training)]
    behind = system_provenance(source, _called(args))
    motions = {"motions": behind["stages"][-1]["motions"]}
    description["training"] = training | motions | behind
    licence = _checked_licence(description["training"], source)
    card = system_card(args.name, source, description["training"], size, figures)
    _write(args, source, (SYSTEM_WEIGHTS,), (SYSTEM_CARD, description), card)
    return size, licence


def _called(args: ShipArgs) -> dict[str, str]:
    """``--files`` as a table.

    Raises:
        InputError: a value is not of the form FILE=NAME.
    """
    table = {}
    for text in args.files:
        file, sign, name = text.partition("=")
        if not (file and sign and name) or Path(name).is_absolute():
            raise InputError(f"{text!r} is not FILE=NAME", "--files", "NAME is what the card says")
        table[str(Path(file).absolute())] = name
    return table


def _checked_size(weights: Path) -> int:
    size = weights.stat().st_size
    if size > MAX_BYTES:
        raise InputError(f"{size / 1e6:.1f} MB is more than 10 MB", weights)
    return size


def _checked_licence(training: dict[str, Any], source: Path) -> str:
    if training["licence"] == UNKNOWN:
        raise InputError("some of its training motions have no stated licence", source)
    return training["licence"]


def check_name(name: str) -> None:
    """Check that a name is valid both as a folder's and as an agent's name.

    Raises:
        InputError: the name is not valid; the message says what a name is.
    """
    if not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", name) or name in RESERVED:
        raise InputError(
            f"{name!r} is not a valid name", "--name", "use letters a-z, digits and hyphens"
        )


def _write(
    args: ShipArgs,
    source: Path,
    weights: tuple[str, ...],
    description: tuple[str, dict[str, Any]],
    card: str,
) -> None:
    """Write the folder beside the older one, then replace the older one."""
    folder = args.into / args.name
    fresh = folder.with_name(f".{folder.name}.new")
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    for name in weights:
        if (source / name).exists():
            shutil.copy(source / name, fresh)
    name, content = description
    (fresh / name).write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    (fresh / MODEL_CARD).write_text(card, encoding="utf-8")
    shutil.rmtree(folder, ignore_errors=True)
    fresh.rename(folder)
