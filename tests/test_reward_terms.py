"""The table of reward terms: pure functions, compiled ones, and those of other packages."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace

import numpy as np
import pytest

from agents.overrides import with_overrides
from envs import EnvConfig, QuestEnv, QuestVecEnv, terrain_named
from questsim import reward
from questsim.errors import InputError
from questsim.motion.synthesis.synthetic import synthesise
from questsim.reward import COMPILED, TERMS, Moment, RewardConfig, register_term

CLIPS = [synthesise("walk", duration=2.0), synthesise("stand", duration=2.0)]


def energy(moment: Moment, k: float) -> np.ndarray:
    return -k * np.abs(moment.torque * moment.joint_velocities).mean(axis=-1)


@pytest.fixture
def registered() -> Iterator[str]:
    register_term("test_energy", energy, k=0.01)
    yield "test_energy"
    del TERMS["test_energy"]
    RewardConfig.__dataclass_fields__ = reward._options()


def stepped(env: QuestVecEnv, steps: int = 4) -> QuestVecEnv:
    env.reset()
    rng = np.random.default_rng(0)
    for _ in range(steps):
        env.step(rng.normal(0.0, 0.1, (env.num_envs, 33)).astype(np.float32))
    return env


@pytest.mark.parametrize("ground", [None, "rough"])
def test_the_compiled_terms_are_the_functions_of_the_table(ground: str | None) -> None:
    terrain = None if ground is None else terrain_named(ground)
    sim = stepped(QuestVecEnv(CLIPS, EnvConfig(terrain=terrain), num_envs=4, seed=0)).sim
    moment = sim.moment()
    assert 0.01 < sim.reward_terms.min(axis=0).max() < 1.0
    for column, name in enumerate(COMPILED):
        expected = TERMS[name].function(moment, TERMS[name].k)
        # Kernels read the reference in float32.
        np.testing.assert_allclose(sim.reward_terms[:, column], expected, atol=2e-5, err_msg=name)


def test_a_registered_term_counts_and_is_in_the_infos(registered: str) -> None:
    plain = stepped(QuestVecEnv(CLIPS, EnvConfig(), num_envs=4, seed=0)).sim
    config = EnvConfig(reward=RewardConfig(test_energy=0.1))
    sim = stepped(QuestVecEnv(CLIPS, config, num_envs=4, seed=0)).sim
    watts = np.abs(sim.ctrl * sim.qvel[:, 6:39]).mean(axis=-1)
    assert np.median(watts) > 0.1  # an avatar whose episode begins anew has none yet
    assert sim.reward_names == (*COMPILED, registered)
    np.testing.assert_allclose(sim.reward_terms[:, 6], -0.01 * watts)
    np.testing.assert_array_equal(sim.reward_terms[:, :6], plain.reward_terms)
    np.testing.assert_allclose(sim.reward, plain.reward - 0.1 * 0.01 * watts)
    assert plain.reward_names == COMPILED  # without a weight it costs nothing
    env = QuestEnv(CLIPS, config)
    env.reset(seed=0)
    assert env.step(np.ones(33, np.float32))[4][registered] < 0.0


def test_a_registered_term_is_an_option_like_the_others(registered: str) -> None:
    config = with_overrides(EnvConfig(), ["reward.test_energy=0.1", "reward.k_test_energy=2"])
    assert config.reward == RewardConfig(test_energy=0.1, k_test_energy=2.0)
    record = asdict(config.reward)
    assert list(record)[:6] == list(COMPILED) and record["test_energy"] == 0.1
    assert replace(config.reward, contact=0.0).test_energy == 0.1


def test_a_term_that_is_not_known_is_refused_by_name() -> None:
    with pytest.raises(InputError, match="no reward term 'nonsense'"):
        RewardConfig(nonsense=1.0)
    with pytest.raises(InputError, match="there is no 'nonsense'"):
        with_overrides(EnvConfig(), ["reward.nonsense=0.1"])
    with pytest.raises(InputError, match="already"):
        register_term("contact", energy)


def test_a_term_without_a_value_is_an_error_and_no_fall(
    registered: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = TERMS[registered]._replace(function=lambda m, k: np.full(len(m.torque), np.nan))
    monkeypatch.setitem(TERMS, registered, broken)
    config = EnvConfig(reward=RewardConfig(test_energy=0.1))
    env = QuestVecEnv(CLIPS, config, num_envs=2)
    env.reset()
    with pytest.raises(ValueError, match="'test_energy' is not finite"):
        env.step(np.zeros((2, 33), np.float32))
