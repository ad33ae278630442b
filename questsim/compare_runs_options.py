"""Options of ``questsim compare-runs``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class CompareRunsArgs:
    """Compare two evaluations clip by clip."""

    a: Annotated[Path, tyro.conf.Positional]
    """A folder that evaluate.py --out wrote."""
    b: Annotated[Path, tyro.conf.Positional]
    """Another one, of the same motions."""
