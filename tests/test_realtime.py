"""The benchmark of one avatar on one core measures what it says."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from agents.policy.policy_agent import PolicyAgent, new_policy
from agents.policy.spec import TRACKER_BLOCKS, Layout, PolicySpec
from benchmarks.realtime import measure, numpy_forward, untrained
from envs.config import EnvConfig
from envs.layout import observation_layout, observation_size


def test_untrained_policy_of_the_presets_size_is_measured():
    figures = measure(untrained(), steps=40, repeats=1)
    parts = figures["policy_us"] + figures["observation_and_physics_us"]
    assert figures["times_real_time"] == pytest.approx(1e6 / 36.0 / parts, rel=1e-6)
    # A busy machine is slower than the goal only if something is badly wrong.
    assert figures["times_real_time"] > 2.0


@pytest.mark.parametrize("activation", ["tanh", "elu", "silu"])
@pytest.mark.parametrize("teacher", [False, True])
def test_numpy_arithmetic_is_the_policys(activation, teacher):
    torch.manual_seed(0)
    layout = observation_layout(EnvConfig(privileged=teacher))
    blocks = {"actor_blocks": TRACKER_BLOCKS, "reference_head": True} if teacher else {}
    spec = PolicySpec(critic_blocks=(), hidden=(16, 8), activation=activation, **blocks)
    policy = new_policy(spec, Layout.of(layout), gains=np.linspace(0.1, 0.5, 33))
    policy.actor.norm.mean.normal_()
    policy.actor.norm.var.uniform_(0.5, 2.0)
    agent = PolicyAgent(policy, untrained().needs)
    obs = np.random.default_rng(0).normal(size=(4, observation_size(layout))).astype(np.float32)
    np.testing.assert_allclose(numpy_forward(agent)(obs), agent.act(obs), atol=1e-5)
