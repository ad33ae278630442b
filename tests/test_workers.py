"""Evaluations, comparisons and variations on Ray workers: the same results as without them."""

from __future__ import annotations

import csv
import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch
from mocap_files import SMPL_JOINTS, standing, write_bvh
from test_shown import estimate_of
from test_sweep import KL, QUICK

from agents.loading import load_agent
from agents.training.ray_session import ray_cluster, ray_map
from questsim.cli import main
from questsim.errors import InputError
from questsim.motion.library import load_library, save_library
from questsim.motion.retarget_back import to_motion
from tests.helpers import swaying_clip

TIMES = ("ms", "real", "minutes")
"""Parts of the names of columns with times."""


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def cluster():
    if find_spec("ray") is None:
        pytest.skip("Ray is not installed")
    with ray_cluster(None, 2):
        yield


def run(words: str, *more: object) -> None:
    assert main([*words.split(), *map(str, more)]) == 0


def scores(path: Path) -> list[dict[str, str]]:
    """The rows of a table of clips, without times."""
    with path.open() as file:
        rows = list(csv.DictReader(file))
    return [{k: v for k, v in row.items() if not any(t in k for t in TIMES)} for row in rows]


def test_an_evaluation_on_workers_has_the_same_scores(tmp_path, cluster, monkeypatch):
    monkeypatch.setattr("agents.evaluation.rollout.BATCH_CLIPS", 1)
    line = "evaluate --agent questsim-now --motions synthetic:stand --max-clips 2 --threads 1"
    line += " --assist 100 --begin still"
    run(line, "--out", tmp_path / "alone")
    run(line, "--out", tmp_path / "shared", "--workers", 2)
    assert scores(tmp_path / "alone/clips.csv") == scores(tmp_path / "shared/clips.csv")
    used = [json.loads((tmp_path / d / "metrics.json").read_text()) for d in ("alone", "shared")]
    assert used[0]["context"]["assist"] == used[1]["context"]["assist"]


def test_a_scorecard_and_a_row_of_worlds_on_workers_are_the_same(cluster):
    from agents.evaluation.scorecard import scorecard

    cards = []
    for workers in (0, 2):
        with ray_map(workers) as mapper:
            card = scorecard(
                "questsim", "synthetic:walk", None, 1, 1, rows=("h2c", "slope_8deg"), mapper=mapper
            )
        cards.append(card["rows"])
    assert cards[0] == cards[1]
    assert cards[0]


def test_a_comparison_on_workers_is_the_same(tmp_path, cluster):
    line = "evaluate --compare --agents hmdposer hmdposer+physics --motions synthetic:stand"
    line += " --sensors H+2C --max-clips 1 --threads 1"
    tables = []
    for more in ((), ("--workers", 2)):
        run(line, "--out", tmp_path / str(len(more)), *more)
        table = json.loads((tmp_path / str(len(more)) / "comparison.json").read_text())
        tables.append([{k: v for k, v in row.items() if k != "ms"} for row in table["rows"]])
    assert tables[0] == tables[1]


def test_ablations_on_workers_are_the_same(tmp_path, cluster):
    line = "ablations --agent hmdposer --preset smoke --steps 2 --max-clips 1 --threads 1"
    line += " --motions synthetic:stand --test synthetic:wave --seed 1 --variants"
    found = []
    for more in ((), ("--workers", 2)):
        out = tmp_path / str(len(more))
        run(line, "no-shape-head", "--out", out, *more)
        found.append(scores(out / "ablations.csv"))
    assert found[0] == found[1]


def test_variations_on_workers_are_the_same(tmp_path, cluster, monkeypatch):
    monkeypatch.setattr("agents.commands.vary.PART", 1)
    line = "motions vary synthetic:stand --count 2 --seed 4 --out"
    run(line, tmp_path / "alone.npz")
    run(line, tmp_path / "shared.npz", "--workers", 2)
    alone, shared = (load_library(tmp_path / f"{n}.npz").clips for n in ("alone", "shared"))
    assert [clip.name for clip in alone] == [clip.name for clip in shared]
    for one, other in zip(alone, shared, strict=True):
        assert np.array_equal(one.qpos, other.qpos)


