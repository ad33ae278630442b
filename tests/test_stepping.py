"""Foot placement in the torque head: what it computes, and that it follows steps untrained."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import torch

from agents.agent import Needs
from agents.evaluation.follow import evaluation_sim, follow
from agents.policy.balance import SIZE, Balance
from agents.policy.networks import TorquePolicy
from agents.policy.policy_agent import PolicyAgent, head_alone
from agents.policy.spec import TRACKER_BLOCKS, Layout, PolicySpec
from agents.training.start_from import copy_actor, copy_head
from envs.config import EnvConfig
from envs.core import BatchSim
from envs.layout import observation_layout
from envs.starts import Starts
from questsim import rotations
from questsim.body import build_body
from questsim.motion.spec import load_motions
from questsim.skeleton import FOOT_LINKS

STEPS = ("side-left", "side-right", "shuffle", "cross-step", "step-back", "backwards")
PRIVILEGED = EnvConfig(privileged=True, fixed_start=True)


def untrained(balance: str) -> TorquePolicy:
    spec = PolicySpec(TRACKER_BLOCKS, (), (8,), reference_head=True, balance=balance)
    return head_alone(spec, Layout.of(observation_layout(PRIVILEGED)))


def test_a_foot_in_swing_is_pulled_as_by_a_force_and_one_that_stands_is_not():
    disturbed = Starts(disturbed=1.0, joints_rad=0.2)
    clips = load_motions("synthetic:walk")[:2]
    sim = BatchSim(clips, replace(PRIVILEGED, starts=disturbed))
    sim.reset()
    sim.contact_force[:, :, 2] = [[0.0, 700.0], [350.0, 350.0]]
    sim._runner.observe(np.arange(2))
    balance = Balance(Layout.of(sim.layout), "steps")
    terms = balance.terms(torch.from_numpy(sim.observation)).numpy()
    to_place = terms[:, SIZE + 12 : SIZE + 24]
    assert not to_place[0, 6:].any()
    assert not to_place[1].any()
    np.testing.assert_allclose(terms[:, -2:], [[1.0, 0.0], [0.0, 0.0]])

    model = build_body().model
    data = mujoco.MjData(model)
    data.qpos[:] = sim.qpos[0]
    mujoco.mj_forward(model, data)
    jacobian = np.zeros((3, model.nv))
    left = FOOT_LINKS[0]
    mujoco.mj_jac(model, data, jacobian, None, data.xpos[1 + left], 1 + left)
    missing = clips[0].link_position[0, left] - sim.link_positions[0, left]
    force = model.body_mass.sum() * missing * [1.0, 1.0, 0.0]
    expected = (jacobian[:, 6:12].T @ force) / build_body().torque_limits[:6]
    np.testing.assert_allclose(to_place[0, :6], expected, atol=1e-4)

    # A student's network asks for the same force; a foot that stands gets none.
    student = Balance(Layout.of(sim.layout), "placement")
    rows = student.terms(torch.from_numpy(sim.observation))
    wanted = np.zeros((2, 10), np.float32)
    yaw = rotations.heading(sim.qpos[0, 3:7])
    turned = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    wanted[:, 3:5] = wanted[:, 5:7] = turned @ missing[:2]
    with torch.no_grad():
        legs = (student(rows, torch.from_numpy(wanted)) - student(rows)).numpy()
    np.testing.assert_allclose(legs[0, :6], expected, atol=1e-4)
    assert not legs[0, 6:].any()
    assert not legs[1].any()


def test_with_nothing_learnt_it_follows_steps_that_balance_alone_does_not():
    clips = [clip for clip in load_motions("synthetic") if clip.kind in STEPS]
    sim = evaluation_sim(clips, PRIVILEGED)
    frames = {}
    for balance in ("reference", "steps"):
        agent = PolicyAgent(untrained(balance), Needs(privileged=True))
        agent.bind(sim)
        followed = follow(agent, sim, clips)
        frames[balance] = float((followed.frames / followed.length).mean())
    assert frames["steps"] > frames["reference"] + 0.3


def test_a_teacher_with_balance_alone_can_be_trained_on_with_foot_placement():
    old, new = untrained("reference"), untrained("steps")
    with torch.no_grad():
        assert old.head is not None and old.head.balance is not None
        old.head.balance.log_kp.fill_(5.0)
        old.head.log_gain.fill_(-1.0)
    first = {k: v.clone() for k, v in new.state_dict().items() if "balance" in k}
    copy_actor(old, new, "old")  # type: ignore[arg-type]
    assert new.head is not None and bool((new.head.log_gain == -1.0).all())
    for name, value in first.items():
        torch.testing.assert_close(new.state_dict()[name], value)
    # Between heads of one kind, everything means the same.
    taught = untrained("steps")
    with torch.no_grad():
        new.head.log_gain.fill_(-2.0)
        new.head.balance.log_kp.fill_(3.0)  # type: ignore[union-attr]
        new.head.balance.stepping.log_place.fill_(1.5)  # type: ignore[union-attr]
    copy_head(new, taught)
    assert taught.head is not None
    for name, value in new.head.state_dict().items():
        torch.testing.assert_close(taught.head.state_dict()[name], value)
