"""The mean of the weights of policies of one training."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from agents.agent import Needs
from agents.policy.average import AVERAGED, KEPT, AverageArgs, average_policies
from agents.policy.checkpoint import load_policy, read_card, save_policy
from agents.policy.policy_agent import new_policy
from agents.policy.spec import Layout, PolicySpec
from questsim.errors import InputError


def saved(folder: Path, value: float, steps: int, preset: str = "cpu") -> Path:
    """A checkpoint whose weights all have one value."""
    spec = PolicySpec(("o_sim",), (), (8,), torque_head=False)
    policy = new_policy(spec, Layout({"o_sim": (0, 312)}))
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.fill_(value)
    record = {"preset": preset, "steps": steps, "minutes": 0.1, "evaluation": {"tracked": 0.5}}
    save_policy(folder, policy, Needs(), record)
    return folder


def test_the_average_is_the_mean_of_the_weights_and_says_of_which_policies(tmp_path: Path) -> None:
    later, earlier = saved(tmp_path / "b", 4.0, 300_000), saved(tmp_path / "a", 1.0, 100_000)
    assert average_policies(AverageArgs((later, earlier), tmp_path / "mean")) == 0
    policy = load_policy(tmp_path / "mean").policy
    assert all(torch.all(p == 2.5) for p in policy.actor.parameters())
    training = read_card(tmp_path / "mean")["training"]
    assert training[AVERAGED] == [100_000, 300_000] and training["steps"] == 300_000
    assert "evaluation" not in training  # it was of one of them


def test_a_stage_folder_stands_for_what_it_kept_but_its_begin(tmp_path: Path) -> None:
    for steps in (0, 10, 20):
        saved(tmp_path / KEPT / f"{steps:012d}", float(steps), steps)
    average_policies(AverageArgs((tmp_path,), tmp_path / "mean"))
    assert read_card(tmp_path / "mean")["training"][AVERAGED] == [10, 20]


@pytest.mark.parametrize(
    ("case", "says"),
    [
        ("one", "there is 1 policy to average"),
        ("twice", "names a policy twice"),
        ("copy", "two policies of the same number of steps"),
        ("other", "is of another training"),
        ("there", "exists already"),
        ("unstated", "does not state the steps"),
    ],
)
def test_policies_that_cannot_be_averaged_are_refused_and_nothing_is_written(
    tmp_path: Path, case: str, says: str
) -> None:
    a, b = saved(tmp_path / "a", 1.0, 1), saved(tmp_path / "b", 2.0, 2)
    if case == "other":
        b = saved(tmp_path / "c", 2.0, 2, preset="smoke")
    if case == "unstated":
        save_policy(b, load_policy(b).policy, Needs(), {})
    if case == "copy":
        b = saved(tmp_path / "d", 1.0, 1)
    if case == "twice":
        b = tmp_path / "." / "a"
    out = a if case == "there" else tmp_path / "mean"
    with pytest.raises(InputError, match=says):
        average_policies(AverageArgs((a,) if case == "one" else (a, b), out))
    assert not (tmp_path / "mean").exists() and load_policy(a).card["training"]["steps"] == 1
