"""A sweep: settings, runs, resuming and the table over seeds."""

from __future__ import annotations

import csv
import json
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from agents.sweep.options import SweepArgs
from agents.sweep.report import Outcome
from agents.sweep.settings import settings_of
from questsim.cli import main
from questsim.errors import InputError
from questsim.statistics import over_seeds, probability_of_improvement

KL = "stages.teacher.learning.desired_kl"
RATE = "stages.teacher.learning.learning_rate"
QUICK = (
    "--preset smoke --stage teacher --motions synthetic:stand --envs 4 --threads 1 --steps 16"
    " --set stages.teacher.learning.rollout_steps=4 stages.teacher.learning.minibatch=16"
    " validation_clips=1"
)


def grid(*values: str, **options) -> list[dict[str, str]]:
    args = SweepArgs(Path("sweep"), values=values, **options)
    return [setting.values for setting in next(settings_of(args).batches())]


def test_a_grid_has_every_combination_in_order():
    found = grid(f"{KL}=0.01,0.02", f"{RATE}=1e-4,3e-4")
    assert found == [
        {KL: kl, RATE: rate} for kl, rate in product(("0.01", "0.02"), ("1e-4", "3e-4"))
    ]
    assert grid() == [{}]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"values": ("nothing=1,2",)}, "there is no 'nothing' in the preset"),
        ({"values": (f"{KL}=1,x",)}, "'x' is not of type float"),
        ({"values": (f"{KL}=1,1",)}, "is given twice"),
        ({"values": (KL,)}, "is not path=VALUE,VALUE"),
        ({"trials": 3}, "does nothing without --search"),
        ({"values": (f"{KL}=1",), "search": (f"{RATE}=1:2",)}, "does not go with --search"),
        ({"search": (f"{KL}=2:1",)}, "goes from 2 to 1"),
        ({"search": (f"{KL}=0:1:log",)}, "log needs LOW above 0"),
        ({"search": (f"{KL}=1",)}, "is not path=LOW:HIGH"),
        ({"search": ("num_envs=1.5:3",)}, "1.5 is not of type int"),
    ],
)
def test_settings_that_do_not_fit_are_refused(options, message):
    if "search" in options:
        pytest.importorskip("optuna")
    with pytest.raises(InputError, match=message):
        settings_of(SweepArgs(Path("sweep"), **options))


def searched(count: int, seed: int = 0, best: float = 1e-3) -> list[float]:
    args = SweepArgs(Path("s"), search=(f"{RATE}=1e-5:1e-1:log",), trials=count, seed=seed)
    settings, found = settings_of(args), []
    for batch in settings.batches():
        for setting in reversed(batch):  # results come in any order
            rate = float(setting.values[RATE])
            settings.tell(setting, -abs(np.log10(rate / best)))
        found += [float(setting.values[RATE]) for setting in batch]
    return found


def test_a_search_repeats_its_proposals_and_learns_from_results():
    pytest.importorskip("optuna")
    found = searched(24)
    assert searched(12) == found[:12]
    assert searched(4, seed=1) != found[:4]
    low, high = searched(40, best=1e-5), searched(40, best=1e-1)
    assert low[:4] == high[:4]
    assert np.median(low[8:]) < np.median(high[8:]) / 10


def test_aggregates_over_seeds():
    # The middle half of 8 seeds: outliers do not count.
    values = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 100.0]
    found = over_seeds(values)
    assert found.mean == 3.5
    assert found.interval is not None
    assert found.interval[0] < 3.5 < found.interval[1] < 50
    assert over_seeds([1.0, 2.0]).interval is None
    x, y = [1.0, 2.0, 3.0], [2.0, 3.0, 4.0, 4.0]
    better = probability_of_improvement(x, y)
    assert better.mean == stats.mannwhitneyu(y, x).statistic / 12 == 10 / 12
    assert better.interval is not None
    assert better.interval[0] < better.mean < better.interval[1] <= 1.0


def test_aggregates_are_those_of_rliable():
    metrics = pytest.importorskip("rliable.metrics", reason="rliable is not installed")
    rng = np.random.default_rng(0)
    x, y = rng.random((9, 1)), rng.random((7, 1)) + 0.2
    assert over_seeds(x[:, 0]).mean == pytest.approx(metrics.aggregate_iqm(x))
    expected = metrics.probability_of_improvement(y, x)
    assert probability_of_improvement(x[:, 0], y[:, 0]).mean == pytest.approx(expected)


def test_a_failed_seed_counts_as_zero():
    fine = {"figures": {"score": 0.8, "tracked": 1.0, "link_error_cm": 3.0}}
    setting = next(settings_of(SweepArgs(Path("s"))).batches())[0]
    outcome = Outcome(setting, [fine, fine, {"figures": None}])
    assert (outcome.of("score"), outcome.failed) == ([0.8, 0.8, 0.0], 1)
    assert outcome.of("tracked") == [1.0, 1.0]


def test_a_sweep_trains_as_train_does_and_is_continued(tmp_path, capsys):
    out, alone = tmp_path / "sweep", tmp_path / "alone"
    line = f"sweep {QUICK} --out {out} --values {KL}=0.02"
    assert main([*line.split(), "--seeds", "1"]) == 0
    runs = list((out / "runs").iterdir())
    assert [run.name.rpartition("-seed-")[2] for run in runs] == ["0"]
    with (out / "sweep.csv").open(newline="") as table:
        rows = list(csv.DictReader(table))
    assert [(row[KL], row["seed"], row["steps"]) for row in rows] == [("0.02", "0", "16")]
    assert main(f"train {QUICK} {KL}=0.02 --out {alone}".split()) == 0
    weights = Path("teacher", "last", "policy.safetensors")
    assert (alone / weights).read_bytes() == (runs[0] / weights).read_bytes()

    before = (runs[0] / "result.json").read_bytes()
    assert main([*line.split(), "--seeds", "1"]) == 2
    assert "holds a sweep already; add --resume" in capsys.readouterr().err
    assert main([*line.split(), "--seeds", "1", "--resume"]) == 0
    assert "1 of 1 runs are finished already" in capsys.readouterr().out
    assert (runs[0] / "result.json").read_bytes() == before
    assert main([*line.replace("--envs 4", "--envs 8").split(), "--resume"]) == 2
    assert "--envs was 4, not 8" in capsys.readouterr().err
    found = json.loads((out / "sweep.json").read_text())["settings"]
    assert [each["better_than_first"]["interval"] for each in found] == [None]


def test_a_sweep_that_is_refused_leaves_no_files(tmp_path, capsys):
    line = f"sweep {QUICK} --out {tmp_path / 'sweep'} --hold-out nowhere --seeds 1"
    assert main(line.split()) == 2
    assert "no clip has style 'nowhere'" in capsys.readouterr().err
    assert not (tmp_path / "sweep").exists()
