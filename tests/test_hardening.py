"""Killed, crowded and full: what is on disk stays usable, and bad descriptions get one line."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from mocap_files import SMPL_JOINTS, standing, write_bvh

from agents.agent import Needs
from agents.overrides import with_overrides
from agents.policy.checkpoint import load_policy, save_policy
from agents.policy.policy_agent import new_policy
from agents.policy.spec import Layout, PolicySpec
from agents.run_folder import check_same_run, data_record, only_training, plain
from agents.training.options import TrainArgs
from agents.training.presets import PRESETS
from agents.training.train_policy import MAY_DIFFER_ON_RESUME
from questsim.cli import main
from questsim.errors import InputError
from questsim.files import parse_yaml, whole_folder
from questsim.motion.spec import load_motions

STEPS = ("mkdir", "write", "rename old", "rename new", "remove old")


def write(folder: Path, text: str) -> None:
    with whole_folder(folder) as fresh:
        (fresh / "a").write_text(text)
        (fresh / "b").write_text(text)


def killed_at(folder: Path, step: int, monkeypatch) -> None:
    """Replace a folder and stop, as a kill would, before the given change of the disk."""

    class Killed(BaseException):
        pass

    left = [step]

    def counting(function):
        def call(*args, **options):
            if left[0] == 0:
                raise Killed
            left[0] -= 1
            return function(*args, **options)

        return call

    with monkeypatch.context() as patch:
        for name in ("mkdir", "write_text", "rename"):
            patch.setattr(Path, name, counting(getattr(Path, name)))
        # What is removed after an error would not be after a kill.
        patch.setattr("questsim.files.shutil.rmtree", lambda *args, **options: None)
        with pytest.raises(Killed):
            write(folder, "new")


@pytest.mark.parametrize("step", range(5))
def test_a_checkpoint_survives_a_kill_at_any_moment_of_its_replacement(tmp_path, step, monkeypatch):
    folder = tmp_path / "run" / "teacher" / "last"
    write(folder, "old")
    killed_at(folder, step, monkeypatch)
    with only_training(tmp_path / "run"):
        pass
    assert {(folder / name).read_text() for name in "ab"} in ({"old"}, {"new"})
    write(folder, "newer")
    assert (folder / "a").read_text() == "newer"
    assert sorted(p.name for p in folder.parent.iterdir()) == ["last"]


def test_a_first_checkpoint_that_was_killed_is_none(tmp_path, monkeypatch):
    folder = tmp_path / "run" / "last"
    killed_at(folder, 2, monkeypatch)
    with only_training(tmp_path / "run"):
        assert not folder.exists()


def test_a_second_training_into_one_folder_is_refused_and_told_whose_it_is(tmp_path):
    code = f"""
import sys
from pathlib import Path
from agents.run_folder import only_training
with only_training(Path({str(tmp_path)!r}) / "run"):
    print("held", flush=True)
    sys.stdin.readline()
