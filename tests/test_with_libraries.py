"""Libraries of the field run on the environments as they are: their own code, no shims."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import HumanRendering
from gymnasium.wrappers import vector as wrappers
from helpers import swaying_clip
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import SubprocVecEnv, VecNormalize

from envs import QuestEnv, QuestVecEnv, QuestVectorEnv
from questsim.viewing.gl import NoGLError

CLIPS = [swaying_clip("a", 1.75, frames=30), swaying_clip("b", 1.6, frames=25)]
ID = "envs:QuestSim-v0"


def batch(**options: Any) -> gym.vector.VectorEnv:
    return gym.make_vec(ID, num_envs=2, motions=CLIPS, **options)


def episodes(env: Any, steps: int = 40) -> list[tuple[Any, ...]]:
    env.reset(seed=3)
    plan = np.random.default_rng(3).uniform(-1.0, 1.0, (steps, 2, 33)).astype(np.float32)
    return [env.step(actions) for actions in plan]


def picture_or_skip(env: Any) -> Any:
    env.reset(seed=0)
    try:
        return env.render()
    except NoGLError as error:
        pytest.skip(str(error))


# -- gymnasium's vector wrappers -----------------------------------------------------------

KEEPING: dict[str, Callable[[Any], Any]] = {
    "DtypeObservation": lambda env: wrappers.DtypeObservation(env, np.float64),
    "FlattenObservation": wrappers.FlattenObservation,
    "ReshapeObservation": lambda env: wrappers.ReshapeObservation(env, (19, 25)),
    "TransformObservation": lambda env: wrappers.TransformObservation(env, lambda obs: obs),
    "ClipAction": wrappers.ClipAction,
    "RescaleAction": lambda env: wrappers.RescaleAction(env, -1.0, 1.0),
    "TransformAction": lambda env: wrappers.TransformAction(env, lambda action: action),
    "RecordEpisodeStatistics": wrappers.RecordEpisodeStatistics,
}


@pytest.mark.parametrize("name", KEEPING)
@pytest.mark.filterwarnings("ignore")
def test_a_wrapper_of_gymnasiums_hands_on_what_the_batch_does(name: str) -> None:
    bare, wrapped = episodes(batch()), episodes(KEEPING[name](batch()))
    for (obs, reward, fell, ended, _), (obs2, reward2, fell2, ended2, _) in zip(
        bare, wrapped, strict=True
    ):
        np.testing.assert_array_equal(obs, np.asarray(obs2).reshape(obs.shape))
        np.testing.assert_array_equal(reward, reward2)
        np.testing.assert_array_equal(fell | ended, fell2 | ended2)
    assert sum((fell | ended).sum() for _, _, fell, ended, _ in bare) > 1


def test_normalised_observations_have_mean_zero_and_variance_one() -> None:
    env = wrappers.NormalizeObservation(batch())
    obs = np.concatenate([step[0] for step in episodes(env, 120)[40:]])
    moving = obs.std(axis=0) > 1e-3
    assert moving.sum() > 400
    assert abs(obs[:, moving].mean()) < 0.2 and 0.7 < obs[:, moving].std() < 1.3


@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP"])
def test_rewards_are_transformed_clipped_and_normalised(mode: str) -> None:
    plain = [step[1] for step in episodes(batch(autoreset_mode=mode))]
    doubled = wrappers.TransformReward(batch(autoreset_mode=mode), lambda reward: 2 * reward)
    np.testing.assert_allclose([step[1] for step in episodes(doubled)], 2 * np.array(plain))
    clipped = wrappers.ClipReward(batch(autoreset_mode=mode), 0.2, 0.5)
    seen = [step[1] for step in episodes(clipped)]
    np.testing.assert_allclose(seen, np.clip(plain, 0.2, 0.5))
    env = wrappers.NormalizeReward(batch(autoreset_mode=mode))
    assert np.isfinite([step[1] for step in episodes(env)]).all()


def test_statistics_of_episodes_are_those_that_were_played() -> None:
    for mode in ("NEXT_STEP", "SAME_STEP"):
        env = wrappers.RecordEpisodeStatistics(batch(autoreset_mode=mode))
        total, ends = np.zeros(2), []
        for _, reward, fell, ended, infos in episodes(env):
            total += reward
            for i in np.flatnonzero(fell | ended):
                ends.append((infos["episode"]["r"][i], total[i]))
                total[i] = 0.0
        assert len(ends) > 1
        recorded, own = zip(*ends, strict=True)
        np.testing.assert_allclose(recorded, own)


def test_infos_as_a_list_and_observations_as_tensors() -> None:
    _, _, _, _, infos = episodes(wrappers.DictInfoToList(batch()))[0]
    assert [set(info) >= {"error_m", "clip", "frame"} for info in infos] == [True, True]
    pytest.importorskip("array_api_compat", reason="gymnasium converts arrays with it")
    import torch

    env = wrappers.NumpyToTorch(batch())
    env.reset(seed=0)
    obs, reward, *_ = env.step(torch.zeros(2, 33))
    assert isinstance(obs, torch.Tensor) and isinstance(reward, torch.Tensor)


def test_a_batch_is_filmed_by_gymnasium(tmp_path: Path) -> None:
    pytest.importorskip("moviepy", reason="RecordVideo writes with it")
    env = batch(render_mode="rgb_array")
    pictures = picture_or_skip(env)
    assert len(pictures) == 2 and pictures[0].shape == (480, 640, 3)
    assert (pictures[0] != pictures[1]).any() and pictures[0].std() > 5
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        film = wrappers.RecordVideo(
            env, str(tmp_path), step_trigger=lambda step: step == 0, video_length=4
        )
        episodes(film, 6)
        film.close()
    assert [file.suffix for file in tmp_path.iterdir()] == [".mp4"]


def test_a_window_shows_the_avatar(monkeypatch: pytest.MonkeyPatch) -> None:
    pygame = pytest.importorskip("pygame", reason="the window is its")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    picture_or_skip(QuestEnv(CLIPS, render_mode="rgb_array"))
    env = gym.make(ID, motions=CLIPS, render_mode="human")
    env.reset(seed=0)
    assert env.render() is None
    shown = pygame.surfarray.array3d(pygame.display.get_surface())
    env.step(env.action_space.sample())
    later = pygame.surfarray.array3d(pygame.display.get_surface())
    assert shown.shape == (640, 480, 3) and shown.std() > 5 and (shown != later).any()
    env.close()
    window = HumanRendering(gym.make(ID, motions=CLIPS, render_mode="rgb_array"))
    window.reset(seed=0)
    shown = pygame.surfarray.array3d(pygame.display.get_surface())
    assert shown.shape == (640, 480, 3) and shown.std() > 5
    window.close()


def test_a_window_without_pygame_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pygame", None)
    with pytest.raises(ValueError, match="pip install pygame"):
        gym.make(ID, motions=CLIPS, render_mode="human")


def test_gymnasiums_worker_processes_make_it_by_spawn() -> None:
    env = gym.make_vec(
        ID, 2, "async", vector_kwargs={"context": "spawn"}, motions=CLIPS, heights=1.75
    )
    obs, _ = env.reset(seed=4)
    own, _ = QuestVectorEnv(2, CLIPS, heights=1.75).reset(seed=4)
    np.testing.assert_array_equal(obs, own)
    env.close()


# -- stable-baselines3 ---------------------------------------------------------------------


def learns(model: Any, steps: int) -> None:
    before = [p.detach().clone() for p in model.policy.parameters()]
    model.learn(steps)
    after = list(model.policy.parameters())
    assert model.num_timesteps >= steps
    assert any((a != b).any() for a, b in zip(before, after, strict=True))


def test_stock_ppo_trains_on_the_batch_and_under_vec_normalize() -> None:
    for env in (
        QuestVecEnv(CLIPS, num_envs=4),
        VecNormalize(QuestVecEnv(CLIPS, num_envs=4)),
    ):
        learns(PPO("MlpPolicy", env, n_steps=16, batch_size=32, n_epochs=1, seed=0), 128)


def test_stock_sac_trains_on_the_batch() -> None:
    env = QuestVecEnv(CLIPS, num_envs=2)
    learns(SAC("MlpPolicy", env, learning_starts=20, batch_size=16, buffer_size=200, seed=0), 40)


def test_worker_processes_make_it_by_its_id_with_the_package() -> None:
    env = make_vec_env(
        ID, 2, seed=5, vec_env_cls=SubprocVecEnv, env_kwargs={"motions": CLIPS, "heights": 1.75}
    )
    obs = env.reset()
    own, _ = QuestVectorEnv(2, CLIPS, heights=1.75).reset(seed=5)
    np.testing.assert_array_equal(obs, own)
    _, rewards, _, infos = env.step(np.zeros((2, 33), np.float32))
    assert (rewards > 0.0).all() and infos[0]["clip"] in (0, 1)
    env.close()


# -- libraries that CI does not install: slow, and skipped without them -------------------


@pytest.mark.slow
def test_torchrl_makes_rolls_out_and_checks_it() -> None:
    torchrl = pytest.importorskip("torchrl.envs", reason="TorchRL is not installed")
    env = torchrl.GymEnv(ID, motions=CLIPS)
    torchrl.check_env_specs(env)
    assert env.rollout(5)["next", "reward"].min() > 0.0
    workers = torchrl.GymEnv(ID, num_envs=2, motions=CLIPS)
    assert workers.rollout(5).shape[0] == 2
    workers.close()
    native = torchrl.GymWrapper(batch(autoreset_mode="SAME_STEP"))
    assert native.rollout(40, break_when_any_done=False).shape == (2, 40)


@pytest.mark.slow
def test_rllib_trains_on_it(monkeypatch: pytest.MonkeyPatch) -> None:
    why = "RLlib is not installed"
    ppo = pytest.importorskip("ray.rllib.algorithms.ppo", reason=why, exc_type=ImportError)
    import ray

    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    config = (
        ppo.PPOConfig()
        .environment(ID, env_config={"motions": CLIPS, "heights": 1.75})
        .env_runners(num_env_runners=0, num_envs_per_env_runner=2, rollout_fragment_length=64)
        .training(train_batch_size_per_learner=128, minibatch_size=64, num_epochs=1)
    )
    ray.init("local", num_cpus=1, include_dashboard=False, log_to_driver=False)
    try:
        found = config.build_algo().train()
    finally:
        ray.shutdown()
    assert found["env_runners"]["num_env_steps_sampled"] == 128
    assert found["env_runners"]["episode_return_min"] > 0.0
    assert np.isfinite(found["learners"]["default_policy"]["total_loss"])


@pytest.mark.slow
def test_skrl_steps_it() -> None:
    import torch

    skrl = pytest.importorskip("skrl.envs.wrappers.torch", reason="skrl is not installed")
    env = skrl.wrap_env(batch(), wrapper="gymnasium")
    obs, _ = env.reset()

    for _ in range(40):
        obs, reward, *_ = env.step(torch.zeros(2, 33))
    assert obs.shape == (2, 475) and reward.shape == (2, 1)
