"""The torque policy, its observation blocks, and checkpoints of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from fake_env import FakeVecEnv

from agents.agent import Needs
from agents.loading import load_agent
from agents.policy.checkpoint import load_policy, load_resume, pack, save_policy, unpack
from agents.policy.networks import RunningNorm, TorquePolicy, mean_and_variance
from agents.policy.policy_agent import PolicyAgent, Tracker, new_policy
from agents.policy.spec import (
    TRACKER_BLOCKS,
    Layout,
    PolicySpec,
    initial_gains,
    noise_by_joint,
)
from envs.avatar import avatar_of
from envs.config import EnvConfig
from questsim.errors import InputError
from questsim.skeleton import DOFS, NUM_DOFS

SPARSE = PolicySpec(critic_blocks=(), hidden=(16,))
TEACHER = PolicySpec(TRACKER_BLOCKS, TRACKER_BLOCKS, hidden=(16,), reference_head=True)


@pytest.fixture
def env() -> FakeVecEnv:
    return FakeVecEnv(4)


def policy_for(env: FakeVecEnv, spec: PolicySpec, **settings) -> TorquePolicy:
    torch.manual_seed(0)
    layout = Layout.of(env.layout)
    return new_policy(spec, layout.within(spec.actor_blocks), **settings)


def silence(policy: TorquePolicy) -> TorquePolicy:
    """Leave only the torque head."""
    last = policy.actor.layers[-1]
    assert isinstance(last, torch.nn.Linear)
    torch.nn.init.zeros_(last.weight)
    return policy


def test_normaliser_has_the_mean_and_variance_of_all_rows_seen():
    rng = np.random.default_rng(0)
    parts = [rng.normal(3, 2, (n, 5)).astype(np.float32) for n in (7, 100, 1)]
    norm = RunningNorm(5)
    for part in parts:
        norm.merge(len(part), *mean_and_variance(torch.from_numpy(part)))
    rows = np.concatenate(parts)
    np.testing.assert_allclose(norm.mean, rows.mean(0), rtol=1e-5)
    np.testing.assert_allclose(norm.var, rows.var(0), rtol=1e-4)
    normalised = norm(torch.from_numpy(rows)).numpy()
    np.testing.assert_allclose(normalised.std(0), 1.0, rtol=1e-4)


def test_normaliser_clips_outliers_and_spares_constant_inputs():
    norm = RunningNorm(1)
    norm.merge(10, *mean_and_variance(torch.full((10, 1), 1.75)))
    assert norm(torch.tensor([[1.76]])).item() == pytest.approx(1.0, rel=1e-3)
    assert norm(torch.tensor([[9.0]])).item() == 10.0


def test_head_pulls_joints_to_the_reference_pose_and_adds_what_the_motion_takes(env):
    gains = np.linspace(0.5, 3.0, NUM_DOFS)
    policy = silence(policy_for(env, TEACHER, gains=gains))
    obs = env.reset()
    env.q += 0.01
    obs = env.observe()
    obs[:, env.layout["reference_torques"]] = np.linspace(-0.3, 0.3, NUM_DOFS)
    q, reference = obs[:, env.layout["joint_angles"]], obs[:, env.layout["midway_joint_angles"]]
    expected = gains * (reference - q) + np.linspace(-0.3, 0.3, NUM_DOFS)
    np.testing.assert_allclose(policy.predict_batch(obs), expected, rtol=1e-4, atol=1e-6)


def test_head_of_a_sparse_policy_pulls_to_the_zero_pose(env):
    policy = silence(policy_for(env, SPARSE, gains=np.full(NUM_DOFS, 0.5)))
    obs = env.reset()
    np.testing.assert_allclose(policy.predict_batch(obs), -0.5 * obs[:, :NUM_DOFS], rtol=1e-5)


def test_policy_without_head_starts_near_no_torque(env):
    policy = policy_for(env, PolicySpec(critic_blocks=(), torque_head=False))
    assert policy.head is None
    assert np.abs(policy.predict_batch(env.reset())).max() < 0.1


def test_actions_stay_within_the_torque_limits(env):
    policy = silence(policy_for(env, SPARSE, gains=np.full(NUM_DOFS, 100.0)))
    assert np.abs(policy.predict_batch(env.reset())).max() == 1.0


def test_start_gains_are_four_times_the_damping_over_80_ms():
    gains = initial_gains(np.array([200.0, 20.0, 50.0]), np.array([5.0, 0.4, 0.0]))
    np.testing.assert_allclose(gains, [250 / 200, 20 / 20, 0.01])


def test_exploration_is_larger_in_legs_and_trunk():
    noise = dict(zip(DOFS, noise_by_joint(avatar_of(None).strong, 0.12, 0.04), strict=True))
    assert noise["left_hip_y"] == noise["chest_z"] == noise["right_ankle_x"] == 0.12
    assert noise["neck_x"] == noise["left_wrist_x"] == noise["right_shoulder_y"] == 0.04


def test_log_probability_is_that_of_a_normal_distribution(env):
    policy = policy_for(env, SPARSE, noise=np.linspace(0.05, 0.2, NUM_DOFS))
    mean, actions = torch.randn(6, NUM_DOFS), torch.randn(6, NUM_DOFS)
    normal = torch.distributions.Normal(mean, policy.log_std.exp())
    torch.testing.assert_close(policy.log_prob(mean, actions), normal.log_prob(actions).sum(1))


def test_stable_baselines_interface_agrees_with_the_fast_path(env):
    policy = policy_for(env, SPARSE)
    obs = env.reset()[:, :100]
    actions, _ = policy.predict(obs, deterministic=True)
    np.testing.assert_allclose(actions, policy.predict_batch(obs), atol=1e-6)
    values, log_prob, _ = policy.evaluate_actions(torch.from_numpy(obs), torch.from_numpy(actions))
    assert values.shape == (4, 1)
    mean = policy.action_mean(torch.from_numpy(obs))
    torch.testing.assert_close(log_prob, policy.log_prob(mean, torch.from_numpy(actions)))


def test_tracker_does_not_depend_on_the_sensors_in_between(env):
    """Another number of future frames moves the privileged block; the tracker finds it."""
    agent = PolicyAgent(policy_for(env, TEACHER), Needs(privileged=True))
    obs = env.reset()
    before = agent.act(obs)
    moved = {
        name: slice(part.start - 30, part.stop - 30) if part.start >= 99 else part
        for name, part in env.layout.items()
    }
    env.layout = moved | {"o_user": slice(66, 69)}
    agent.bind(env)
    shorter = np.concatenate([obs[:, :69], obs[:, 99:]], axis=1)
    np.testing.assert_array_equal(agent.act(shorter), before)


def test_checkpoint_gives_the_same_actions_and_cannot_hold_code(env, tmp_path):
    policy = policy_for(env, TEACHER)
    policy.update_norm(torch.from_numpy(env.reset()))
    save_policy(tmp_path / "t", policy, Needs(privileged=True), {"seed": 3})
    agent = load_agent(tmp_path / "t")
    assert isinstance(agent, Tracker)
    assert agent.card["training"] == {"seed": 3}
    obs = env.reset()
    np.testing.assert_array_equal(agent.act(obs), policy.predict_batch(obs))
    assert not [p for p in (tmp_path / "t").iterdir() if p.suffix in (".pt", ".pkl", ".pth")]


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("format_version", 99, "format_version is 99"),
        ("joints", [*DOFS[:3], "left_tail_y", *DOFS[4:]], "'left_tail_y'"),
        ("joints", list(DOFS[:-1]), "32 names"),
        ("links", [], "links has 0"),
        ("fps", 30.0, "fps is 30.0"),
        ("format", "zip", "questsim-policy"),
        ("network", None, "incomplete"),
        ("observation", {"o_sim": [0, 66]}, "no block"),
    ],
)
def test_checkpoint_of_another_kind_is_refused_by_name(env, tmp_path, field, value, said):
    folder = tmp_path / "p"
    save_policy(folder, policy_for(env, SPARSE), Needs(), {})
    card = yaml.safe_load((folder / "policy.yaml").read_text())
    (folder / "policy.yaml").write_text(yaml.safe_dump(card | {field: value}))
    with pytest.raises(InputError, match=said):
        load_agent(folder)


def test_damaged_or_missing_weights_are_refused(env, tmp_path):
    folder = tmp_path / "p"
    policy = policy_for(env, SPARSE)
    save_policy(folder, policy, Needs(), {})
    weights = folder / "policy.safetensors"
    good = weights.read_bytes()
    weights.write_bytes(good[:100])
    with pytest.raises(InputError, match="do not fit"):
        load_policy(folder)
    weights.unlink()
    with pytest.raises(InputError, match="there is no policy"):
        load_policy(folder)
    policy.log_std.data[0] = torch.nan
    save_policy(folder, policy, Needs(), {})
    with pytest.raises(InputError, match="log_std is not finite"):
        load_policy(folder)


def test_unknown_agent_lists_what_there_is(tmp_path):
    with pytest.raises(InputError, match="zero, random"):
        load_agent(tmp_path / "nobody")


def test_another_observation_or_body_is_refused_by_name(env):
    agent = PolicyAgent(policy_for(env, SPARSE), Needs(), "walker")
    env.layout["o_user"] = slice(66, 90)
    with pytest.raises(InputError, match="walker: the policy reads 33 numbers of 'o_user'"):
        agent.bind(env)
    del env.layout["o_user"]
    with pytest.raises(InputError, match="lacks it"):
        agent.bind(env)
    other = FakeVecEnv(2)
    other.layout["joint_angles"] = slice(33, 66)
    other.layout["joint_velocities"] = slice(0, 33)
    with pytest.raises(InputError, match="another place in"):
        agent.bind(other)


def test_other_devices_frames_or_proportions_of_the_same_size_are_refused(env):
    agent = PolicyAgent(policy_for(env, SPARSE), Needs(future_frames=0), "walker")
    env.config = EnvConfig(sensors="3T", future_frames=0)  # the same devices by another name
    agent.bind(env)
    env.config = EnvConfig(future_frames=1)
    with pytest.raises(InputError, match=r"walker: observes H\+2C with 0 .* not H\+2C with 1"):
        agent.bind(env)
    env.config = EnvConfig(future_frames=0, observe_proportions=True)
    with pytest.raises(InputError, match="turn observe_proportions off"):
        agent.bind(env)
    with pytest.raises(InputError, match="cannot read 'o_teacher'"):
        PolicySpec(("o_sim", "o_teacher"))


def test_body_of_another_preset_is_refused(env):
    agent = PolicyAgent(policy_for(env, SPARSE), Needs(body_preset="paper"))
    env.config = EnvConfig()
    with pytest.raises(InputError, match="'paper'"):
        agent.bind(env)


def test_resume_state_survives_the_file(env, tmp_path):
    state = {
        "random": np.random.default_rng(5).bit_generator.state,
        "weights": np.arange(6.0).reshape(2, 3),
        "flags": [True, None, "x", 1.5],
    }
    save_policy(tmp_path / "p", policy_for(env, SPARSE), Needs(), {}, state)
    back = unpack(load_resume(tmp_path / "p"))
    assert back["random"] == state["random"]
    assert back["flags"] == state["flags"]
    np.testing.assert_array_equal(back["weights"], state["weights"])
    assert isinstance(unpack(pack(state))["weights"], np.ndarray)


def test_resume_file_with_code_in_it_is_refused(tmp_path):
    class Code:
        def __reduce__(self):
            return (Path(tmp_path / "ran").touch, ())

    (tmp_path / "p").mkdir()
    torch.save({"x": Code()}, tmp_path / "p" / "resume.pt")
    with pytest.raises(InputError, match="damaged"):
        load_resume(tmp_path / "p")
    assert not (tmp_path / "ran").exists()


def test_replacing_a_checkpoint_leaves_no_other_folders(env, tmp_path):
    for seed in (1, 2):
        save_policy(tmp_path / "p", policy_for(env, SPARSE), Needs(), {"seed": seed})
    assert [p.name for p in tmp_path.iterdir()] == ["p"]
    assert load_policy(tmp_path / "p").card["training"]["seed"] == 2
