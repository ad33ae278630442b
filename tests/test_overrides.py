"""Changing single values of a preset."""

from __future__ import annotations

import pytest

from agents.overrides import overridden, refuse_repeated, with_overrides
from agents.training.presets import CPU, DaggerConfig, PPOConfig
from questsim.errors import InputError


def test_values_deep_in_a_preset_change_and_nothing_else() -> None:
    changed = with_overrides(
        CPU,
        ["stages.teacher.learning.desired_kl=0.06", "stages.teacher.policy.hidden=[64, 32]",
         "stages.student.learning.capacity=1000", "num_envs=8"],
    )  # fmt: skip
    teacher = changed.stages["teacher"]
    assert isinstance(teacher.learning, PPOConfig) and teacher.learning.desired_kl == 0.06
    assert teacher.policy.hidden == (64, 32) and changed.num_envs == 8
    student = changed.stages["student"].learning
    assert isinstance(student, DaggerConfig) and student.capacity == 1000
    assert changed.stages["finetune"] == CPU.stages["finetune"]
    assert CPU.num_envs == 256


def test_numbers_may_be_written_with_an_exponent_alone() -> None:
    changed = with_overrides(
        CPU,
        ["stages.teacher.learning.learning_rate=6e-5", "stages.finetune.learning.final_kl=1e-3"],
    )
    teacher, finetune = (changed.stages[name].learning for name in ("teacher", "finetune"))
    assert isinstance(teacher, PPOConfig) and teacher.learning_rate == 6e-5
    assert isinstance(finetune, PPOConfig) and finetune.final_kl == 1e-3


def test_a_warm_up_can_be_turned_off_where_the_preset_has_one() -> None:
    changed = with_overrides(CPU, ["stages.teacher.learning.critic_warmup_steps=0"])
    teacher = changed.stages["teacher"].learning
    assert isinstance(teacher, PPOConfig) and teacher.critic_warmup_steps == 0


def test_a_later_assignment_replaces_an_earlier_one_only_where_it_is_meant_to() -> None:
    given = ["num_envs=8", "minutes=2"]
    assert overridden(given, ["num_envs=4"]) == ("minutes=2", "num_envs=4")
    refuse_repeated(given)
    with pytest.raises(InputError, match="--set minutes: is given twice"):
        refuse_repeated([*given, "minutes=3"])


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("num_envs", "not path=value"),
        ("stages.pupil.share=1", "no 'pupil'.*teacher"),
        (
            "stages.teacher.learning.gamma=7",
            "--set stages.teacher.learning.gamma: .* 7, not 0 to 1",
        ),
        ("stages.teacher.policy.activation=q", "activation: unknown activation 'q'; use tanh, elu"),
        ("num_envs=many", "'many' is not of type int"),
        ("stages.teacher.learning=3", "names a group"),
        ("num_envs.x=3", "no 'x'"),
        ("num_envs=[", "not a YAML value"),
        ("stages.finetune.learning.final_kl=low", "'low' is not a number"),
    ],
)
def test_values_that_do_not_fit_are_refused_with_their_path(assignment: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        with_overrides(CPU, [assignment])
