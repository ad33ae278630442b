"""Options of ``questsim average`` and ``questsim export``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass
class AverageArgs:
    """Options of ``questsim average``."""

    policies: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Policy folders of one training, or a stage folder: all of its kept policies but the first,
    from which the training began (--set stages.student.keep_checkpoints=true keeps them)."""
    out: Annotated[Path, tyro.conf.arg(help="The averaged policy's folder.")]


@dataclass(frozen=True)
class ExportArgs:
    """Write a policy as one ONNX graph for other runtimes."""

    agent: str
    """A policy: a run or checkpoint folder, or a shipped name."""
    out: Path
    """File to write."""
    format: Literal["onnx"] = "onnx"
    """Format of the file."""
