"""Tables behind the pictures of the documentation."""

from __future__ import annotations

from docs.figures.system_curves import add
from docs.figures.training_curves import read

HEADER = "time/total_timesteps,evaluation/error_cm,training/loss\n"


def test_a_systems_curve_has_every_evaluation_of_all_parts_of_its_training(tmp_path):
    logs = tmp_path / "stage" / "tensorboard"
    logs.mkdir(parents=True)
    (logs / "progress-1.csv").write_text(HEADER + "0,9.5,\n20,,0.3\n250,6,\n")
    (logs / "progress-2.csv").write_text(HEADER + "260,,0.2\n500,4.25,\n")
    table = tmp_path / "curves.csv"
    add("other", tmp_path / "stage", table)
    add("mine", tmp_path / "stage", table)
    add("mine", tmp_path / "stage", table)
    found = read(table)
    assert list(found) == ["other", "mine"]
    assert [(row["steps"], row["error_cm"]) for row in found["mine"]] == [
        ("0", "9.500"), ("250", "6.000"), ("500", "4.250"),
    ]  # fmt: skip
