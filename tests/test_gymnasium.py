"""The faces keep gymnasium's and stable-baselines3's contracts, with those libraries themselves."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import cloudpickle
import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from helpers import swaying_clip

import envs
from envs import EnvConfig, KinematicVecEnv, Pushes, QuestEnv, QuestVecEnv, QuestVectorEnv, Terrain
from envs.options import config_from
from envs.starts import Starts
from questsim.errors import InputError
from questsim.reward import TERMS, RewardConfig

CLIPS = [swaying_clip("a", 1.75), swaying_clip("b", 1.6, frames=50), swaying_clip("c", 1.9)]
INFO = {
    *TERMS, "error_m", "fell", "clip", "frame", "floor_m", "push_n", "foot_force_n",
    "object_pose", "object_force_n",
}  # fmt: skip
FACES = [QuestEnv, QuestVectorEnv, QuestVecEnv, KinematicVecEnv]


def made(face: Any, **options: Any) -> Any:
    count = {} if face is QuestEnv else {"num_envs": 2}
    return face(motions=CLIPS, **count, **options)


def first_obs(env: Any, **options: Any) -> np.ndarray:
    obs = env.reset(**options)
    return obs[0] if isinstance(obs, tuple) else obs


def plan(steps: int, n: int, scale: float = 0.6) -> np.ndarray:
    return np.random.default_rng(7).normal(0.0, scale, (steps, n, 33)).clip(-1, 1).astype("f4")


# -- seeds ---------------------------------------------------------------------------------


@pytest.mark.parametrize("face", FACES)
def test_unseeded_resets_differ_and_seeded_environments_agree(face: Any) -> None:
    one, other = made(face), made(face)
    # Three clips hold few starts: a single reset of each coincides once in some hundred runs.
    assert any(not np.array_equal(first_obs(one), first_obs(other)) for _ in range(8))
    np.testing.assert_array_equal(first_obs(made(face, seed=4)), first_obs(made(face, seed=4)))
    fixed = EnvConfig(fixed_start=True)
    same = [first_obs(made(face, config=fixed)) for _ in range(2)]
    np.testing.assert_array_equal(same[0], same[1])


def test_a_seed_of_reset_decides_all_that_follows() -> None:
    config = EnvConfig(
        terrain=Terrain("rough", size_m=12.0), pushes=Pushes(pause_s=(0.1, 0.3)), sampling="failure"
    )
    histories = []
    for env in (QuestEnv(CLIPS, config), QuestEnv(CLIPS, config, seed=99)):
        env.reset()
        env.step(plan(1, 1)[0, 0])
        history = [env.reset(seed=3)[0]]
        for action in plan(60, 1)[:, 0]:
            obs, _, terminated, truncated, info = env.step(action)
            history += [obs, info["push_n"]]
            if terminated or truncated:
                history.append(env.reset()[0])
        histories.append(np.concatenate(history))
    np.testing.assert_array_equal(histories[0], histories[1])


def test_each_environment_of_a_vector_has_a_seed_of_its_own() -> None:
    vector = QuestVectorEnv(3, CLIPS)
    obs, _ = vector.reset(seed=5)
    for i in range(3):
        env = QuestEnv(CLIPS, heights=float(vector.sim.heights[i]))
        np.testing.assert_array_equal(env.reset(seed=5 + i)[0], obs[i])
    again, _ = vector.reset(seed=[7, 5, None])
    np.testing.assert_array_equal(again[1, :474], vector.reset(seed=[None, 5, 1])[0][1, :474])


# -- the vector environment ----------------------------------------------------------------


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_the_batch_equals_gymnasiums_vector_of_single_environments(
    mode: AutoresetMode,
) -> None:
    one_size: Any = {"heights": 1.75}
    ours = QuestVectorEnv(3, CLIPS, autoreset_mode=mode, **one_size)
    theirs = SyncVectorEnv([lambda: QuestEnv(CLIPS, **one_size)] * 3, autoreset_mode=mode)
    assert ours.metadata["autoreset_mode"] is ours.autoreset_mode is mode
    results = [env.reset(seed=11) for env in (ours, theirs)]
    over = 0
    for action in plan(60, 3):
        assert_alike(*results)
        results = [env.step(action) for env in (ours, theirs)]
        done = results[0][2] | results[0][3]
        over += done.sum()
        if mode == AutoresetMode.DISABLED and done.any():
            assert_alike(*results)
            results = [env.reset(options={"reset_mask": done}) for env in (ours, theirs)]
    assert over > 3


def assert_alike(ours: Any, theirs: Any) -> None:
    for mine, other in zip(ours[:-1], theirs[:-1], strict=True):
        np.testing.assert_array_equal(mine, other)
    assert_infos_alike(ours[-1], theirs[-1])


def assert_infos_alike(ours: dict[str, Any], theirs: dict[str, Any]) -> None:
    assert set(ours) == set(theirs)
    for name, value in theirs.items():
        if isinstance(value, dict):
            assert_infos_alike(ours[name], value)
            continue
        mask = np.asarray(theirs.get(f"_{name}", np.ones(len(value), bool)))
        for i in np.flatnonzero(mask):
            np.testing.assert_allclose(ours[name][i], value[i], rtol=1e-12)


def test_same_step_hands_over_the_last_observation_and_info() -> None:
    env = QuestVectorEnv(3, CLIPS, autoreset_mode="SAME_STEP")
    env.reset(seed=1)
    for action in plan(60, 3):
        obs, _, terminated, truncated, infos = env.step(action)
        done = terminated | truncated
        if done.any():
            break
    np.testing.assert_array_equal(infos["_final_obs"], done)
    i = int(done.argmax())
    assert infos["final_obs"][i].shape == (475,) and (infos["final_obs"][i] != obs[i]).any()
    assert infos["final_info"]["fell"][i] == terminated[i] and not infos["fell"][i]
    assert infos["final_info"]["error_m"][i] > infos["error_m"][i] == 0.0


def test_disabled_refuses_to_step_an_episode_that_is_over() -> None:
    env = QuestVectorEnv(3, CLIPS, autoreset_mode="DISABLED")
    env.reset(seed=1)
    with pytest.raises(InputError, match="environment 1 is over; reset it"):
        env.reset(options={"clip": ["a", "b", "c"], "frame": [0, 48, 0]})
        for action in plan(60, 3):
            env.step(action)


def test_options_of_a_vector_are_for_all_or_for_each() -> None:
    env = QuestVectorEnv(3, CLIPS)
    infos = env.reset(seed=0, options={"clip": "b", "frame": 7})[1]
    assert infos["clip"].tolist() == [1] * 3 and infos["frame"].tolist() == [7] * 3
    infos = env.reset(options={"clip": [2, None, "a"], "frame": [1, None, 3]})[1]
    assert infos["clip"][[0, 2]].tolist() == [2, 0]
    assert infos["frame"][[0, 2]].tolist() == [1, 3]
    before = env.sim.batch.state.copy()
    mask = np.array([False, True, False])
    infos = env.reset(options={"reset_mask": mask, "clip": "c"})[1]
    assert infos["clip"][1] == 2 and infos["_clip"].tolist() == mask.tolist()
    np.testing.assert_array_equal(env.sim.batch.state[~mask], before[~mask])


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"clip": 0, "frame": 100000}, r"frame'\]: is 100000, not 0 to 70 of clip 'a'"),
        ({"clip": 0, "frame": -5}, r"frame'\]: is -5, not 0 to 70"),
        ({"clip": 0, "frame": 1.5}, "whole number"),
        ({"frame": 5}, "a frame needs a clip"),
        ({"clip": "nobody"}, "no clip is named 'nobody'.*there are a, b, c"),
        ({"clip": 3}, "is 3, not 0 to 2"),
        ({"clips": 1}, "there is no 'clips'"),
        (7, "not a dict"),
    ],
)
def test_options_of_reset_out_of_range_are_refused_and_the_episode_goes_on(
    options: Any, what: str
) -> None:
    for env in (QuestEnv(CLIPS), QuestVectorEnv(2, CLIPS)):
        env.reset(seed=0)
        before = env.sim.batch.state.copy()
        with pytest.raises(InputError, match=what):
            env.reset(seed=1, options=options)
        np.testing.assert_array_equal(env.sim.batch.state, before)


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ({"options": {"clip": [0]}}, "has 1 entries for 2 simulations"),
        ({"options": {"reset_mask": [True, False]}}, "NumPy array of 2 bools"),
        ({"options": {"reset_mask": np.zeros(2, bool)}}, "False everywhere"),
        ({"seed": [1, 2, 3]}, "has 3 entries for 2"),
        ({"seed": -1}, "not a whole number"),
        ({"seed": "x"}, "not a whole number"),
        ({"seed": [1, 2.5]}, r"seed\[1\]"),
    ],
)
def test_masks_and_seeds_of_another_form_are_refused(arguments: Any, what: str) -> None:
    env = QuestVectorEnv(2, CLIPS)
    with pytest.raises(InputError, match=what):
        env.reset(**arguments)


def test_info_is_as_documented_in_both_faces() -> None:
    single, vector = QuestEnv(CLIPS), QuestVectorEnv(2, CLIPS)
    documented = (Path(__file__).parents[1] / "docs" / "environments.md").read_text()
    for infos in (single.reset(seed=0)[1], single.step(plan(1, 1)[0, 0])[-1]):
        assert set(infos) == INFO
        assert isinstance(infos["clip"], int) and isinstance(infos["frame"], int)
        assert infos["push_n"].shape == (3,) and infos["foot_force_n"].shape == (2, 3)
    for infos in (vector.reset(seed=0)[1], vector.step(plan(1, 2)[0])[-1]):
        assert set(infos) == INFO | {f"_{name}" for name in INFO}
        assert all(len(infos[name]) == 2 for name in INFO)
    assert all(f"`{name}`" in documented for name in INFO - set(TERMS))
    # After a reset nothing has been earned yet, whatever the episode before it earned.
    single.step(plan(1, 1)[0, 0])
    fresh = single.reset()[1]
    assert fresh["error_m"] == 0.0 and not fresh["fell"] and fresh["joint_angles"] == 0.0


# -- arguments -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"sensrs": "H"}, "unexpected keyword argument 'sensrs' .did you mean sensors"),
        ({"motions": 7}, "motions: is 7, not a list of clips"),
        ({"motions": [CLIPS[0], "a"]}, r"motions\[1\]: is 'a', not a Clip"),
        ({"max_error_m": np.nan}, "max_error_m is nan"),
        ({"max_error_m": -1}, "max_error_m is -1"),
        ({"max_error_m": np.inf}, "max_error_m is inf"),
        ({"terrain": "moon"}, "unknown terrain 'moon'"),
        ({"terrain": 5}, "terrain is 5; it takes None or Terrain"),
        ({"objects": ["bal"]}, "unknown object 'bal'"),
        ({"objects": 5}, "objects is 5; it takes"),
        ({"reward": {"contct": 0.5}}, "reward: there is no 'contct' .did you mean contact"),
        ({"reward": {"contact": "x"}}, "reward contact: is 'x', not a number"),
        ({"privileged": "yes"}, "privileged is 'yes'; it takes True or False"),
        ({"heights": "tall"}, "heights is 'tall'; it takes"),
        ({"heights": (1.7, 1.6)}, "heights: the least stature, 1.7 m, is above"),
        ({"noise": 0.1}, "noise is 0.1; it takes None or SensorNoise"),
        ({"sensors": None}, "sensors is None; it takes"),
        ({"future_frames": 2.5}, "future_frames is 2.5; it takes a whole number"),
        ({"body_preset": ["x"]}, r"body_preset is \['x'\]; it takes one of"),
        ({"pushes": (1, 2, 3)}, "force_n is"),
        ({"heights": (1.7,)}, r"heights is \(1.7,\); it takes the least and the greatest"),
        ({"terrain": {"tiles": "rough"}}, "tiles is 'rough'; it takes a tuple of names"),
        ({"pushes": {"count": 1.5}}, "count is 1.5, not a whole number"),
        ({"randomisation": {"latency_frames": (0, 2.5)}}, "not a range of whole numbers"),
        ({"noise": {"latency_frames": 1.5}}, "latency_frames is 1.5; it takes a whole number"),
        ({"noise": {"dropout": 2}}, "dropout is 2; it takes a probability"),
        ({"noise": {"position_std_m": -1}}, "position_std_m is -1; it takes a number from 0"),
        ({"reward": {"k_contact": -1}}, "reward k_contact: is -1, not a number from 0 on"),
        ({"starts": {"standing": 2}}, "starts: standing is 2, not a number from 0 to 1"),
        ({"objects": [{"mass_kg": "x"}]}, "mass_kg is 'x', not a number"),
        ({"shown": 5}, "shown: is 5; it takes a list of clips"),
        ({"shown": [None] * 3}, r"shown\[0\]: is None, not a Clip"),
        ({"seed": -1}, "seed: is '-1'"),
        ({"render_mode": "ascii"}, "render_mode: 'ascii' is not a render mode"),
        ({"config": 5}, "config: is 5, not an EnvConfig"),
        ({"config": EnvConfig(), "sensors": "H"}, "has sensors='H.2C', but the id or a keyword"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*render_mode")
def test_arguments_that_cannot_be_used_are_refused_in_one_short_line(
    options: dict[str, Any], what: str
) -> None:
    options = {"motions": CLIPS, **options}
    for make in (lambda: gym.make("QuestSim-v0", **options), lambda: QuestVecEnv(**options)):
        with pytest.raises(InputError, match=what) as refusal:
            make()
        assert "\n" not in str(refusal.value) and len(str(refusal.value)) < 400


@pytest.mark.parametrize("face", [QuestVectorEnv, QuestVecEnv])
def test_a_number_of_simulations_or_threads_is_a_whole_number(face: Any) -> None:
    for count in (0, 2.5, "x", True):
        for name in ("num_envs", "num_threads"):
            with pytest.raises(InputError, match=f"{name}: is .*; it takes a whole number from 1"):
                face(motions=CLIPS, **{"num_envs": 2, name: count})


def test_a_vec_env_refuses_seeds_and_options_of_another_form_at_once() -> None:
    env = QuestVecEnv(CLIPS, num_envs=2)
    with pytest.raises(InputError, match="not a whole number from 0 on"):
        env.seed("x")  # type: ignore[arg-type]
    for options, what in ((5, "neither a dict nor a list"), ([{"clip": 0}], "1 entries for 2")):
        with pytest.raises(InputError, match=what):
            env.set_options(options)  # type: ignore[arg-type]
    env.set_options([{"clip": 0}, {"clip": 9}])
    with pytest.raises(InputError, match=r"options\[1\]\['clip'\]: is 9"):
        env.reset()


@pytest.mark.parametrize("face", FACES)
def test_a_step_before_the_first_reset_is_refused(face: Any) -> None:
    env = made(face)
    action = env.action_space.sample()
    if isinstance(env, QuestVecEnv):
        action = np.stack([action, action])
    with pytest.raises(InputError, match="no episode has begun; call reset"):
        env.step(action)


def test_an_id_and_a_config_that_contradict_it_are_refused() -> None:
    with pytest.raises(InputError, match="has terrain=None, but the id or a keyword asks for"):
        gym.make("QuestSimRough-v0", motions=CLIPS, config=EnvConfig())
    rough = EnvConfig(terrain=envs.terrain_named("rough"), future_frames=3)
    env = gym.make("QuestSimRough-v0", motions=CLIPS, config=rough)
    assert env.unwrapped.sim.config == rough  # type: ignore[attr-defined]


def test_plain_forms_of_options_mean_what_they_say() -> None:
    config = config_from(
        {
            "reward": {"contact": 0.5},
            "pushes": (0, 100),
            "heights": 1.7,
            "objects": "ball",
            "terrain": "rough:seed=3",
            "privileged_frames": 3,
            "randomisation": {"mass": [0.9, 1.1], "friction": 0.8},
            "starts": {"standing": 0.5},
        }
    )
    assert config.reward == RewardConfig(contact=0.5)
    assert config.pushes == Pushes(force_n=(0, 100)) and config.heights == (1.7, 1.7)
    assert config.objects == (envs.WorldObject("ball"),) and config.privileged_frames == (3,)
    assert config.terrain == envs.terrain_named("rough:seed=3")
    assert config.randomisation == envs.Randomisation(mass=(0.9, 1.1), friction=(0.8, 0.8))
    assert config.starts == Starts(standing=0.5)
    config = config_from(
        {"pushes": 80, "heights": np.array([1.5, 1.6]), "future_frames": np.int64(3)}
    )
    assert config.pushes == Pushes(force_n=(80, 80)) and config.heights == (1.5, 1.6)
    assert config.future_frames == 3


@pytest.mark.parametrize("face", FACES)
def test_every_face_takes_the_same_arguments(face: Any) -> None:
    env = made(face, shown=CLIPS, seed=1, render_mode="rgb_array", sensors="H", heights=1.8)
    assert env.sim.heights[0] == 1.8 and env.observation_space.shape[-1] == 367
    assert made(face, config={"sensors": "H"}).sim.config.sensors == "H"
    motions = face(motions="synthetic:stand", **({} if face is QuestEnv else {"num_envs": 1}))
    assert motions.sim.reference.kinds[0] == "stand"


@pytest.mark.parametrize("face", FACES)
@pytest.mark.parametrize(
    "copied",
    [
        lambda env: pickle.loads(pickle.dumps(env)),
        lambda env: cloudpickle.loads(cloudpickle.dumps(env)),
        copy.deepcopy,
    ],
    ids=["pickle", "cloudpickle", "deepcopy"],
)
def test_copies_are_made_anew_from_their_arguments(face: Any, copied: Any) -> None:
    env = made(face, seed=3, sensors="H")
    other = copied(env)
    assert type(other) is face and other.sim is not env.sim
    np.testing.assert_array_equal(first_obs(other), first_obs(env))


def test_a_registered_environment_is_copied_with_its_wrappers() -> None:
    env = gym.make("QuestSim-v0", motions=CLIPS, seed=3)
    env.reset(seed=0)
    for other in (pickle.loads(pickle.dumps(env)), copy.deepcopy(env)):
        np.testing.assert_array_equal(other.reset(seed=2)[0], env.reset(seed=2)[0])


@pytest.mark.parametrize("name", ["QuestSim-v0", "QuestSimHeadset-v0", "QuestSimRough-v0"])
@pytest.mark.filterwarnings("ignore")
def test_gymnasiums_checker_accepts_it_with_its_spec(name: str) -> None:
    check_env(gym.make(name, motions=CLIPS).unwrapped, skip_render_check=True)
