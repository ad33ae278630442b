"""Putting a trained policy among those that are shipped, with a card that tells what it is."""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from agents.checkpoint import (
    CARD_FILE,
    CRITIC_FILE,
    SHIPPED,
    WEIGHTS_FILE,
    find_policy,
    load_policy,
)
from agents.licence import UNKNOWN
from agents.model_card import model_card, read_metrics
from agents.provenance import provenance
from questsim.errors import InputError

MODEL_CARD = "README.md"
MAX_BYTES = 10_000_000
"""A shipped file is smaller than this: weights travel with the source."""

RESERVED = ("zero", "random")
"""Names of agents that are no policies."""


@dataclass(frozen=True)
class ShipArgs:
    """Copy a run's best policy to the shipped ones and write its card."""

    run: Path
    """A run folder, a stage of it, or a policy folder inside it."""
    name: str
    """What the policy is called from now on, e.g. by evaluate --agent NAME."""
    metrics: tuple[Path, ...] = ()
    """metrics.json of its evaluations, in the order of the card."""
    into: Path = SHIPPED
    """Folder of the shipped policies."""


def ship(args: ShipArgs) -> int:
    """Copy a policy with its card, in place of an older one of that name; returns the exit code.

    Raises:
        InputError: no such policy, one whose data or licence is not known, that is too large, or
            metrics of another policy.
    """
    check_name(args.name)
    source = find_policy(args.run)
    agent = load_policy(source)
    size = (source / WEIGHTS_FILE).stat().st_size
    if size > MAX_BYTES:
        raise InputError(f"{size / 1e6:.1f} MB is more than 10 MB", source / WEIGHTS_FILE)
    training = agent.card["training"]
    metrics = [read_metrics(path, training) for path in args.metrics]
    agent.card["training"] = training | provenance(source)
    licence = agent.card["training"]["licence"]
    if licence == UNKNOWN:
        raise InputError("some motions it learnt from have no stated licence", source)
    card = model_card(args.name, agent, size, metrics)
    folder = args.into / args.name
    _write(folder, source, agent.card, card)
    print(f"written to {folder}: {size / 1e6:.1f} MB, {licence}")
    return 0


def check_name(name: str) -> None:
    """Refuse what cannot be a folder and an agent's name.

    Raises:
        InputError: saying what a name is.
    """
    if not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", name) or name in RESERVED:
        raise InputError(
            f"{name!r} is no name for a policy", "--name", "use letters a-z, digits and hyphens"
        )


def _write(folder: Path, source: Path, description: dict[str, Any], card: str) -> None:
    """Write the folder whole beside an older one, then take its place."""
    fresh = folder.with_name(f".{folder.name}.new")
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    shutil.copy(source / WEIGHTS_FILE, fresh)
    if (source / CRITIC_FILE).exists():
        shutil.copy(source / CRITIC_FILE, fresh)
    text = yaml.safe_dump(description, sort_keys=False)
    (fresh / CARD_FILE).write_text(text, encoding="utf-8")
    (fresh / MODEL_CARD).write_text(card, encoding="utf-8")
    shutil.rmtree(folder, ignore_errors=True)
    fresh.rename(folder)