"""
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with (
            pytest.raises(
                InputError, match=rf"another training is writing there \(process {other.pid}"
            ),
            only_training(tmp_path / "run"),
        ):
            pass
        other.communicate("\n")
    with only_training(tmp_path / "run"):
        pass
    assert not (tmp_path / "run").exists()  # nothing was written


def test_motions_that_were_moved_are_still_those_of_the_run(tmp_path):
    records = []
    for folder, height in (("one", 0.95), ("two", 0.95), ("other", 0.97)):
        (tmp_path / folder).mkdir()
        path = write_bvh(tmp_path / folder / "a.bvh", SMPL_JOINTS, standing(12, height))
        records.append(data_record(str(path), load_motions(str(path))))
    run = {"args": plain(TrainArgs(motions="one", out=tmp_path)), "data": records[0]}
    resumed = TrainArgs(motions="two", out=tmp_path)
    check_same_run(run, resumed, records[1], MAY_DIFFER_ON_RESUME, tmp_path)
    with pytest.raises(InputError, match="the motions differ from those at the start"):
        check_same_run(run, resumed, records[2], MAY_DIFFER_ON_RESUME, tmp_path)


def small_policy():
    spec = PolicySpec(("o_sim",), (), (8,), torque_head=False)
    return new_policy(spec, Layout({"o_sim": (0, 312)}))


def test_a_full_disk_is_one_line_and_the_old_checkpoint_stays(tmp_path):
    folder = tmp_path / "last"
    save_policy(folder, small_policy(), Needs(), {"steps": 1}, {"x": [1.0]})
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))  # as a disk that is full
    try:
        with pytest.raises(InputError, match="last: cannot be written"):
            save_policy(folder, small_policy(), Needs(), {"steps": 2}, {"x": [1.0] * 10_000})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert load_policy(folder).card["training"] == {"steps": 1}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["last"]


BAD_YAML = ["2001-13-45", "[" * 3000 + "]" * 3000, "9" * 5000, "a: [", "- 1"]


@pytest.mark.parametrize("text", BAD_YAML[:4], ids=["date", "deep", "digits", "open"])
def test_a_file_that_is_not_yaml_is_refused(text):
    with pytest.raises(ValueError, match="YAML"):
        parse_yaml(text)


@pytest.mark.parametrize("text", BAD_YAML, ids=["date", "deep", "digits", "open", "list"])
def test_a_bad_description_is_one_line(tmp_path, text, capsys):
    save_policy(tmp_path / "p", small_policy(), Needs(), {})
    (tmp_path / "p" / "policy.yaml").write_text(text)
    assert main(["export", "--agent", str(tmp_path / "p"), "--out", str(tmp_path / "x.onnx")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert len(error) < 900


@pytest.mark.parametrize("size", [-1, 0, 10**13, "x", 1.5])
def test_impossible_sizes_are_refused_before_anything_is_allocated(tmp_path, size):
    save_policy(tmp_path, small_policy(), Needs(), {})
    card = yaml.safe_load((tmp_path / "policy.yaml").read_text())
    card["network"]["hidden"] = [size]
    (tmp_path / "policy.yaml").write_text(yaml.safe_dump(card))
    with pytest.raises(InputError, match="hidden has"):
        load_policy(tmp_path)


@pytest.mark.parametrize(
    "assignment",
    [
        "stages.teacher.learning.minibatch=0",
        "stages.teacher.learning.rollout_steps=0",
        "stages.teacher.evaluate_every=0",
        "num_envs=-3",
        "num_envs=",
        "num_envs=" + "9" * 5000,
        "stages.teacher.learning.gamma=.nan",
        "stages.teacher.policy.hidden=[0]",
    ],
)
def test_impossible_preset_values_are_refused_and_leave_no_run(tmp_path, assignment, capsys):
    with pytest.raises(InputError, match="--set"):
        with_overrides(PRESETS["smoke"], [assignment])
    out = tmp_path / "run"
    assert main(["train", "--preset", "smoke", "--out", str(out), "--set", assignment]) == 2
    assert "--set" in capsys.readouterr().err
    assert not out.exists()


def test_messages_quote_only_a_short_part_of_the_input():
    message = str(InputError(f"there is no {'x' * 5000!r}", "y" * 5000, "z " * 5000))
    assert len(message) < 1500
    assert "x" * 201 not in message


def test_commands_that_draw_nothing_need_no_opengl(tmp_path):
    bvh = write_bvh(tmp_path / "a.bvh", SMPL_JOINTS, standing(12, 0.95))
    code = (
        "import mujoco; from envs.core import BatchSim; from questsim.cli import main\n"
        f"main(['motions', 'import', {str(bvh)!r}, '--out', {str(tmp_path / 'lib.npz')!r}])"
    )
    environment = os.environ | {"MUJOCO_GL": "osmesa", "LD_LIBRARY_PATH": str(tmp_path)}
    # Without the library, whether or not this machine has it.
    (tmp_path / "OpenGL").mkdir()
    (tmp_path / "OpenGL" / "__init__.py").write_text("raise ImportError('no OpenGL here')\n")
    path = [str(tmp_path), str(Path(__file__).parents[1])]
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=environment | {"PYTHONPATH": os.pathsep.join(path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "1 clip" in done.stdout, done.stderr
    assert (tmp_path / "lib.npz").exists()
