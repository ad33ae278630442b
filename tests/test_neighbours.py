"""What goes wrong in one simulation of a batch stays in that simulation."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import swaying_clip

from envs import BatchSim, EnvConfig, KinematicVecEnv, Pushes, QuestVecEnv, Randomisation, Terrain
from envs.episode_random import Streams
from questsim.errors import InputError

CLIPS = [swaying_clip("a", 1.75), swaying_clip("b", 1.6, frames=50), swaying_clip("c", 1.9)]
ROUGH = Terrain("rough", wavelength_m=0.2, size_m=12.0)
BUSY = EnvConfig(
    terrain=ROUGH,
    self_collision=True,
    pushes=Pushes(force_n=(50.0, 150.0), pause_s=(0.1, 0.5)),
    randomisation=Randomisation(dropout=(0.1, 0.3)),
)
"""A world in which every kind of random number is drawn."""


def not_finite(sim: BatchSim) -> None:
    sim.qvel[1] = np.nan


def out_of_memory(sim: BatchSim) -> None:
    """Lying in the ground: more contacts than the model's memory holds."""
    sim.qpos[1, 2] = sim.floor[1] - 0.05
    sim.qpos[1, 3:7] = [0.7071, 0.0, 0.7071, 0.0]
    sim.qpos[1, 7:40], sim.qvel[1] = 0.0, 0.0


def steps(
    poison: Callable[[BatchSim], None] | None, config: EnvConfig
) -> tuple[QuestVecEnv, list[tuple[Any, ...]]]:
    env = QuestVecEnv(CLIPS, config, num_envs=3, seed=5)
    env.reset()
    plan = np.random.default_rng(7).normal(0.0, 0.6, (70, 3, 33))
    out = []
    for number, action in enumerate(plan):
        if poison is not None and number in (10, 30):
            poison(env.sim)
        out.append(env.step(action))
    return env, out


@pytest.mark.parametrize("poison", [not_finite, out_of_memory])
def test_a_failing_simulation_ends_its_episode_and_its_neighbours_keep_their_bits(
    poison: Callable[[BatchSim], None],
) -> None:
    well, sound = steps(None, BUSY)
    ill, poisoned = steps(poison, BUSY)
    assert (well.sim.unstable_count, ill.sim.unstable_count) == (0, 2)
    assert sum(done[[0, 2]].sum() for _, _, done, _ in sound) >= 4, "episodes have to begin anew"
    for (obs, reward, done, _), (obs2, reward2, done2, _) in zip(sound, poisoned, strict=True):
        for mine, other in ((obs, obs2), (reward, reward2), (done, done2)):
            np.testing.assert_array_equal(mine[[0, 2]], other[[0, 2]])
    for number in (10, 30):
        obs, reward, done, infos = poisoned[number]
        assert done[1] and infos[1]["fell"] and reward[1] == 0.0
        assert np.isfinite(infos[1]["terminal_observation"]).all() and np.isfinite(obs).all()
        assert not poisoned[number + 1][2][1], "the next episode runs"


def test_unstable_physics_leaves_no_log_in_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    sim = BatchSim(CLIPS, EnvConfig(fixed_start=True))
    sim.reset()
    not_finite(sim)
    sim.step(np.zeros((3, 33)))
    assert sim.unstable.tolist() == [False, True, False]
    assert list(tmp_path.iterdir()) == []


def test_streams_are_even_independent_and_the_same_in_any_batch() -> None:
    many, few = Streams(400, seed=3, purpose=0), Streams(2, seed=3, purpose=0)
    numbers = many.draw(np.arange(400), 50)
    np.testing.assert_array_equal(numbers[:2], few.draw(np.arange(2), 50))
    assert 0.0 <= numbers.min() < 0.001 and 0.999 < numbers.max() < 1.0
    assert np.histogram(numbers, 10, (0.0, 1.0))[0].min() > 0.93 * numbers.size / 10
    for other in (np.roll(numbers, 1, axis=0), np.roll(numbers, 1, axis=1)):
        assert abs(np.corrcoef(numbers.ravel(), other.ravel())[0, 1]) < 0.03
    one = Streams(1, seed=9, purpose=0)
    many.seed([None, 9])
    np.testing.assert_array_equal(many.draw(np.array([1]), 4), one.draw(np.array([0]), 4))
    other_use = Streams(2, seed=3, purpose=1).draw(np.arange(2), 50)
    assert not np.isin(other_use, numbers).any()


@pytest.mark.parametrize(
    ("actions", "what"),
    [
        (0.0, r"shape \(\), not \(3, 33\)"),
        (np.zeros(33), r"shape \(33,\), not \(3, 33\)"),
        (np.zeros((1, 33)), r"shape \(1, 33\)"),
        (np.zeros((3, 34)), r"shape \(3, 34\)"),
        (None, "is NoneType, not an array of numbers"),
        ([[0.0] * 33, [0.0], [0.0]], "is list, not an array of numbers"),
        ("stand", "not an array of numbers"),
        (np.zeros((3, 33), bool), "is bool, not an array of numbers"),
        (np.where(np.arange(99).reshape(3, 33) == 35, np.nan, 0.0), r"action\[1, 2\]: is nan"),
        (np.where(np.arange(99).reshape(3, 33) == 0, np.inf, 0.0), r"action\[0, 0\]: is inf"),
    ],
)
def test_actions_of_another_form_are_refused_and_nothing_moves(actions: Any, what: str) -> None:
    env = QuestVecEnv(CLIPS, EnvConfig(fixed_start=True))
    env.reset()
    before = env.sim.batch.state.copy()
    for step in (env.step, env.step_async, env.sim.step):
        with pytest.raises(InputError, match=what):
            step(actions)
    np.testing.assert_array_equal(env.sim.batch.state, before)


def test_poses_of_another_form_are_refused() -> None:
    env = KinematicVecEnv(CLIPS, EnvConfig(fixed_start=True))
    env.reset()
    for poses in (np.zeros(40), np.full((3, 40), np.inf), None, np.zeros((3, 40))):
        with pytest.raises(InputError, match="pose"):
            env.step(poses)  # type: ignore[arg-type]
