"""Bootstrap intervals and paired comparisons of evaluations."""

from __future__ import annotations

import numpy as np
import pytest
from rollouts import rollout, shifted, still_clip

from questsim.cli import main
from questsim.errors import InputError
from questsim.evaluation_report import clips_csv
from questsim.statistics import interval, paired


def test_the_interval_of_a_mean_is_about_two_standard_errors_wide():
    values = np.random.default_rng(0).normal(3.0, 2.0, 400)
    low, high = interval(values)  # type: ignore[misc]
    error = values.std() / np.sqrt(len(values))
    assert low == pytest.approx(values.mean() - 1.96 * error, abs=0.1 * error)
    assert high == pytest.approx(values.mean() + 1.96 * error, abs=0.1 * error)


def test_weights_decide_what_a_clip_counts():
    values, weights = np.r_[np.zeros(50), np.ones(50)], np.r_[np.full(50, 3.0), np.ones(50)]
    low, high = interval(values, weights)  # type: ignore[misc]
    assert low < 0.25 < high < 0.4


def test_few_clips_have_no_interval_and_equal_ones_no_width():
    assert interval(np.arange(10.0)) is None
    assert interval(np.ones(20)) == (1.0, 1.0)


def write(folder, errors_m, lost=()):
    """An evaluation of still clips whose avatar is off by so much; ``lost`` ones by 0.6 m."""
    rollouts = []
    for i, error in enumerate(errors_m):
        clip = still_clip(20, name=f"clip-{i}")
        off = shifted(clip, (0.6 if i in lost else error, 0.0, 0.0))
        rollouts.append(rollout(clip, link_position=off))
    folder.mkdir()
    (folder / "clips.csv").write_text(clips_csv(rollouts))
    return folder


@pytest.fixture
def two(tmp_path):
    errors = np.linspace(0.02, 0.05, 14)
    return (
        write(tmp_path / "a", errors, lost=(0, 1)),
        write(tmp_path / "b", errors + 0.01, lost=(1, 2, 3)),
    )


def test_paired_evaluations_give_the_difference_and_the_clips_that_changed_sides(two):
    found = paired(*two)
    assert found.success == pytest.approx((12 / 14, 11 / 14))
    assert found.gained == ("clip-0",)
    assert found.lost == ("clip-2", "clip-3")
    assert found.p_success == pytest.approx(1.0)  # 1 of 3, two-sided: 1/2 + 1/2
    mean, ends, count = found.differences["mpjpe_cm"]
    assert mean == pytest.approx(1.0)
    assert count == 10
    assert ends is None


def test_compare_runs_prints_them(two, capsys):
    assert main(["compare-runs", *map(str, two)]) == 0
    said = capsys.readouterr().out
    assert "only B completed (1): clip-0" in said
    assert "success (%): 85.7 and 78.6" in said


def test_compare_runs_refuses_a_folder_without_an_evaluation(two, tmp_path, capsys):
    assert main(["compare-runs", str(two[0]), str(tmp_path)]) == 2
    assert "has no clips.csv; name a folder" in capsys.readouterr().err
    other = write(tmp_path / "c", [0.02])
    (other / "clips.csv").write_text("name,completed\nx,1\n")
    with pytest.raises(InputError, match="is not the clip list"):
        paired(two[0], other)
