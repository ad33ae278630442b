import csv
import json
import os
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from PIL import Image
from rollouts import moving_clip, rollout, shifted, still_clip

from agents.evaluation.groups import ALL, format_groups
from questsim import evaluation_report, plots
from questsim.errors import InputError
from questsim.evaluation_report import (
    FILES,
    LABELS,
    check_writable,
    format_table,
    write_report,
)
from questsim.metrics import SCHEMA, SCHEMA_VERSION, evaluate


@pytest.fixture(scope="module")
def rollouts():
    walk = moving_clip(30, name="walk-1", kind="walk", style="old")
    run = moving_clip(40, seed=1, name="run-1", kind="run", style="young")
    return [
        rollout(walk, link_position=shifted(walk, (0.03, 0.0, 0.0))),
        rollout(run, frames=25, link_position=shifted(run, (0.06, 0.0, 0.0))[:25], fell=True),
    ]


@pytest.fixture
def unwritable(tmp_path):
    folder = tmp_path / "locked"
    folder.mkdir()
    folder.chmod(0o500)
    yield folder
    folder.chmod(0o700)


def not_finite(text):
    raise AssertionError(f"{text} is not JSON")


# What is written


def test_a_report_is_complete_and_nothing_else_is_left(tmp_path, rollouts):
    metrics = write_report(rollouts, tmp_path / "a" / "b", {"agent": "x"})
    assert sorted(path.name for path in (tmp_path / "a" / "b").iterdir()) == sorted(FILES)
    written = (tmp_path / "a" / "b" / "metrics.json").read_text()
    assert json.loads(written, parse_constant=not_finite) == metrics


def test_metrics_json_says_what_it_is_and_what_was_run(tmp_path, rollouts):
    @dataclass
    class Config:
        sensors: str = "H+2C"
        heights: tuple[float, float] | None = (1.6, 1.8)

    context = {
        "config": Config(),
        "agent": Path("runs/x"),
        "versions": {"numpy": "2"},
        "gain": np.float32(0.5),
        "limits": np.array([1, 2]),
        "best": float("inf"),
        "resumed": False,
    }
    written = write_report(rollouts, tmp_path, context)
    assert (written["schema"], written["version"]) == (SCHEMA, SCHEMA_VERSION)
    assert json.loads((tmp_path / "metrics.json").read_text())["context"] == {
        "config": {"sensors": "H+2C", "heights": [1.6, 1.8]},
        "agent": str(Path("runs/x")),
        "versions": {"numpy": "2"},
        "gain": 0.5,
        "limits": [1, 2],
        "best": None,
        "resumed": False,
    }


def test_each_clip_has_its_line_in_the_csv(tmp_path, rollouts):
    write_report([*rollouts, rollout(still_clip(frames=3, name="a,b"))], tmp_path)
    with (tmp_path / "clips.csv").open(newline="") as file:
        walk, run, still = csv.DictReader(file)
    assert (walk["name"], walk["kind"], walk["style"]) == ("walk-1", "walk", "old")
    assert (walk["frames"], walk["completed"], walk["mpjpe_cm"]) == ("30", "1", "3")
    assert (run["frames"], run["clip_frames"], run["completed"]) == ("25", "40", "0")
    assert (still["name"], still["jitter_km_s3"]) == ("a,b", "")


def test_plots_are_images_with_ink_on_them(tmp_path, rollouts):
    write_report(rollouts, tmp_path)
    for name in FILES:
        if name.endswith(".png"):
            pixels = np.asarray(Image.open(tmp_path / name).convert("L"))
            assert min(pixels.shape) > 100, name
            assert pixels.std() > 5, name


def test_no_figure_stays_open(tmp_path, rollouts):
    write_report(rollouts, tmp_path)
    assert plt.get_fignums() == []


def test_a_report_of_lost_kinematic_and_nameless_clips_can_be_written(tmp_path):
    clip = still_clip(frames=2)
    lost = rollout(clip, link_position=shifted(clip, (9.0, 0.0, 0.0)), fell=True)
    kinematic = rollout(clip, contact_force=None)
    write_report([lost], tmp_path / "lost")
    write_report([kinematic], tmp_path / "kinematic")
    assert json.loads((tmp_path / "lost" / "metrics.json").read_text())["all"]["mpjpe_cm"] is None


def test_many_kinds_fit_in_one_figure(tmp_path):
    many = [rollout(still_clip(frames=4, kind=f"kind-{i}")) for i in range(60)]
    plots.plot_error_over_time(many, tmp_path / "many.png")
    width, height = Image.open(tmp_path / "many.png").size
    assert width < 2000 and height < 2000


# All or nothing


def test_an_older_report_is_replaced_and_other_files_stay(tmp_path, rollouts):
    write_report(rollouts[:1], tmp_path)
    (tmp_path / "video.mp4").write_bytes(b"film")
    write_report(rollouts, tmp_path)
    assert json.loads((tmp_path / "metrics.json").read_text())["all"]["clips"] == 2
    assert (tmp_path / "video.mp4").read_bytes() == b"film"
    assert sorted(os.listdir(tmp_path)) == sorted([*FILES, "video.mp4"])


