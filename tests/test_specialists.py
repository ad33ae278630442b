"""Specialists: teachers that are asked for some kinds of motion only."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from command_line import questsim
from test_shipping import add_stage, data, new_run

from agents import load_agent
from agents.evaluation.rollout import env_config
from agents.policy.policy_agent import PolicyAgent
from agents.shipping.ship import ShipArgs, ship
from agents.training.specialists import Teachers, read_specialist
from envs import QuestVecEnv
from questsim.errors import InputError
from questsim.motion.spec import load_motions

SMOKE = ("--preset", "smoke", "--stage", "student", "--teacher", "tracker", "--threads", 1)


def test_each_avatar_gets_the_label_of_its_clips_teacher() -> None:
    general, special = load_agent("tracker"), load_agent("tracker")
    assert isinstance(general, PolicyAgent)
    assert isinstance(special, PolicyAgent)
    with torch.no_grad():
        for parameter in special.policy.actor_parameters():
            parameter.mul_(0.5)
    clips = load_motions("synthetic:stand+squat")
    clips = [*clips, replace(clips[-1], kind="squat+reach")]
    config = replace(env_config(general), fixed_start=False)
    env = QuestVecEnv(clips, config, 8, seed=3)
    general.bind(env)
    special.bind(env)
    observations = torch.from_numpy(np.asarray(env.reset()))
    teachers = Teachers(general, [(special, ("s?uat",))], env)
    with torch.no_grad():
        labels = teachers.action_mean(observations)
        of_each = [agent.policy.action_mean(observations) for agent in (general, special)]
    kinds = [env.sim.reference.kinds[clip] for clip in env.sim.clip]
    squats = np.array([kind in ("squat", "squat+reach") for kind in kinds])
    assert {"stand", "squat+reach"} <= set(kinds)
    expected = torch.where(torch.from_numpy(squats)[:, None], of_each[1], of_each[0])
    torch.testing.assert_close(labels, expected, rtol=1e-4, atol=1e-5)
    with pytest.raises(InputError, match=r"no clip is of a kind 'hop'.*squat, squat\+reach, stand"):
        Teachers(general, [(special, ("hop",))], env)
    env.close()


def test_without_kinds_each_clip_has_the_teacher_that_follows_it_best() -> None:
    general = load_agent("tracker")
    assert isinstance(general, PolicyAgent)
    limp = load_agent("tracker")
    assert isinstance(limp, PolicyAgent)
    assert limp.policy.head is not None
    with torch.no_grad():
        limp.policy.head.log_gain.sub_(5.0)
        limp.policy.actor.layers[-1].weight.zero_()  # pyright: ignore
    env = QuestVecEnv(load_motions("synthetic:stand"), env_config(general), 2, seed=3)
    general.bind(env)
    limp.bind(env)
    count = len(env.clips)
    assert Teachers(general, [(limp, ())], env).clips_of_each() == [count, 0]
    assert Teachers(limp, [(general, ())], env).clips_of_each() == [0, count]
    env.close()


@pytest.mark.parametrize("text", ["", "tracker:", ":walk", "tracker:walk++run"])
def test_a_specialist_without_name_or_with_empty_kinds_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"FOLDER:KIND\+KIND"):
        read_specialist(text)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((*SMOKE, "--workers", 2), "does not go with --workers"),
        (("--preset", "smoke", "--stage", "teacher"), "does not go with --stage teacher"),
        (("--preset", "paper"), "does not go with --preset paper"),
        (("--preset", "smoke", "--specialists", "tracker:walk"), "no clip is of a kind 'walk'"),
    ],
)
def test_invalid_specialists_are_refused_and_leave_no_run(
    tmp_path: Path, words: tuple[object, ...], message: str
) -> None:
    run = questsim(
        tmp_path, "train", "--motions", "synthetic:stand", "--out", "mine",
        "--specialists", "tracker:stand", *words,
    )  # fmt: skip
    assert run.code == 2
    assert message in run.err
    assert not run.left


def test_a_student_learns_from_a_specialist_and_its_record_says_so(tmp_path: Path) -> None:
    run = questsim(
        tmp_path, "train", *SMOKE, "--motions", "synthetic:stand", "--steps", 64, "--envs", 4,
        "--out", "mine", "--specialists", "tracker:st*",
    )  # fmt: skip
    assert run.code == 0, run.err
    record = yaml.safe_load((tmp_path / "mine" / "run.yaml").read_text())
    assert record["args"]["specialists"] == ["tracker:st*"]
    assert set(record["behind"]) == {"teacher", "tracker:st*"}


def test_a_student_learns_from_a_student_of_more_devices(tmp_path: Path) -> None:
    words = (
        "train", "--preset", "smoke", "--stage", "student", "--threads", 1, "--sensors", "H",
        "--future-frames", 0, "--motions", "synthetic:stand", "--steps", 64, "--envs", 4,
        "--out", "mine", "--teacher", "questsim",
    )  # fmt: skip
    run = questsim(tmp_path, *words, "--specialists", "questsim-headset:stand")
    assert run.code == 2
    assert "neither the student's devices nor those of the first teacher" in run.err
    run = questsim(tmp_path, *words)
    assert run.code == 0, run.err
    student = load_agent(str(tmp_path / "mine"))
    assert (student.needs.sensors, student.needs.future_frames) == ("H", 0)


def test_a_card_has_the_trainings_of_the_specialists(tmp_path: Path) -> None:
    record, steps = data(), data("bandai-namco-2:train", **{"CC-BY-NC-4.0": 10})
    teacher = new_run(tmp_path / "general", record)
    add_stage(teacher, "teacher", record, 2_000_000, 20.0)
    special = new_run(tmp_path / "steps", steps, stage="teacher")
    add_stage(special, "teacher", steps, 1_000_000, 10.0)
    student = new_run(
        tmp_path / "student", record, stage="student", teacher=teacher,
        specialists=(f"{special}:side-*",),
    )  # fmt: skip
    add_stage(student, "student", record, 1_000_000, 10.0)
    ship(ShipArgs(student, "walker", into=tmp_path / "weights"))
    card = (tmp_path / "weights" / "walker" / "README.md").read_text()
    assert "| licence | CC-BY-NC-4.0 |" in card
    assert card.count("--stage teacher") == 2
    assert "--specialists runs/steps:side-*" in card.replace("'", "")
