"""Kill the commands of trainings on a cluster of two nodes; run by ``test_cluster.py``."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from own_cluster import own_cluster

ROOT = Path(__file__).parents[1]
POLICY = (
    "train --preset smoke --stage teacher --motions synthetic:stand --envs 4 --threads 1"
    " --steps 800 --set validation_clips=1 stages.teacher.evaluate_every=64"
    " stages.teacher.learning.rollout_steps=4 stages.teacher.learning.minibatch=16"
)
SYSTEM = (
    "train --agent hmdposer --preset smoke --motions synthetic:stand --threads 1 --steps 40"
    " --set stages.network.evaluate_every=4 validation=4"
)


def kill(options: list[str], last: Path) -> int:
    """Begin a training and kill it after its second checkpoint; the exit code."""
    training = subprocess.Popen(
        [sys.executable, "train.py", *options[1:]], cwd=ROOT, stdout=subprocess.DEVNULL
    )
    seen: set[int] = set()
    while training.poll() is None and len(seen) < 2:
        time.sleep(0.02)
        try:
            seen.add((last / "resume.pt").stat().st_mtime_ns)
        except FileNotFoundError:  # not yet, or it is being replaced
            continue
    training.kill()
    return training.wait()


def state(last: Path) -> dict[str, Any]:
    """Weights of all networks, and the steps."""
    from agents.policy.checkpoint import load_resume

    found = load_resume(last)
    return found["module"] if "module" in found else found["learner"]["policy"]


def main(folder: Path) -> None:
    cluster, _ = own_cluster(folder, 1, 1)
    from agents.training.ray_session import ray_cluster
    from questsim.cli import main as questsim

    for name, words, stage in (("policy", POLICY, "teacher"), ("system", SYSTEM, "network")):
        options = [*words.split(), "--workers", "2", "--ray", cluster.address, "--out"]
        killed, whole = folder / f"{name}-killed", folder / f"{name}-whole"
        code = kill([*options, str(killed)], killed / stage / "last")
        print(name, "killed" if code == -9 else f"ended with {code}", flush=True)
        time.sleep(2.0)  # its own process notices the death
        with ray_cluster(cluster.address, 2):
            assert questsim([*options, str(killed), "--resume"]) == 0
            assert questsim([*options, str(whole)]) == 0
        found, expected = (state(run / stage / "last") for run in (killed, whole))
        same = all((found[key] == value).all() for key, value in expected.items())
        print(name, "same" if same else "different", flush=True)
    cluster.shutdown()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
