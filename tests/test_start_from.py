"""What a new policy takes over from an earlier one."""

from __future__ import annotations

import pytest
import torch

from agents.policy.policy_agent import new_policy
from agents.policy.spec import SPARSE_BLOCKS, Layout, PolicySpec
from agents.training.start_from import copy_actor
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


@pytest.mark.parametrize("hidden", [(6, 6), (8, 4), (8,), (8, 6, 6)])
def test_a_narrower_or_deeper_policy_cannot_start_from_another(hidden):
    with pytest.raises(InputError, match="networks do not fit"):
        copy_actor(policy(8, 6), policy(*hidden), "old")