def test_a_training_on_a_worker_varies_keeps_and_is_shown_the_same(tmp_path, cluster):
    clips = [swaying_clip("short"), swaying_clip("long", frames=110)]
    save_library(tmp_path / "true.npz", [to_motion(clip) for clip in clips], clips)
    seen = [estimate_of(clip) for clip in clips]
    save_library(tmp_path / "seen.npz", [to_motion(clip) for clip in seen], seen)
    line = f"train --preset smoke --motions {tmp_path}/true.npz --envs 4 --threads 1 --steps 64"
    line += " --set validation_clips=1 stages.student.learning.updates=2"
    line += " stages.student.keep_checkpoints=true stages.student.evaluate_every=32"
    for stage in ("teacher", "student"):
        line += f" stages.{stage}.learning.rollout_steps=4 stages.{stage}.learning.minibatch=16"
    found = []
    for more in ((), ("--workers", 1)):
        out = tmp_path / f"with{len(more)}"
        run(line, *more, "--vary", 0.5, "--redraw", 32, "--out", out / "varied")
        run("average", out / "varied" / "student", "--out", out / "mean")
        line_of_student = [*more, "--stage", "student", "--teacher", out / "varied"]
        run(line, *line_of_student, "--estimates", tmp_path / "seen.npz", "--out", out / "shown")
        files = {path.relative_to(out): path for path in out.rglob("policy.safetensors")}
        found.append({str(name): path.read_bytes() for name, path in files.items()})
    assert found[0] == found[1]
    kept = sorted(name for name in found[0] if name.startswith("varied/student/kept"))
    assert len(kept) == 3 and len({found[0][name] for name in kept}) == 3


def test_an_import_on_workers_makes_the_same_library(tmp_path, cluster, monkeypatch, capsys):
    for name in "abc":
        write_bvh(tmp_path / f"{name}.bvh", SMPL_JOINTS, standing(12, 0.95))
    (tmp_path / "empty.bvh").write_text("")
    monkeypatch.setattr("questsim.motion.many.PART", 1)
    monkeypatch.chdir(tmp_path)  # the workers started elsewhere and are given relative paths
    said = []
    for more in ((), ("--workers", 2)):
        run("motions import a.bvh b.bvh c.bvh empty.bvh --mirrored --out", "library.npz", *more)
        library = load_library(tmp_path / "library.npz")
        figures = [a for c in (*library.clips, *library.motions) for a in vars(c).values()]
        captured = capsys.readouterr()
        said.append((captured.out, captured.err, [c.name for c in library.clips], figures))
    assert said[0][:3] == said[1][:3]
    assert "skipped empty.bvh: is empty" in said[0][1]
    for one, other in zip(said[0][3], said[1][3], strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_sweep_on_a_cluster_trains_as_train_does(tmp_path, cluster, capsys, monkeypatch):
    monkeypatch.setenv("RAY_AUTH_MODE", "token")  # else it would stay set for other tests
    run(f"train {QUICK} {KL}=0.02 --out", tmp_path / "alone")
    line = f"sweep {QUICK} --values {KL}=0.02 --seeds 1 --ray in-use:1 --out"
    run(line, tmp_path / "sweep")
    (shared,) = (tmp_path / "sweep" / "runs").iterdir()
    for file in ("last/policy.safetensors", "best/policy.safetensors"):
        weights = Path("teacher", file)
        assert (tmp_path / "alone" / weights).read_bytes() == (shared / weights).read_bytes()
    assert main([*line.split(), str(tmp_path / "other"), "--hold-out", "nowhere"]) == 2
    assert "no clip has style 'nowhere'" in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


def test_an_error_on_a_worker_is_the_same_error_here(cluster):
    with ray_map(2) as mapper, pytest.raises(InputError, match="nobody"):
        list(mapper(load_agent, ["zero", "nobody"]))


@pytest.mark.parametrize("line", ["evaluate", "motions vary synthetic --out x.npz"])
def test_a_cluster_without_workers_is_refused(line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main([*line.split(), "--ray", "localhost:6379"]) == 2
    assert "--ray: needs --workers; add --workers N" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
