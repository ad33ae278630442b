"""The scorecard holds the right figures against the right bars."""

from __future__ import annotations

import json
import re
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers import swaying_clip

from agents.agent import Needs
from agents.commands.evaluate import evaluate_scorecard
from agents.evaluation.options import ScorecardArgs
from agents.evaluation.scorecard import figure, format_scorecard, interval_of, scorecard
from agents.evaluation.scorecard_rows import BARS, TRIALS, Bar
from agents.policy.checkpoint import save_policy
from agents.policy.policy_agent import new_policy
from agents.policy.spec import SPARSE_BLOCKS, Layout, PolicySpec
from envs.config import EnvConfig
from envs.layout import observation_layout
from questsim.errors import InputError
from questsim.motion.library import save_library
from questsim.motion.retarget_back import to_motion

ROWS = ("h2c", "headset", "now", "short", "tall", "noise", "push-60n")
VARIANTS = {"tiny": ("H+2C", 6), "tiny-headset": ("H", 6), "tiny-now": ("H+2C", 0)}


@pytest.fixture
def library(tmp_path, monkeypatch):
    """Two motions, and a policy with its variants among the shipped ones."""
    torch.manual_seed(0)
    for name, (sensors, frames) in VARIANTS.items():
        config = EnvConfig(sensors=sensors, future_frames=frames)
        layout = Layout.of(observation_layout(config)).within(SPARSE_BLOCKS)
        policy = new_policy(PolicySpec(critic_blocks=(), hidden=(8,)), layout)
        needs = Needs(sensors=sensors, future_frames=frames)
        save_policy(tmp_path / "weights" / name, policy, needs, {})
    monkeypatch.setattr("agents.resolve.SHIPPED", tmp_path / "weights")
    clips = [swaying_clip(name, frames=20, height_m=1.7) for name in ("a", "b")]
    path = tmp_path / "two.npz"
    save_library(path, [to_motion(clip) for clip in clips], clips)
    return path


def test_each_trial_has_its_sensors_and_height(library, tmp_path):
    said = []
    run = partial(scorecard, "tiny", str(library), tmp_path / "out", None, 1, say=said.append)
    card = run(rows=ROWS)
    assert set(card["trials"]) == set(ROWS) <= set(TRIALS)
    assert len(card["rows"]) == sum(bar.trial in ROWS for bar in BARS)
    assert len(said) == len(ROWS) and "s left" in said[0]
    seen = {}
    for trial in ROWS[:5]:
        report = json.loads((tmp_path / "out" / trial / "metrics.json").read_text())
        config = report["context"]["config"]
        seen[trial] = (config["sensors"], config["future_frames"], config["heights"])
    assert seen == {
        "h2c": ("H+2C", 6, None),
        "headset": ("H", 6, None),
        "now": ("H+2C", 0, None),
        "short": ("H+2C", 6, [1.45, 1.45]),
        "tall": ("H+2C", 6, [1.95, 1.95]),
    }
    assert json.loads((tmp_path / "out" / "scorecard.json").read_text()) == card
    assert "headset only" in format_scorecard(card)
    noise = next(row for row in card["rows"] if row["trial"] == "noise")
    assert noise["bar"] == card["trials"]["h2c"]["all"]["success"] * 100 - 3
    kept = json.loads((tmp_path / "out" / "h2c" / "trial.json").read_text())
    kept["figures"]["completed"]["mpjpe_cm"] = 0.125
    (tmp_path / "out" / "h2c" / "trial.json").write_text(json.dumps(kept))
    again = run(rows=("h2c",))
    assert again["trials"]["h2c"]["completed"]["mpjpe_cm"] == 0.125, "a trial is kept"
    kept["key"] = "of another policy"
    (tmp_path / "out" / "h2c" / "trial.json").write_text(json.dumps(kept))
    again = run(rows=("h2c",))["trials"]["h2c"]["completed"]["mpjpe_cm"]
    assert again == card["trials"]["h2c"]["completed"]["mpjpe_cm"], "of another policy it is not"
    assert again > 0.125


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rows": ("h2c", "moon")}, "no 'moon'.*choose from h2c"),
        ({"rows": ("extra",)}, "needs motions"),
        ({"rows": ("h2c",), "extra": "synthetic"}, "not among --rows"),
        ({"rows": ("hurdle",)}, "no clip of these motions suits --rows"),
    ],
)
def test_rows_that_do_not_fit_are_refused(library, options, message):
    with pytest.raises(InputError, match=message):
        scorecard("tiny", str(library), None, None, 1, **options)


def test_success_is_of_all_clips_and_errors_of_those_completed():
    metrics: dict[str, Any] = {
        "all": {"success": 0.25, "mpjpe_cm": 9.0},
        "completed": {"success": 1.0, "mpjpe_cm": 3.0},
    }
    assert figure(metrics, "success") == 25.0
    assert figure(metrics, "mpjpe_cm") == 3.0
    assert interval_of(metrics, "success") is None
    metrics["intervals"] = {
        "all": {"success": [0.125, 0.5], "mpjpe_cm": [8.0, 9.5]},
        "completed": {"success": [1.0, 1.0], "mpjpe_cm": [2.5, 3.5]},
    }
    assert interval_of(metrics, "success") == [12.5, 50.0]
    assert interval_of(metrics, "mpjpe_cm") == [2.5, 3.5]


def test_a_bar_is_reached_from_its_good_side_only():
    success, error = Bar("h2c", "success", 95.0, 99.0), Bar("h2c", "mpjpe_cm", 4.0, 3.0)
    assert success.reached(95.0, success.bar)
    assert not success.reached(94.9, success.bar)
    assert error.reached(3.9, error.bar)
    assert not error.reached(3.9, error.goal)
    assert not error.reached(None, error.bar)  # nothing was completed


def test_motions_of_ones_own_have_another_bar_for_a_tracker():
    extra = next(bar for bar in BARS if bar.trial == "extra")
    assert (extra.of(False).bar, extra.of(False).goal) == (55.0, 80.0)
    assert (extra.of(True).bar, extra.of(True).goal) == (70.0, 90.0)
    other = next(bar for bar in BARS if bar.trial == "standing")
    assert other.of(True) == other


def test_the_page_of_the_metrics_explains_every_row_with_its_bars():
    page = (Path(__file__).parents[1] / "docs" / "metrics.md").read_text()
    table = page.partition("## The scorecard")[2].partition("## Intervals")[0]
    lines = [line for line in table.splitlines() if line.startswith("| `")]
    told = {name: line for line in lines for name in re.findall(r"`([\w-]+)`", line.split("|")[1])}
    assert list(told) == list(TRIALS)
    for bar in BARS:
        for which in (bar.of(False), bar.of(True)):
            assert f"{which.bar:g} / {which.goal:g}" in told[bar.trial], bar


def test_a_missing_variant_is_named_before_anything_runs(library, tmp_path, monkeypatch):
    args = ScorecardArgs(agent="zero-none", motions=str(library), out=tmp_path / "o")
    with pytest.raises(InputError, match="zero-none"):
        evaluate_scorecard(args)
    assert not (tmp_path / "o").exists()
