"""What a new policy takes over from an earlier one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch

from agents.agent import Needs
from agents.policy.checkpoint import find_policy, load_policy, save_policy
from agents.policy.policy_agent import new_policy
from agents.policy.spec import SPARSE_BLOCKS, Layout, PolicySpec
from agents.training.options import TrainArgs
from agents.training.presets import PPOConfig, preset_of
from agents.training.start_from import copy_actor, take_critic, with_networks_of_start
from envs.config import EnvConfig
from envs.layout import observation_layout
from questsim.errors import InputError


def policy(*hidden: int, balance: str = "feet"):
    layout = Layout.of(observation_layout(EnvConfig(privileged=True))).within(SPARSE_BLOCKS)
    return new_policy(PolicySpec(critic_blocks=(), hidden=hidden, balance=balance), layout)


def observations(of):
    return torch.randn(6, max(stop for _, stop in of.layout.blocks.values()))


def test_a_wider_policy_begins_with_the_actions_of_the_one_it_starts_from():
    old, new = policy(8, 6), policy(32, 6)
    copy_actor(old, new, "old")
    obs = observations(old)
    torch.testing.assert_close(new.action_mean(obs), old.action_mean(obs))


def test_new_units_learn_from_the_first_step_and_each_differently():
    old, new = policy(8, 6), policy(16, 12, balance="placement")
    copy_actor(old, new, "old")
    obs = observations(old)
    torch.testing.assert_close(new.actor(obs)[:, :36], old.actor(obs))
    new.actor(obs).square().sum().backward()
    parameters = dict(new.named_parameters())
    gradient = parameters["actor.layers.4.weight"].grad
    assert gradient is not None and bool((gradient[:, 6:].abs().sum(0) > 0).all())
    assert len(torch.unique(parameters["actor.layers.0.weight"][8:], dim=0)) == 8


def test_a_policy_that_is_trained_further_is_the_same_function_of_other_observations():
    """With statistics of the new motions it would be another one before it learnt anything."""
    old, new = policy(8, 6), policy(8, 6)
    constant = old.actor.columns[5]
    seen = observations(old)
    seen[:, constant] = 1.75
    old.update_norm(seen)
    copy_actor(old, new, "old")
    before = new.action_mean(seen)
    other = 3.0 + 5.0 * observations(old)
    for _ in range(20):
        new.update_norm(other)
    statistics = new.actor.norm
    assert statistics.mean[5].item() == pytest.approx(other[:, constant].mean().item(), abs=0.5)
    kept = [column for column in range(len(statistics.mean)) if column != 5]
    assert torch.equal(statistics.mean[kept], old.actor.norm.mean[kept])
    assert torch.equal(statistics.var[kept], old.actor.norm.var[kept])
    # The one input that was constant has statistics now, and no other changes the actions.
    new.actor.norm.mean[5], new.actor.norm.var[5] = old.actor.norm.mean[5], old.actor.norm.var[5]
    assert torch.equal(new.action_mean(seen), before)


def test_a_policy_without_statistics_gets_those_of_its_training():
    old, new = policy(8, 6), policy(8, 6)
    copy_actor(old, new, "old")
    new.update_norm(3.0 + observations(old))
    assert new.actor.norm.mean.mean().item() == pytest.approx(3.0, abs=0.5)
    assert new.held_inputs() == {}


def test_a_critic_that_is_trained_further_keeps_its_statistics(tmp_path: Path) -> None:
    layout = Layout.of(observation_layout(EnvConfig(privileged=True)))
    spec = PolicySpec(hidden=(8, 6), critic_blocks=(*SPARSE_BLOCKS, "privileged"))
    old, new = new_policy(spec, layout), new_policy(spec, layout)
    old.update_norm(observations(old))
    save_policy(tmp_path, old, Needs(), {})
    take_critic(tmp_path, new, PPOConfig(), print)
    assert old.critic is not None and new.critic is not None
    new.update_norm(3.0 + 5.0 * observations(new))
    assert torch.equal(new.critic.norm.mean, old.critic.norm.mean)
    assert torch.equal(new.critic.norm.var, old.critic.norm.var)


@pytest.mark.parametrize("hidden", [(6, 6), (8, 4), (8,), (8, 6, 6)])
def test_a_narrower_or_deeper_policy_cannot_start_from_another(hidden):
    with pytest.raises(InputError, match="networks do not fit"):
        copy_actor(policy(8, 6), policy(*hidden), "old")


def layers(args: TrainArgs, stage: str) -> tuple[int, ...]:
    preset = preset_of("cpu", args.estimates is not None)
    return with_networks_of_start(preset, args, [stage]).stages[stage].policy.hidden


def test_a_stage_has_the_balance_of_its_start_unless_another_is_set(tmp_path: Path) -> None:
    def balance(start: str, *words: str) -> str:
        folder = tmp_path / start
        save_policy(folder, policy(8, 6, balance=start), Needs(), {})
        args = TrainArgs(out=tmp_path / "run", stage="student", start=folder, set=words)
        stages = with_networks_of_start(preset_of("cpu"), args, ["student"]).stages
        return stages["student"].policy.balance

    assert balance("placement") == "placement"
    assert balance("placement", "stages.student.policy.balance=feet") == "feet"
    assert balance("none") == "feet"


@pytest.mark.parametrize("stage", ["teacher", "student", "finetune"])
def test_a_stage_has_the_layers_of_its_start_unless_others_are_set(tmp_path: Path, stage) -> None:
    start, out = tmp_path / "start", tmp_path / "run"
    save_policy(start, policy(24, 16), Needs(), {})
    args: dict[str, Any] = {"out": out, "start": start, "stage": stage}
    plain = preset_of("cpu").stages[stage].policy.hidden
    assert layers(TrainArgs(**args), stage) == (24, 16)
    assert layers(TrainArgs(out=out, stage=stage), stage) == plain
    asked = (f"stages.{stage}.policy.hidden={list(plain)}",)
    assert layers(TrainArgs(**args, set=asked), stage) == plain


def test_a_resumed_stage_keeps_its_own_layers(tmp_path: Path) -> None:
    save_policy(tmp_path / "student" / "last", policy(24, 16), Needs(), {})
    save_policy(tmp_path / "start", policy(8, 6), Needs(), {})
    args: dict[str, Any] = {"out": tmp_path, "stage": "student", "start": tmp_path / "start"}
    assert layers(TrainArgs(**args, resume=True), "student") == (24, 16)
    assert layers(TrainArgs(**args), "student") == (8, 6)


def test_a_stage_that_resumes_with_more_devices_is_compared_with_its_run(tmp_path: Path) -> None:
    """Not with what a policy may start from."""
    save_policy(tmp_path / "student" / "last", policy(24, 16), Needs(sensors="H"), {})
    args = TrainArgs(out=tmp_path, stage="student", start=Path("questsim"), resume=True)
    assert layers(args, "student") == (24, 16)


@pytest.mark.parametrize(
    ("stage", "name", "estimates"),
    [
        ("teacher", "tracker", None),
        ("student", "questsim", None),
        ("student", "questsim-headset", None),
        ("student", "questsim-now", None),
        ("finetune", "questsim", None),
        ("student", "tracker", "library.npz"),
        ("finetune", "estimate-tracker", "library.npz"),
    ],
)
def test_every_shipped_policy_can_be_trained_further_with_the_plain_command(
    tmp_path: Path, stage: Any, name: str, estimates: str | None
) -> None:
    shipped = load_policy(find_policy(name))
    sensors, frames = shipped.needs.sensors, shipped.needs.future_frames
    args = TrainArgs(
        out=tmp_path, stage=stage, start=Path(name), estimates=estimates,
        sensors=sensors, future_frames=frames,
    )  # fmt: skip
    preset = with_networks_of_start(preset_of("cpu", estimates is not None), args, [stage])
    spec = preset.stages[stage].policy
    config = EnvConfig(sensors=sensors, future_frames=frames, privileged=True)
    new = new_policy(spec, Layout.of(observation_layout(config)))
    copy_actor(shipped.policy, new, name)
    assert new.spec.hidden == shipped.policy.spec.hidden
