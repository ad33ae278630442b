"""Train on a cluster whose head dies; run by ``test_cluster.py`` in a process of its own."""

from __future__ import annotations

import os
import secrets
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]


def main(folder: Path) -> None:
    token = folder / "token"
    token.write_text(secrets.token_hex(32))
    os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(token)}
    os.environ |= {"RAY_USAGE_STATS_ENABLED": "0", "RAY_worker_niceness": "0"}
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 2})
    out = folder / "run"
    options = (
        f"--preset smoke --stage teacher --motions synthetic:stand --envs 4 --threads 1 --out {out}"
        " --steps 1000000 --set stages.teacher.learning.rollout_steps=4"
        " stages.teacher.learning.minibatch=16 validation_clips=1"
    )
    command = [sys.executable, "train.py", *options.split()]
    with (folder / "log").open("w+") as log:
        training = subprocess.Popen(
            [*command, "--workers", "2", "--ray", cluster.address],
            cwd=ROOT, stdout=log, stderr=subprocess.STDOUT,
        )  # fmt: skip
        curves = out / "teacher" / "curves.csv"
        while training.poll() is None and not list(out.glob("teacher/**/*.csv")):
            time.sleep(0.5)
        time.sleep(3.0)
        print("curves", curves.exists(), list(out.glob("teacher/**/*")), flush=True)
        head = cluster.head_node
        head.kill_gcs_server()
        head.kill_raylet()
        began = time.monotonic()
        code = training.wait(timeout=120)
        print("exit", code, "after", round(time.monotonic() - began), flush=True)
        log.seek(0)
        print(log.read()[-1500:], flush=True)
    print("checkpoint", (out / "teacher" / "last" / "policy.yaml").is_file(), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
