"""PPO and DAgger: what they compute and that they learn."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from fake_env import FakeVecEnv
from gymnasium import spaces
from learners import nothing, small_ppo

from agents.agent import Needs
from agents.policy.policy_agent import PolicyAgent, new_policy
from agents.policy.spec import SPARSE_BLOCKS, Layout, PolicySpec
from agents.training.buffers import TensorRolloutBuffer
from agents.training.dagger import Dagger, DaggerConfig, Memory
from agents.training.learner import TrainingError
from agents.training.ppo import _gaussian_kl


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)


def buffer_for(
    env: FakeVecEnv, steps: int, decay: float = 0.95, gamma: float = 0.97
) -> TensorRolloutBuffer:
    observations, actions = env.observation_space, env.action_space
    assert isinstance(observations, spaces.Box)
    assert isinstance(actions, spaces.Box)
    return TensorRolloutBuffer(steps, observations, actions, "cpu", decay, gamma, env.num_envs)


def test_advantages_are_discounted_sums_of_surprises_up_to_the_episodes_end():
    rng = np.random.default_rng(0)
    steps, envs, gamma, decay = 7, 3, 0.9, 0.8
    env = FakeVecEnv(envs)
    buffer = buffer_for(env, steps, decay, gamma)
    buffer.rewards[:] = torch.from_numpy(rng.normal(size=(steps, envs)))
    buffer.values[:] = torch.from_numpy(rng.normal(size=(steps, envs)))
    buffer.dones[:] = torch.from_numpy(rng.random((steps, envs)) < 0.3)
    last = torch.from_numpy(rng.normal(size=envs)).float()
    buffer.compute_advantages(last)
    values = torch.cat([buffer.values, last[None]])
    for i in range(envs):
        for t in range(steps):
            expected, weight = 0.0, 1.0
            for k in range(t, steps):
                done = float(buffer.dones[k, i])
                surprise = buffer.rewards[k, i] + gamma * (1 - done) * values[k + 1, i]
                expected += weight * float(surprise - values[k, i])
                if done:
                    break
                weight *= gamma * decay
            assert float(buffer.advantages[t, i]) == pytest.approx(expected, abs=1e-5)


def test_an_update_visits_every_row_once_an_epoch():
    buffer = buffer_for(FakeVecEnv(4), 5)
    orders = buffer.orders(6, 2, torch.Generator().manual_seed(0))
    assert [len(rows) for rows in orders] == [6, 6, 6, 2] * 2
    for epoch in (orders[:4], orders[4:]):
        assert sorted(torch.cat(epoch).tolist()) == list(range(20))
    assert not torch.equal(orders[0], orders[4])


def test_rows_of_an_update_belong_together():
    buffer = buffer_for(FakeVecEnv(4), 5)
    buffer.values[:] = torch.arange(20.0).view(5, 4)
    buffer.actions[..., 0] = buffer.values
    targets = buffer.learning_targets()
    assert targets.returns.tolist() == targets.actions[:, 0].tolist() == list(range(20))


def test_actor_and_critic_learn_the_same_side_by_side_as_one_after_the_other():
    policies = []
    for threads in (1, 2):
        ppo = small_ppo(FakeVecEnv(16), threads=threads)
        for _ in range(3):
            ppo.iterate(nothing, 0.0)
        policies.append(ppo.policy.state_dict())
    for name, tensor in policies[0].items():
        assert torch.equal(tensor, policies[1][name]), name


def test_the_step_of_an_update_shrinks_over_the_budget():
    ppo = small_ppo(FakeVecEnv(2), desired_kl=0.16, final_kl=0.01)
    for progress, expected in ((0.0, 0.16), (0.5, 0.04), (1.0, 0.01)):
        ppo.iterate(nothing, progress)
        assert ppo.desired_kl == pytest.approx(expected)


def test_the_first_update_keeps_to_its_kl_divergence_whatever_the_learning_rate():
    for rate in (3e-5, 3e-3):
        ppo = small_ppo(FakeVecEnv(16), learning_rate=rate, desired_kl=0.03)
        ppo.iterate(nothing, 0.0)
        figures = ppo.iterate(nothing, 0.0)
        assert 0.0 < figures["train/kl"] < 0.1
        assert ppo.actor_rate <= 2.0 * rate


def test_an_update_ends_when_its_kl_divergence_is_spent():
    ppo = small_ppo(FakeVecEnv(16), desired_kl=0.03)
    ppo.iterate(nothing, 0.0)
    ppo.iterate(nothing, 0.0)
    ppo.actor_rate = 3e-3
    figures = ppo.iterate(nothing, 0.0)
    assert figures["train/steps_made"] < 1.0
    assert figures["train/kl"] > 0.03
    assert ppo.actor_rate == 1.5e-3


def test_the_trial_step_leaves_policy_and_optimiser_as_they_were():
    ppo = small_ppo(FakeVecEnv(8), desired_kl=0.03)
    ppo.iterate(nothing, 0.0)
    ppo.collect_rollouts(ppo.env, ppo._observer, ppo.rollout_buffer, ppo.n_steps)  # type: ignore[arg-type]
    before = [p.detach().clone() for p in ppo.policy.actor_parameters()]
    targets = ppo.rollout_buffer.learning_targets()
    orders = ppo.rollout_buffer.orders(64, 1, ppo.generator)
    parts = ppo.policy.action_inputs(ppo.rollout_buffer.flat_observations())
    ppo._measure_rate(targets, orders, parts)
    assert all(map(torch.equal, before, ppo.policy.actor_parameters()))
    assert not ppo.policy.optimizer.state_dict()["state"]


def test_kl_is_that_of_normal_distributions():
    means, stds = torch.randn(2, 5, 3), torch.rand(2, 3) + 0.1
    p, q = (torch.distributions.Normal(m, s) for m, s in zip(means, stds, strict=True))
    expected = torch.distributions.kl_divergence(p, q).sum(1).mean()
    found = _gaussian_kl(means[0], stds[0].log(), means[1], stds[1].log())
    torch.testing.assert_close(found, expected)


def test_learning_rate_follows_the_kl_divergence():
    ppo = small_ppo(FakeVecEnv(2), desired_kl=0.02, learning_rate=1e-4)
    ppo._adapt_rate(0.05)
    assert ppo.actor_rate == pytest.approx(0.5e-4)
    ppo._adapt_rate(0.001)
    assert ppo.actor_rate == pytest.approx(1e-4)
    ppo._adapt_rate(0.02)
    assert ppo.actor_rate == pytest.approx(1e-4)
    fixed = small_ppo(FakeVecEnv(2), desired_kl=None, learning_rate=1e-4)
    fixed._adapt_rate(5.0)
    assert fixed.actor_rate == pytest.approx(1e-4)


def test_truncated_episodes_are_bootstrapped_with_the_critics_value_of_their_last_state():
    env = FakeVecEnv(2)
    env.episode_frames = 16
    ppo = small_ppo(env, reward_scale=1.0)
    ppo.iterate(nothing, 0.0)
    values: list[torch.Tensor] = []
    predict = ppo.policy.predict_values

    def recorded(obs: torch.Tensor) -> torch.Tensor:
        values.append(predict(obs))
        return values[-1]

    ppo.policy.predict_values = recorded  # type: ignore[method-assign]
    raw: list[np.ndarray] = []
    ppo.iterate(lambda rewards, *_: raw.append(rewards.copy()), 0.0)
    terminal = next(v for v in values if v.shape == (2, 1))
    expected = torch.from_numpy(raw[-1]) + ppo.gamma * terminal.squeeze(1)
    torch.testing.assert_close(ppo.rollout_buffer.rewards[-1], expected)
    torch.testing.assert_close(ppo.rollout_buffer.rewards[0], torch.from_numpy(raw[0]))


def test_normaliser_changes_only_between_rollout_and_next_rollout():
    ppo = small_ppo(FakeVecEnv(8))
    norm = ppo.policy.actor.norm
    before = [p.detach().clone() for p in ppo.policy.parameters()]
    ppo.iterate(nothing, 0.0)
    assert norm.count.item() == 128
    # The first rollout only measured the observations.
    assert all(torch.equal(a, b) for a, b in zip(before, ppo.policy.parameters(), strict=True))
    mean = norm.mean.clone()
    seen: list[torch.Tensor] = []
    step = ppo._descend
    ppo._descend = lambda *a: (seen.append(norm.mean.clone()), step(*a))[1]  # type: ignore
    ppo.iterate(nothing, 0.0)
    assert seen
    assert all(torch.equal(m, mean) for m in seen)
    assert not torch.equal(norm.mean, mean)
    assert norm.count.item() == 256


def test_ppo_learns_to_follow():
    env = FakeVecEnv(32)
    ppo = small_ppo(env)
    rewards: list[float] = []
    while ppo.num_timesteps < 50_000:
        ppo.iterate(lambda r, *_: rewards.append(float(r.mean())), 0.0)
    assert np.mean(rewards[-100:]) > 3 * np.mean(rewards[:20])


def test_ppo_runs_through_stable_baselines_learn():
    ppo = small_ppo(FakeVecEnv(8))
    ppo.learn(400)
    assert ppo.num_timesteps == 512
    assert ppo.ep_info_buffer


def test_same_seed_gives_the_same_weights():
    def weights() -> torch.Tensor:
        torch.manual_seed(1)
        ppo = small_ppo(FakeVecEnv(8, seed=1), seed=1)
        for _ in range(3):
            ppo.iterate(nothing, 0.0)
        return torch.cat([p.detach().flatten() for p in ppo.policy.parameters()])

    assert torch.equal(weights(), weights())


def test_frozen_actor_keeps_its_weights_while_the_critic_learns():
    ppo = small_ppo(FakeVecEnv(8))
    ppo.iterate(nothing, 0.0)
    ppo.actor_frozen = True
    obs = ppo.rollout_buffer.flat_observations().clone()
    layers = [p.detach().clone() for p in ppo.policy.actor_parameters()]
    values = ppo.policy.predict_values(obs).detach()
    ppo.iterate(nothing, 0.0)
    assert all(
        torch.equal(a, b) for a, b in zip(layers, ppo.policy.actor_parameters(), strict=True)
    )
    assert not torch.allclose(ppo.policy.predict_values(obs), values)


def test_reward_that_is_not_finite_stops_training():
    env = FakeVecEnv(4)
    ppo = small_ppo(env)
    ppo.iterate(nothing, 0.0)
    env.reference = lambda ahead: np.full((4, 33), np.nan)  # type: ignore[method-assign]
    with pytest.raises(TrainingError, match=r"training step 68: the reward is not finite"):
        ppo.iterate(nothing, 0.0)


def test_memory_forgets_the_oldest_states():
    memory = Memory(5, 1, 1)
    for first in (0, 3, 6):
        rows = torch.arange(first, first + 3.0)[:, None]
        memory.add(rows, rows * 10)
    assert memory.size == 5
    assert sorted(memory.observations.flatten().tolist()) == [4, 5, 6, 7, 8]
    assert torch.equal(memory.labels, 10 * memory.observations)


def test_a_student_learns_the_same_on_one_thread_and_on_two():
    weights = []
    for threads in (1, 2):
        env = FakeVecEnv(16)
        teacher = PolicyAgent(small_ppo(env).policy, Needs(privileged=True))
        teacher.bind(env)
        torch.manual_seed(0)
        sparse = Layout.of(env.layout).within(SPARSE_BLOCKS)
        student = new_policy(PolicySpec(SPARSE_BLOCKS, (), (64,), "elu"), sparse)
        dagger = Dagger(env, teacher, student, DaggerConfig(minibatch=64), 0, threads)
        for _ in range(3):
            dagger.iterate(nothing, 0.0)
        weights.append(student.state_dict())
    for name, tensor in weights[0].items():
        assert torch.equal(tensor, weights[1][name]), name


def trained_teacher(env: FakeVecEnv) -> PolicyAgent:
    ppo = small_ppo(env)
    while ppo.num_timesteps < 40_000:
        ppo.iterate(nothing, 0.0)
    teacher = PolicyAgent(ppo.policy, Needs(privileged=True))
    teacher.bind(env)
    return teacher


def test_student_comes_to_act_like_its_teacher_from_sparse_observations():
    env = FakeVecEnv(32)
    teacher = trained_teacher(env)
    sparse = Layout.of(env.layout).within(SPARSE_BLOCKS)
    student = new_policy(PolicySpec(SPARSE_BLOCKS, (), (64,), "elu"), sparse)
    config = DaggerConfig(mix_steps=5000, capacity=20_000, minibatch=256)
    dagger = Dagger(env, teacher, student, config, seed=0)
    assert dagger.beta == 1.0
    obs = env.reset()
    before = np.abs(student.predict_batch(obs) - teacher.act(obs)).mean()
    while dagger.num_timesteps < 30_000:
        dagger.iterate(nothing, dagger.num_timesteps / 30_000)
    assert dagger.beta == 0.0
    after = np.abs(student.predict_batch(obs) - teacher.act(obs)).mean()
    assert after < 0.2 * before
    # It reads nothing but the sparse part.
    obs_without = obs.copy()
    obs_without[:, 100:] = 7.0
    np.testing.assert_array_equal(student.predict_batch(obs_without), student.predict_batch(obs))
