"""Options of ``questsim agents``, ``ship`` and ``publish``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agents.resolve import SHIPPED


@dataclass(frozen=True)
class AgentsArgs:
    """List every agent and preset."""

    json: bool = False
    """Print JSON, for programs."""


@dataclass(frozen=True)
class ShipArgs:
    """Copy a run's best policy or kinematic system to the shipped ones and write its card."""

    run: Path
    """A run folder, a stage of it, or a checkpoint folder inside it."""
    name: str
    """Shipped name, e.g. for evaluate --agent NAME."""
    metrics: tuple[Path, ...] = ()
    """Evaluation reports in the order of the card: metrics.json of a policy, comparison.json of a
    kinematic system."""
    into: Path = SHIPPED
    """Folder of the shipped policies."""
    files: Annotated[tuple[str, ...], tyro.conf.arg(metavar="FILE=NAME ...")] = ()
    """What the card calls a motion file of the training, by default runs/ and its own name, as in
    /data/w.toml=docs/mixtures/wide.toml."""


@dataclass(frozen=True)
class PublishArgs:
    """Upload an agent to the Hugging Face Hub; others then use it by the name hf:USER/REPO."""

    name: Annotated[str, tyro.conf.Positional]
    """A shipped policy or kinematic system, or a run, stage or checkpoint folder."""
    to: Annotated[str, tyro.conf.Positional]
    """hf:USER/REPO; the repository is created if needed."""
    metrics: tuple[Path, ...] = ()
    """Evaluation reports for the card of a run, as for questsim ship."""
    private: bool = False
    """Create a private repository."""
