"""A Ray cluster of its own on this machine, for ``two_nodes.py`` and ``head_lost.py``.

They run in processes of their own: Ray reads its settings for several nodes only once.
"""

from __future__ import annotations

import os
import secrets
from pathlib import Path
from typing import Any

from agents.training.ray_session import PATIENCE

STARTS = 3
"""Attempts to start: Ray gives up when a node takes longer than 30 s, as on a busy machine."""


def own_cluster(folder: Path, *cores: int) -> tuple[Any, list[Any]]:
    """Start a cluster of nodes with so many cores; others need the token in ``folder``.

    Returns:
        The cluster, and the nodes beside its head.
    """
    token = folder / "token"
    if not token.exists():  # Ray reads it once: a second cluster of this process has the same
        token.write_text(secrets.token_hex(32))
    os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(token)}
    os.environ |= {"RAY_USAGE_STATS_ENABLED": "0", "RAY_worker_niceness": "0"} | PATIENCE
    from ray.cluster_utils import Cluster

    for attempt in range(1, STARTS + 1):
        cluster = Cluster()
        try:
            first, *others = cores
            cluster.add_node(num_cpus=first, include_dashboard=False)
            return cluster, [cluster.add_node(num_cpus=each) for each in others]
        except Exception:  # Ray raises plain ones
            cluster.shutdown()
            if attempt == STARTS:
                raise
    raise AssertionError("unreachable")
