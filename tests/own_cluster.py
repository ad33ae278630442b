"""A Ray cluster of its own on this machine, for ``two_nodes.py`` and ``head_lost.py``.

They run in processes of their own: Ray reads its settings for several nodes only once.
"""

from __future__ import annotations

import os
import secrets
from pathlib import Path
from typing import Any


def own_cluster(folder: Path, cores: int) -> Any:
    """Start a cluster with a head of so many cores; others need the token in ``folder``."""
    token = folder / "token"
    token.write_text(secrets.token_hex(32))
    os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(token)}
    os.environ |= {"RAY_USAGE_STATS_ENABLED": "0", "RAY_worker_niceness": "0"}
    from ray.cluster_utils import Cluster

    node = {"num_cpus": cores, "include_dashboard": False}
    return Cluster(initialize_head=True, head_node_args=node)
