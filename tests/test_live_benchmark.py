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
        (["--motions", STEPS, "--users", "-1"], "--users: -1 is below 0"),
    ],
)
def test_options_without_an_effect_are_refused(monkeypatch, options, fault):
    monkeypatch.setattr(sys, "argv", ["live", *options])
    with pytest.raises(InputError, match=fault):
        live.main()


def test_too_few_clips_to_choose_from_are_refused():
    moving = [clip for clip in synthetic_clips() if clip.name == "synthetic-jog-2"]
    rest = [clip for clip in synthetic_clips() if clip.name == "synthetic-walk-1.2-start-stop"]
    with pytest.raises(InputError, match="1 of 2 clips can be performed from rest"):
        live.several_users("questsim", [*moving, *rest], 1, 0.0)
    with pytest.raises(InputError, match="0 of 1 clips"):
        live.all_statures("questsim", moving, 1, 0.0)
