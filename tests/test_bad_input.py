"""Input that cannot be used: one clear line on stderr, exit code 2, nothing half written."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from bvh_files import BvhText
from command_line import Attempt, questsim

ROOT = Path(__file__).parents[1]
GOOD = str(BvhText())


def assert_refused(attempt: Attempt, *wanted: str) -> None:
    assert attempt.code == 2, attempt.err
    assert attempt.err.startswith("error: "), attempt.err
    assert attempt.err.count("\n") == 1, attempt.err
    assert not [text for text in wanted if text not in attempt.err], attempt.err
    assert not attempt.left


@pytest.fixture(scope="module")
def library(tmp_path_factory) -> Path:
    """What ``motions import`` makes of a good file: the damage below is all that is wrong."""
    folder = tmp_path_factory.mktemp("library")
    (folder / "good.bvh").write_text(GOOD)
    attempt = questsim(folder, "motions", "import", "good.bvh", "--out", "good.npz")
    assert attempt.code == 0, attempt.err
    assert attempt.left == {"good.npz"}
    return folder / "good.npz"


@pytest.fixture(scope="module")
def run_folder(library, tmp_path_factory) -> Path:
    """A training of a few steps."""
    folder = tmp_path_factory.mktemp("run")
    words = ("--preset", "smoke", "--motions", library, "--out", "run", "--steps", 64, "--envs", 4)
    attempt = questsim(folder, *words, script="train.py")
    assert attempt.code == 0, attempt.err
    return folder / "run"


def frames_damaged(old: str, new: str) -> str:
    header, rows = GOOD.split("MOTION")
    return header + "MOTION" + rows.replace(old, new, 1)


DAMAGED = {
    "empty": ("", ["is empty"]),
    "no-bvh": ("a letter\n", ["HIERARCHY"]),
    "truncated": (GOOD[: GOOD.rindex("\n", 0, -400) + 1], ["MOTION block", "of 60 frames"]),
    "unknown-joints": (
        re.sub(r"(ROOT|JOINT) (\w+)", lambda found: f"{found[1]} bone{found.start()}", GOOD),
        ["skeleton", "motions mapping"],
    ),
    "nan": (frames_damaged("96.0000", "nan"), ["finite", "line"]),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_import_refuses_a_damaged_bvh(name, tmp_path):
    text, wanted = DAMAGED[name]
    (tmp_path / f"{name}.bvh").write_text(text)
    attempt = questsim(tmp_path, "motions", "import", f"{name}.bvh", "--out", "lib.npz")
    assert_refused(attempt, f"{name}.bvh", *wanted)


def test_one_damaged_file_among_good_ones_leaves_no_library(tmp_path):
    (tmp_path / "a.bvh").write_text(GOOD)
    (tmp_path / "b.bvh").write_text(DAMAGED["truncated"][0])
    assert_refused(
        questsim(tmp_path, "motions", "import", ".", "--strict", "--out", "lib.npz"), "b.bvh"
    )


def test_import_refuses_declared_units_that_make_a_giant(tmp_path):
    (tmp_path / "a.bvh").write_text(GOOD)
    words = ("motions", "import", "a.bvh", "--out", "lib.npz", "--units", "m")
    assert_refused(questsim(tmp_path, *words), "a.bvh", "177 m", "units")


def test_import_refuses_a_missing_file(tmp_path):
    attempt = questsim(tmp_path, "motions", "import", "none.bvh", "--out", "lib.npz")
    assert_refused(attempt, "none.bvh")


def test_import_refuses_an_unwritable_out(tmp_path):
    (tmp_path / "a.bvh").write_text(GOOD)
    attempt = questsim(tmp_path, "motions", "import", "a.bvh", "--out", "a.bvh/lib.npz")
    assert_refused(attempt, "a.bvh: ")


@pytest.mark.parametrize("key, value", [("version", 99), ("dofs", np.array(["knee"]))])
def test_library_of_another_version_or_body_is_refused(key, value, library, tmp_path):
    with np.load(library) as archive:
        arrays: dict[str, Any] = dict(archive) | {key: np.asarray(value)}
    np.savez(tmp_path / "other.npz", **arrays)
    attempt = questsim(tmp_path, "motions", "list", "other.npz")
    assert_refused(attempt, "other.npz", key)


def test_npz_that_is_no_motion_is_refused(tmp_path):
    np.savez(tmp_path / "other.npz", numbers=np.arange(3))
    assert_refused(questsim(tmp_path, "motions", "list", "other.npz"), "other.npz")


def test_show_refuses_an_unknown_clip(library, tmp_path):
    attempt = questsim(tmp_path, "motions", "show", "none", "--motions", library)
    assert_refused(attempt, "'none'", "good")


def test_training_refuses_a_motion_shorter_than_the_future_window(tmp_path):
    (tmp_path / "short.bvh").write_text(str(BvhText(frames=4)))
    words = ("--preset", "smoke", "--motions", "short.bvh", "--out", "run")
    attempt = questsim(tmp_path, *words, script="train.py")
    assert_refused(attempt, "short", "future frames")


@pytest.mark.parametrize(
    "option, value",
    [
        ("--hold-out", "angry"),
        ("--hold-out", ","),
        ("--sensors", "7T"),
        ("--teacher", "none"),
    ],
)
def test_training_refuses_options_without_starting_a_run(option, value, library, tmp_path):
    words = ["--preset", "smoke", "--motions", library, "--out", "run", option, value]
    if option == "--teacher":
        words += ["--preset", "cpu", "--stage", "student"]
    assert_refused(questsim(tmp_path, *words, script="train.py"), value)


@pytest.mark.parametrize(
    "words, wanted",
    [
        ("--pushes 0 0", "--pushes: has no effect"),
        ("--heights 1.9 1.5", "heights: the least stature, 1.9 m, is above the greatest, 1.5 m"),
        ("--starts.lean-m 0.2", "--starts.lean-m: has no effect; add --starts.disturbed"),
        ("--randomisation.recentre-s 1 2", "--randomisation.recentre-s: has no effect"),
        ("--seed 99999999999999999999", "--seed: is 99999999999999999999, not at most 4294967295"),
        ("--set minutes=1 minutes=2", "--set minutes: is given twice"),
        ("--set stages.teacher.share=0 stages.student.share=0", "no stage has a share"),
    ],
)
def test_training_refuses_options_without_an_effect(words, wanted, library, tmp_path):
    line = ["--preset", "smoke", "--motions", library, "--out", "run", *words.split()]
    assert_refused(questsim(tmp_path, *line, script="train.py"), wanted)


def test_own_proportions_of_embedded_motions_are_refused(tmp_path):
    words = ("--motions", "synthetic:stand", "--out", "run", "--own-proportions")
    for script in ("train.py", "evaluate.py"):
        assert_refused(questsim(tmp_path, *words, script=script), "--own-proportions: has no eff")


def test_training_refuses_motions_that_are_missing(tmp_path):
    words = ("--motions", "none.bvh", "--out", "run")
    assert_refused(questsim(tmp_path, *words, script="train.py"), "none.bvh")


def test_resume_refuses_an_empty_folder(tmp_path):
    (tmp_path / "run").mkdir()
    assert_refused(questsim(tmp_path, "--resume", "--out", "run", script="train.py"), "run")


@pytest.mark.parametrize("out", ["file", "file/run"])
def test_training_refuses_an_unwritable_out(out, library, tmp_path):
    (tmp_path / "file").write_text("")
    words = ("--preset", "smoke", "--motions", library, "--out", out)
    assert_refused(questsim(tmp_path, *words, script="train.py"), out)


def test_resume_refuses_a_run_of_another_version(run_folder, library, tmp_path):
    shutil.copytree(run_folder, tmp_path / "run")
    record = tmp_path / "run" / "run.yaml"
    record.write_text(yaml.safe_dump(yaml.safe_load(record.read_text()) | {"format_version": 99}))
    words = ("--preset", "smoke", "--motions", library, "--out", "run", "--resume")
    assert_refused(questsim(tmp_path, *words, script="train.py"), "run.yaml", "99")


@pytest.mark.parametrize("key, value", [("format_version", 99), ("joints", ["a"])])
def test_evaluation_refuses_a_policy_for_something_else(key, value, run_folder, library, tmp_path):
    shutil.copytree(run_folder, tmp_path / "run")
    cards = list((tmp_path / "run").rglob("policy.yaml"))
    assert cards
    for card in cards:
        card.write_text(yaml.safe_dump(yaml.safe_load(card.read_text()) | {key: value}))
    words = ("--agent", "run", "--motions", library, "--out", "scores")
    assert_refused(questsim(tmp_path, *words, script="evaluate.py"), "policy.yaml", key)


def test_evaluation_refuses_an_unknown_agent(library, tmp_path):
    words = ("--agent", "nobody", "--motions", library, "--out", "scores")
    assert_refused(questsim(tmp_path, *words, script="evaluate.py"), "nobody")


def test_evaluation_refuses_an_unwritable_out(library, tmp_path):
    (tmp_path / "file").write_text("")
    words = ("--agent", "zero", "--motions", library, "--out", "file/scores")
    assert_refused(questsim(tmp_path, *words, script="evaluate.py"), "file")
