"""Balance as a term of the torque head: what it computes, and that it keeps an avatar upright."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from agents.agent import Needs
from agents.evaluation.follow import evaluation_sim, follow
from agents.policy.balance import FLIGHT, OUTPUTS, STANDING, Balance
from agents.policy.networks import TorquePolicy
from agents.policy.policy_agent import PolicyAgent, head_alone, new_policy
from agents.policy.spec import SPARSE_BLOCKS, TRACKER_BLOCKS, Layout, PolicySpec
from agents.training.start_from import copy_actor
from envs.config import EnvConfig
from envs.core import BatchSim
from envs.layout import observation_layout
from envs.starts import Starts
from questsim.body import build_body
from questsim.errors import InputError
from questsim.motion.spec import load_motions
from questsim.skeleton import FOOT_LINKS

PRIVILEGED = EnvConfig(privileged=True, fixed_start=True)
WALKS = load_motions("synthetic:walk")[:3]


def teacher(balance: str) -> TorquePolicy:
    spec = PolicySpec(TRACKER_BLOCKS, (), (8,), reference_head=True, balance=balance)
    return head_alone(spec, Layout.of(observation_layout(PRIVILEGED)))


def balance_of(sim: BatchSim, reference: bool) -> Balance:
    return Balance(Layout.of(sim.layout), "reference" if reference else "feet")


@pytest.fixture(scope="module")
def walking() -> BatchSim:
    """Avatars of several statures, pushed off their reference, with both feet's forces known."""
    disturbed = Starts(disturbed=1.0, joints_rad=0.2)
    config = replace(PRIVILEGED, starts=disturbed, heights=(1.5, 1.9))
    sim = BatchSim(WALKS, config)
    sim.reset()
    sim.contact_force[:, :, 2] = [[300.0, 100.0], [0.0, 700.0], [250.0, 0.0]]
    sim._runner.observe(np.arange(3))
    return sim


def in_s(sim: BatchSim, i: int, vector: np.ndarray) -> np.ndarray:
    """A world vector in the heading frame of avatar ``i``."""
    w, x, y, z = sim.qpos[i, 3:7]
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([c * vector[0] + s * vector[1], c * vector[1] - s * vector[0], vector[2]])


def test_the_legs_torques_are_those_of_mujocos_jacobian(walking):
    terms = balance_of(walking, True).terms(torch.from_numpy(walking.observation))
    basis = terms[:, :36].reshape(-1, 12, 3).numpy()
    mass = 70.0
    for i, height in enumerate(walking.heights):
        model = build_body(float(height)).model
        data = mujoco.MjData(model)
        data.qpos[:] = walking.qpos[i]
        mujoco.mj_forward(model, data)
        load = walking.contact_force[i, :, 2] / (
            walking.contact_force[i, :, 2].sum() + FLIGHT * mass * 9.81
        )
        for foot in range(2):
            jacobian = np.zeros((3, model.nv))
            link = 1 + FOOT_LINKS[foot]
            mujoco.mj_jac(model, data, jacobian, None, data.subtree_com[1], link)
            legs = slice(6 * foot, 6 * foot + 6)
            for k, axis in enumerate(np.eye(3)):
                column = jacobian[:, 6:][:, legs]
                along = np.stack([in_s(walking, i, column[:, j]) for j in range(6)], axis=1)
                torque = -(along.T @ axis) * load[foot] * model.body_mass.sum()
                expected = torque / build_body(float(height)).torque_limits[legs]
                np.testing.assert_allclose(basis[i, legs, k], expected, atol=2e-5)


