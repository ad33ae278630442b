"""Trainings that learn variations beside their motions, drawn anew every so often."""

import numpy as np
import pytest
import torch
from helpers import swaying_clip

from agents.policy.checkpoint import load_resume
from agents.training import train_policy as training
from agents.training.fresh_motions import DRAW, FreshMotions
from agents.training.options import TrainArgs
from agents.training.train_policy import train
from envs import QuestVecEnv
from envs.config import EnvConfig
from questsim.errors import InputError

CLIPS = [swaying_clip("short", frames=72), swaying_clip("long", frames=110)]


@pytest.fixture
def clips(monkeypatch):
    torch.set_num_threads(1)
    monkeypatch.setattr(training, "load_clips", lambda args: CLIPS)


def tiny(out, **options) -> TrainArgs:
    given = {"preset": "smoke", "stage": "teacher", "steps": 256, "envs": 8, "threads": 1}
    return TrainArgs(out=out, **(given | options))


def test_the_share_of_variations_is_that_asked_for_and_each_draw_is_another(monkeypatch):
    fresh = FreshMotions(CLIPS, share=0.6, every=100, seed=0)
    first, second = fresh.at(0), fresh.at(1)
    assert len(first) == len(second) == 5
    assert first[:2] == second[:2] == CLIPS
    assert {clip.name for clip in first[2:]}.isdisjoint(clip.name for clip in second[2:])
    assert [clip.source for clip in fresh.at(1)] == [clip.source for clip in second]
    monkeypatch.setattr("agents.training.fresh_motions.PART", 2)  # of three
    shared = fresh.at(1, lambda function, jobs: [function(job) for job in jobs])
    assert all(np.array_equal(a.qpos, b.qpos) for a, b in zip(shared, second, strict=True))
    assert [fresh.number(steps) for steps in (0, 99, 100, 250)] == [0, 0, 1, 2]


def test_an_environment_goes_on_with_other_clips():
    env = QuestVecEnv(CLIPS[:1], EnvConfig(), num_envs=3, seed=0)
    env.reset()
    env.change_clips(CLIPS[1:], seed=1)
    assert env.reset().shape == (3, env.observation_space.shape[0])  # type: ignore
    assert env.sim.reference.names == ("long",)
    env.close()


def test_variations_change_while_a_training_goes_on_and_when_it_is_resumed(clips, tmp_path):
    options = {"vary": 0.5, "redraw": 256}
    train(tiny(tmp_path / "whole", steps=512, **options))
    train(tiny(tmp_path / "parts", **options))
    assert load_resume(tmp_path / "parts" / "teacher" / "last")[DRAW] == 0
    train(tiny(tmp_path / "parts", steps=512, resume=True, **options))
    whole, parts = (load_resume(tmp_path / run / "teacher" / "last") for run in ("whole", "parts"))
    assert whole[DRAW] == parts[DRAW] == 1
    for name, tensor in whole["learner"]["policy"].items():
        assert torch.equal(tensor, parts["learner"]["policy"][name]), name
    with pytest.raises(InputError, match=r"--vary was 0\.5, not 0\.2"):
        train(tiny(tmp_path / "parts", steps=768, resume=True, vary=0.2, redraw=256))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"vary": 1.0}, "--vary: is 1, not 0 to 0.95"),
        ({"vary": -0.1}, "--vary: is -0.1, not 0 to 0.95"),
        ({"redraw": 1000}, "--redraw: does nothing without --vary"),
        ({"vary": 0.5, "redraw": 0}, "--redraw: is 0, not at least 1"),
    ],
)
def test_shares_out_of_range_are_refused_and_leave_no_run(clips, tmp_path, options, message):
    with pytest.raises(InputError, match=message):
        train(tiny(tmp_path / "run", **options))
    assert not (tmp_path / "run").exists()


def test_variations_of_clips_too_short_are_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(training, "load_clips", lambda args: [swaying_clip("brief", frames=20)])
    with pytest.raises(InputError, match=r"brief: lasts 0\.53 s"):
        train(tiny(tmp_path / "run", vary=0.5))
