"""The command line as a user meets it: help, exit codes, and one clear line for bad input."""

import subprocess
import sys
import time

import pytest
from command_line import questsim

from questsim import __version__, cli
from questsim.errors import InputError
from questsim.waiting import said_if_slow


def test_help_lists_every_command(capsys):
    assert cli.main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(f"questsim {name}" in out for name in cli.COMMANDS)


def test_help_and_the_catalogue_import_neither_torch_nor_mujoco():
    code = """
import sys
from questsim.cli import main
main(["--help"])
main(["agents"])
sys.exit(bool({"torch", "mujoco", "numpy"} & set(sys.modules)))
"""
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_options_of_every_command_come_without_what_takes_long_to_load():
    code = """
import sys
from questsim.cli import COMMANDS
from questsim.lazy import imported
for command in COMMANDS.values():
    imported(command.args)
slow = {"torch", "numba", "scipy.spatial", "scipy.stats", "matplotlib", "viser"}
sys.exit(", ".join(slow & set(sys.modules)) or 0)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_terminal_is_told_before_a_command_loads_what_takes_seconds(monkeypatch, capsys):
    monkeypatch.delitem(sys.modules, "questsim.compare_runs_command", raising=False)
    words = ["compare-runs", "nowhere", "elsewhere"]
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    assert cli.main(words) == 2
    assert capsys.readouterr().err.startswith("loading ...\nerror: nowhere")
    assert cli.main(words) == 2  # it is loaded now
    assert capsys.readouterr().err.startswith("error: nowhere")


@pytest.mark.parametrize("value", ["inf", "-inf", "nan"])
@pytest.mark.parametrize(
    "words",
    [
        "train --out x --minutes", "train --out x --heights 1.5", "train --out x --pushes 0",
        "train --agent lgsik --out x --minutes", "demo --seconds", "live --height",
        "evaluate --unscaled",
    ],
)  # fmt: skip
def test_a_number_that_is_not_finite_is_refused_for_every_option(words, value, capsys):
    option = next(word for word in reversed(words.split()) if word.startswith("--"))
    assert cli.main([*words.split(), value]) == 2
    error = capsys.readouterr().err
    assert "not a finite number" in error and option in error and error.count("\n") == 1


@pytest.mark.parametrize(
    "words",
    [
        "evaluate --by-group --out x --under", "evaluate --objects --seeds 2",
        "evaluate --scorecard --rows", "train --out x --set", "ship --run x --name y --metrics",
        "evaluate --video-clips --out x",
    ],
)  # fmt: skip
def test_an_option_without_its_values_is_refused(words, capsys):
    assert cli.main(words.split()) == 2
    error = capsys.readouterr().err
    assert ": needs a value; see questsim" in error and error.count("\n") == 1


def test_version_is_the_packages(capsys):
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"questsim {__version__}\n"


def test_no_command_prints_the_help_and_is_an_error(capsys):
    assert cli.main([]) == 2
    assert "questsim train" in capsys.readouterr().out


@pytest.mark.parametrize("words", [["fly"], ["fly", "--help"], ["motions"], ["motions", "fly"]])
def test_unknown_command_is_refused_in_one_line(words, capsys):
    assert cli.main(words) == 2
    error = capsys.readouterr().err
    asked = " ".join(word for word in words if word != "--help")
    assert error.startswith(f"error: no command {asked!r};") and error.count("\n") == 1
    assert "motions import" in error


def test_guard_prints_an_input_error_as_one_line(capsys):
    def refuse():
        raise InputError("MOTION block ends\nafter 12 of 273 frames", "walk.bvh", "fetch it again")

    assert cli.guarded(refuse) == 2
    expected = "error: walk.bvh: MOTION block ends after 12 of 273 frames; fetch it again\n"
    assert capsys.readouterr().err == expected


def test_guard_names_the_file_that_the_system_refuses(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    path = tmp_path / "file" / "below"
    assert cli.guarded(path.read_text) == 2
    assert capsys.readouterr().err == f"error: {path}: Not a directory\n"


def test_guard_lets_bugs_through():
    def bug():
        raise KeyError("bug")

    with pytest.raises(KeyError):
        cli.guarded(bug)


def test_guard_reports_ctrl_c_as_shells_do(capsys):
    def interrupt():
        raise KeyboardInterrupt

    assert cli.guarded(interrupt) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_guard_passes_exit_codes_on():
    assert cli.guarded(lambda: None) == 0
    assert cli.guarded(lambda: 3) == 3


def test_reader_that_stops_early_is_no_error():
    code = """
import sys
from questsim.cli import guarded
sys.exit(guarded(lambda: [print("line") for _ in range(100000)]))
"""
    pipe = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert pipe.stdout and pipe.stderr
    pipe.stdout.readline()
    pipe.stdout.close()
    assert pipe.stderr.read() == b""
    assert pipe.wait() == 0


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_command_explains_its_options(name, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    attempt = questsim(tmp_path, *name.split(), "--help")
    assert attempt.code == 0, attempt.err
    assert f"questsim {name}" in attempt.out
    assert "default: None" not in " ".join(attempt.out.split()) and "{None" not in attempt.out


def test_the_module_is_a_command_too():
    words = [sys.executable, "-m", "questsim", "--version"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, f"questsim {__version__}\n")


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        ("evaluate --agent questim", "questsim"),
        ("evaluate --compare --agents hmdpose --out x", "hmdposer"),
        ("evaluate --terrain rouh", "rough"),
        ("evaluate --motions synthetic:wlak", "walk"),
        ("evaluate --motions sinthetic", "synthetic"),
        ("envs --name QuestSimStars-v0", "QuestSimStairs-v0"),
        ("trian", "train"),
    ],
)
def test_a_misspelt_name_is_answered_with_the_one_that_it_is_like(
    words, meant, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert cli.main(words.split()) == 2
    error = capsys.readouterr().err
    assert f"did you mean {meant}? " in error and error.count("\n") == 1
    assert not any(tmp_path.iterdir())


def test_a_terminal_hears_of_slow_work_and_a_pipe_does_not(monkeypatch, capsys):
    def work(seconds):
        with said_if_slow("making clips ...", after_s=0.05):
            time.sleep(seconds)
        return capsys.readouterr().err

    assert work(0.5) == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    assert work(0.5) == "making clips ...\n"
    assert work(0.0) == ""