def test_errors_are_those_of_the_whole_bodys_centre_of_mass(walking):
    balance = balance_of(walking, True)
    terms = balance.terms(torch.from_numpy(walking.observation)).numpy()
    for i, height in enumerate(walking.heights):
        model = build_body(float(height)).model
        clip = WALKS[i].scaled(float(height))
        wanted, moves = mujoco.MjData(model), mujoco.MjData(model)
        wanted.qpos[:], wanted.qvel[:] = clip.qpos[0], clip.qvel[0]
        moves.qpos[:], moves.qvel[:] = walking.qpos[i], walking.qvel[i]
        for data in (wanted, moves):
            mujoco.mj_forward(model, data)
            mujoco.mj_subtreeVel(model, data)
        speed = wanted.subtree_linvel[1] - moves.subtree_linvel[1]
        place = wanted.subtree_com[1] - moves.subtree_com[1] + wanted.subtree_linvel[1] / 72
        # A clip's link velocities are differences of its places, as MuJoCo's are not quite.
        np.testing.assert_allclose(terms[i, 36:39], in_s(walking, i, place), atol=2e-3)
        np.testing.assert_allclose(terms[i, 39:], in_s(walking, i, speed), atol=0.06)


def test_trained_gains_stay_above_their_least_values():
    balance = Balance(Layout.of(observation_layout(PRIVILEGED)), "reference")
    kp, kd, limit = balance.gains()
    assert kp[0].item() == pytest.approx(STANDING.kp[0])
    assert kd[0].item() == pytest.approx(STANDING.kd[0])
    with torch.no_grad():
        for parameter in balance.parameters():
            parameter.fill_(-50.0)
    kp, kd, limit = balance.gains()
    assert kp[0].item() == pytest.approx(STANDING.least_kp[0])
    assert kd[1].item() == pytest.approx(STANDING.least_kd[1])
    assert limit.item() > 0.5


def test_with_nothing_learnt_standing_and_squatting_avatars_stay_upright_by_it_alone():
    clips = load_motions("synthetic:stand+squat+boxing")
    sim = evaluation_sim(clips, PRIVILEGED)
    tracked = {}
    for balance in ("none", "reference"):
        agent = PolicyAgent(teacher(balance), Needs(privileged=True))
        agent.bind(sim)
        tracked[balance] = follow(agent, sim, clips).tracked
    assert tracked["none"] < 0.2
    assert tracked["reference"] > 0.8


def test_a_students_balance_pulls_towards_midway_between_the_feet(walking):
    terms = balance_of(walking, False).terms(torch.from_numpy(walking.observation)).numpy()
    for i, height in enumerate(walking.heights):
        feet = walking.link_positions[i, list(FOOT_LINKS)]
        away = feet.mean(0) - walking.batch.bind("subtree_com")[i, 1]
        found, expected = terms[i, 36:39], in_s(walking, i, away)
        # Up to the few centimetres by which it is in front of the ankles.
        assert np.linalg.norm(found[:2] - expected[:2]) < 0.05 * height / 1.75
        assert found[2] == 0.0


@pytest.mark.parametrize(
    ("before", "after"), [("none", "feet"), ("feet", "placement"), ("none", "placement")]
)
def test_a_policy_can_be_trained_on_with_more_terms_in_its_head(before: str, after: str):
    sparse = Layout.of(observation_layout(PRIVILEGED)).within(SPARSE_BLOCKS)
    old, new = (
        new_policy(PolicySpec(critic_blocks=(), hidden=(8,), balance=balance), sparse)
        for balance in (before, after)
    )
    copy_actor(old, new, "old")  # type: ignore[arg-type]
    obs = torch.randn(5, max(stop for _, stop in sparse.blocks.values()))
    outputs = new.actor(obs)
    kept = old.actor(obs).shape[1]
    torch.testing.assert_close(outputs[:, :kept], old.actor(obs))
    assert outputs.shape[1] == 33 + OUTPUTS[after]
    assert not outputs[:, kept:].any()


def test_balance_needs_the_head_and_a_known_name():
    with pytest.raises(InputError, match="not one of"):
        PolicySpec(balance="ankles")
    with pytest.raises(InputError, match="term of the torque head"):
        PolicySpec(torque_head=False, balance="feet")