@pytest.mark.parametrize("existed", [True, False])
def test_a_failure_leaves_the_folder_as_it_was(tmp_path, rollouts, monkeypatch, existed):
    out = tmp_path / "new" / "out"
    if existed:
        write_report(rollouts[:1], out)
    before = {path.name: path.read_bytes() for path in out.glob("*")}

    def fail(*args):
        raise OSError("disk full")

    monkeypatch.setattr(evaluation_report.plots, "plot_error_histogram", fail)
    with pytest.raises(OSError, match="disk full"):
        write_report(rollouts, out)
    assert out.parent.exists() == existed
    assert {path.name: path.read_bytes() for path in out.glob("*")} == before


def test_a_writable_place_is_accepted_and_not_touched(tmp_path):
    check_writable(tmp_path / "new" / "deep")
    check_writable(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("below", [".", "under/it"])
def test_a_file_in_the_way_is_refused(tmp_path, below):
    file = tmp_path / "file"
    file.write_text("mine")
    with pytest.raises(InputError, match="a file is in the way"):
        check_writable(file / below)
    assert file.read_text() == "mine"


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write")
def test_a_folder_without_permission_is_refused(unwritable, rollouts):
    with pytest.raises(InputError, match="cannot be written: Permission denied"):
        write_report(rollouts, unwritable / "out")


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="no /proc")
def test_a_file_system_that_takes_no_files_is_refused(rollouts):
    with pytest.raises(InputError, match="/proc/questsim-report: cannot be written"):
        write_report(rollouts, "/proc/questsim-report")


@pytest.mark.parametrize("name", ["x" * 400, "nul\0l"])
def test_an_impossible_name_is_refused(tmp_path, name):
    with pytest.raises(InputError):
        check_writable(tmp_path / name)


# The table


def rows(table: str) -> dict[str, list[str]]:
    cells = [
        [cell.strip() for cell in line.strip("│┃").replace("┃", "│").split("│")]
        for line in table.splitlines()
        if "│" in line or "┃" in line
    ]
    return {row[0]: row[1:] for row in cells}


def test_the_table_shows_all_and_completed_and_each_kind(rollouts):
    table = rows(format_table(evaluate(rollouts), width=90))
    assert table["metric"] == ["all", "completed"]
    assert table["clips"] == ["2", "1"]
    assert table["success (%)"] == ["50.0", "100.0"]
    assert table["MPJPE (cm)"] == [f"{(30 * 3 + 25 * 6) / 55:.2f}", "3.00"]
    assert table["walk"][:3] == ["1", "100.0", "3.00"]
    assert table["run"][:3] == ["1", "0.0", "6.00"]


def test_the_table_shows_a_dash_where_nothing_was_completed(rollouts):
    table = rows(format_table(evaluate(rollouts[1:])))
    assert table["MPJPE (cm)"] == ["6.00", "-"]
    assert table["success (%)"] == ["0.0", "-"]


def test_kinds_of_more_than_ten_clips_have_intervals_in_the_table():
    walk, run = still_clip(frames=8, kind="walk"), still_clip(frames=8, kind="run")
    walks = [
        rollout(walk, link_position=shifted(walk, (0.01 * i, 0.0, 0.0)), fell=i == 0)
        for i in range(12)
    ]
    metrics = evaluate([*walks, rollout(run)])
    ends = metrics["by_kind"]["walk"]["intervals"]["all"]
    mean = metrics["by_kind"]["walk"]["all"]["mpjpe_cm"]
    assert ends["mpjpe_cm"][0] < mean < ends["mpjpe_cm"][1] and ends["success"][1] == 1.0
    assert set(metrics["by_kind"]["run"]["intervals"]["all"].values()) == {None}
    low, high = ends["mpjpe_cm"]
    assert f"({low:.2f} to {high:.2f})" in " ".join(format_table(metrics, width=160).split())


def test_groups_of_more_than_ten_clips_have_intervals_in_the_table_of_groups():
    figures = {"clips": 12, "completed": 11, "interval": (0.75, 1.0), "mpjpe_cm": 3.0}
    few = {"clips": 3, "completed": 2, "interval": None, "mpjpe_cm": 3.0}
    table = format_groups({"reference": {ALL: figures, "walk": figures, "run": few}})
    assert "91.7 % (75 to 100)" in table and "11 (75 to 100 %)" in table
    assert next(line for line in table.splitlines() if "run" in line).split("│")[3].strip() == "2"


def test_the_table_does_not_read_markup_in_names():
    odd = rollout(still_clip(kind="[bold]walk"))
    assert "[bold]walk" in format_table(evaluate([odd]))


def test_the_page_of_metrics_names_every_figure_by_its_key_and_by_its_label_in_the_table():
    page = (Path(__file__).parents[1] / "docs/metrics.md").read_text(encoding="utf-8")
    rows = [row for row in page.splitlines() if row.startswith("| `")]
    for key, label in LABELS.items():
        if key not in ("clips", "frames"):
            assert any(f"`{key}`" in row and label.strip() in row for row in rows), key
