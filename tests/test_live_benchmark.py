"""Options of ``benchmarks.live``: those without an effect, and clips that do not suffice."""

import sys

import pytest

from benchmarks import live
from questsim.errors import InputError
from questsim.motion.synthesis.synthetic import synthetic_clips

STEPS = "synthetic:walk+stand"


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        (["--users", "2"], "--users, --statures: need clips"),
        (["--statures", "2"], "--users, --statures: need clips"),
        (["--clips", "3"], "--clips: has no effect alone"),
        (["--rest", "1"], "--rest: has no effect alone"),
        (["--motions", STEPS, "--minutes", "1"], "--minutes: has no effect beside --motions"),
        (["--motions", STEPS, "--users", "2", "--clips", "3"], "--clips: has no effect beside"),
        (["--motions", STEPS, "--users", "2", "--statures", "3"], "--statures: has no effect"),
        (["--motions", STEPS, "--statures", "3", "--rest", "1"], "beside --statures"),
        (["--motions", STEPS, "--users", "-1"], "--users: is -1, not 0 or more"),
        (["--motions", STEPS, "--rest", "2"], "--rest: is 2, not 0 to 1"),
        (["--motions", STEPS, "--clips", "0"], "--clips: is 0, not 1 to"),
        (["--minutes", "0"], "--minutes: is 0, not 1 to"),
        (["--motions", "synthetic:jog", "--rest", "1"], "none of 7 clips begins at rest"),
    ],
)
def test_options_without_an_effect_are_refused(monkeypatch, options, fault):
    monkeypatch.setattr(sys, "argv", ["live", *options])
    with pytest.raises(InputError, match=fault):
        live.main()


@pytest.mark.parametrize("options", [["--minutes", "1.5"], ["--minutes"], ["--fast"]])
def test_options_that_cannot_be_read_are_refused_in_one_line(monkeypatch, capsys, options):
    monkeypatch.setattr(sys, "argv", ["live", *options])
    with pytest.raises(SystemExit) as end:
        live.main()
    error = capsys.readouterr().err
    assert end.value.code == 2
    assert error.startswith("error: ") and error.count("\n") == 1 and options[0] in error


def test_too_few_clips_to_choose_from_are_refused():
    moving = [clip for clip in synthetic_clips() if clip.name == "synthetic-jog-2"]
    rest = [clip for clip in synthetic_clips() if clip.name == "synthetic-walk-1.2-start-stop"]
    with pytest.raises(InputError, match="1 of 2 clips can be performed from rest"):
        live.several_users("questsim", [*moving, *rest], 1, 0.0)
    with pytest.raises(InputError, match="0 of 1 clips"):
        live.all_statures("questsim", moving, 1, 0.0)
