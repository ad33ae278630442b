"""Train on a cluster whose head dies; run by ``test_cluster.py``."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

from own_cluster import own_cluster

ROOT = Path(__file__).parents[1]
WHOLE = "stages.teacher.learning.rollout_steps=4 stages.teacher.learning.minibatch=16"


def main(folder: Path) -> None:
    cluster, _ = own_cluster(folder, 2)
    out, log = folder / "run", folder / "log"
    options = (
        f"--preset smoke --stage teacher --motions synthetic:stand --envs 4 --threads 1 --out {out}"
        f" --steps 1000000 --workers 2 --ray {cluster.address} --set validation_clips=1 {WHOLE}"
    )
    with log.open("w") as file:
        training = subprocess.Popen(
            [sys.executable, "train.py", *options.split()], cwd=ROOT, stdout=file, stderr=file
        )
        while training.poll() is None and not list(out.glob("teacher/last/policy.yaml")):
            time.sleep(0.2)
        time.sleep(1.0)
        assert cluster.head_node is not None
        cluster.head_node.kill_gcs_server()
        cluster.head_node.kill_raylet()
        print("exit", training.wait(timeout=500), flush=True)
    lines = [line for line in log.read_text().splitlines() if line.startswith("error:")]
    print("one line" if len(lines) == 1 and " died" in lines[0] else log.read_text(), flush=True)
    print("checkpoint" if (out / "teacher/last/resume.pt").is_file() else "none", flush=True)
    resume(out, options.split(), folder)


def resume(out: Path, options: list[str], folder: Path) -> None:
    """Go on for one iteration on another cluster."""
    from agents.policy.checkpoint import load_resume
    from agents.training.ray_session import ray_cluster
    from questsim.cli import main as questsim

    before = load_resume(out / "teacher/last")["learner"]["steps"]
    options[options.index("--steps") + 1] = str(before + 16)
    cluster, _ = own_cluster(folder, 2)
    with ray_cluster(cluster.address, 2):
        code = questsim(["train", *options, "--resume"])
    after = load_resume(out / "teacher/last")["learner"]["steps"]
    print("resumed" if (code, after) == (0, before + 16) else (code, before, after), flush=True)
    cluster.shutdown()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
