"""The batched environment: what it observes, rewards, ends, and that threads do not matter."""

from __future__ import annotations

import warnings
from dataclasses import replace

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gym_check_env
from helpers import swaying_clip, two_columns
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from envs import BatchSim, EnvConfig, KinematicVecEnv, QuestEnv, QuestVecEnv, QuestVectorEnv
from envs.layout import observation_layout
from envs.randomisation import REAL_DEVICES
from envs.sampler import Sampler
from envs.terrain import Terrain
from questsim import reward
from questsim import rotations as rot
from questsim.body import build_body
from questsim.errors import InputError
from questsim.motion.inverse_dynamics import reference_torques
from questsim.sensors import SENSOR_SETS, SensorNoise, device_poses
from questsim.skeleton import LINKS

CLIPS = [
    swaying_clip("a", 1.75, kind="stand"),
    swaying_clip("b", 1.6, frames=50, kind="wave"),
    swaying_clip("c", 1.9, frames=60, kind="stand"),
]


def actions(n: int, steps: int, scale: float = 0.1) -> np.ndarray:
    return np.random.default_rng(7).normal(0.0, scale, (steps, n, 33))


def hold(env: QuestVecEnv, obs: np.ndarray) -> np.ndarray:
    """Springs towards the coming reference pose: tracks for a while."""
    gain = 4.0 * env.damping / 0.04 / env.torque_limits
    return gain * (obs[:, env.layout["reference_joint_angles"]] - obs[:, :33])


def test_the_observation_has_475_numbers_by_name() -> None:
    layout = observation_layout(EnvConfig())
    sizes = {name: part.stop - part.start for name, part in layout.items()}
    assert (sizes["o_sim"], sizes["o_user"], sizes["o_scale"]) == (312, 162, 1)
    assert layout["o_scale"].stop == 475
    assert observation_layout(EnvConfig(sensors="H"))["o_scale"].stop == 312 + 54 + 1
    assert observation_layout(EnvConfig(future_frames=0))["o_scale"].stop == 312 + 27 + 1


def test_the_observation_equals_a_numpy_computation_from_the_state() -> None:
    env = QuestVecEnv(CLIPS, EnvConfig(), num_envs=3, seed=1)
    env.reset()
    for action in actions(3, 8):
        obs, *_ = env.step(action)
    sim = env.sim
    for i in range(3):
        model = build_body(float(sim.heights[i])).model
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = sim.qpos[i], sim.qvel[i]
        mujoco.mj_forward(model, data)
        expected = _expected_observation(sim, i, model, data)
        np.testing.assert_allclose(obs[i], expected, atol=2e-4, rtol=1e-4)


def _expected_observation(
    sim: BatchSim, i: int, model: mujoco.MjModel, data: mujoco.MjData
) -> np.ndarray:
    to_s = rot.quat_conjugate(rot.yaw_quat(rot.heading(data.qpos[3:7])))
    origin = np.array([data.qpos[0], data.qpos[1], 0.0])
    velocity = np.zeros((16, 6))
    for b in range(16):
        kind = mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(model, data, kind, b + 1, velocity[b], 0)
    clip = CLIPS[sim.clip[i]].scaled(float(sim.heights[i]))
    first = int(sim.frame[i] - sim.reference.start[sim.clip[i]]) + 1
    rows = np.minimum(np.arange(first, first + 6), len(clip) - 1)
    position, quat = device_poses(
        clip.link_position[rows], clip.link_quat[rows], SENSOR_SETS["H+2C"], clip.height_m
    )
    poses = np.concatenate(
        [rot.quat_rotate(to_s, position - origin), two_columns(rot.quat_multiply(to_s, quat))],
        axis=-1,
    )
    return np.concatenate(
        [
            data.qpos[7:],
            data.qvel[6:],
            rot.quat_rotate(to_s, data.xpos[1:] - origin).ravel(),
            two_columns(rot.quat_multiply(to_s, data.xquat[1:])).ravel(),
            rot.quat_rotate(to_s, velocity[:, 3:]).ravel(),
            rot.quat_rotate(to_s, velocity[:, :3]).ravel(),
            rot.quat_rotate(to_s, sim.contact_force[i]).ravel(),
            poses.ravel(),
            [sim.heights[i]],
        ]
    )


def test_rewards_are_the_pure_functions_of_the_state() -> None:
    env = QuestVecEnv(CLIPS, EnvConfig(), num_envs=3, seed=2)
    env.reset()
    sim, config = env.sim, env.sim.config.reward
    for action in actions(3, 5, 0.05):
        previous = sim.contact_force[..., 2].copy()
        env.step(action)
    velocity = np.zeros((3, 16, 3))
    reference = {name: [] for name in ("q", "v", "x", "xd", "turn")}
    for i in range(3):
        model = build_body(float(sim.heights[i])).model
        data = sim.batch.get_data(i)
        out = np.zeros(6)
        for b in range(16):
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, b + 1, out, 0)
            velocity[i, b] = out[3:]
        clip = CLIPS[sim.clip[i]].scaled(float(sim.heights[i]))
        row = int(sim.frame[i] - sim.reference.start[sim.clip[i]])
        reference["q"].append(clip.qpos[row, 7:])
        reference["v"].append(clip.qvel[row, 6:])
        reference["x"].append(clip.link_position[row])
        reference["xd"].append(clip.link_velocity[row])
        reference["turn"].append(clip.link_quat[row])
    q, v, x, xd, turn = (np.array(values) for values in reference.values())
    terms = np.stack(
        [
            reward.tracking(sim.qpos[:, 7:], q, config.k_joint_angles),
            reward.tracking(sim.qvel[:, 6:], v, config.k_joint_velocities),
            reward.link_tracking(sim.link_positions, x, config.k_link_positions),
            reward.link_tracking(velocity, xd, config.k_link_velocities),
            reward.unloading(previous, sim.contact_force[..., 2], config.k_contact),
            reward.turn_tracking(sim.link_quats, turn, config.k_link_orientations),
        ],
        axis=-1,
    )
    np.testing.assert_allclose(sim.reward_terms, terms, atol=1e-4)
    np.testing.assert_allclose(sim.reward, terms @ config.weights, atol=1e-4)
    error = np.linalg.norm(sim.link_positions - x, axis=-1).mean(axis=-1)
    np.testing.assert_allclose(sim.error, error, atol=1e-5)


def test_an_episode_starts_on_the_reference() -> None:
    env = QuestVecEnv(CLIPS, EnvConfig(), num_envs=6, seed=3)
    env.reset()
    sim = env.sim
    for i in range(6):
        clip = CLIPS[sim.clip[i]].scaled(float(sim.heights[i]))
        row = int(sim.frame[i] - sim.reference.start[sim.clip[i]])
        np.testing.assert_allclose(sim.link_positions[i], clip.link_position[row], atol=1e-5)
        np.testing.assert_allclose(sim.qvel[i], clip.qvel[row], atol=1e-5)


def rollout(threads: int, n: int = 7, steps: int = 40) -> tuple[np.ndarray, ...]:
    env = QuestVecEnv(CLIPS, EnvConfig(sampling="failure"), num_envs=n, seed=5, num_threads=threads)
    collected = [env.reset()]
    rewards = []
    for action in actions(n, steps, 0.3):
        obs, r, _, _ = env.step(action)
        collected.append(obs)
        rewards.append(r)
    env.close()
    return np.array(collected), np.array(rewards)


def test_same_seed_same_bits_at_one_and_two_threads() -> None:
    one, two = rollout(1), rollout(2)
    np.testing.assert_array_equal(one[0], two[0])
    np.testing.assert_array_equal(one[1], two[1])


def test_another_seed_gives_other_episodes() -> None:
    first = QuestVecEnv(CLIPS, num_envs=7, seed=5).reset()
    assert not np.array_equal(first, QuestVecEnv(CLIPS, num_envs=7, seed=6).reset())


def test_a_single_environment_is_a_row_of_the_batch_bit_for_bit() -> None:
    # A limit that is never reached: only the faces that many share begin anew by themselves.
    config = EnvConfig(fixed_start=True, max_error_m=99.0)
    batch = QuestVecEnv(CLIPS[:1], config, num_envs=1)
    wide = QuestVecEnv(CLIPS, config)
    single = QuestEnv(CLIPS[:1], config)
    obs, wide_obs = batch.reset(), wide.reset()
    single_obs, _ = single.reset(options={"clip": "a"})
    for action in actions(3, 30, 0.05).astype(np.float32):
        np.testing.assert_array_equal(obs[0], single_obs)
        np.testing.assert_array_equal(obs[0], wide_obs[0])
        obs, r, *_ = batch.step(action[:1])
        wide_obs, *_ = wide.step(action)
        single_obs, single_r, *_ = single.step(action[0])
        assert np.float32(single_r) == r[0]


def test_a_falling_avatar_terminates_and_a_finished_clip_truncates() -> None:
    env = QuestVecEnv(CLIPS[1:2], EnvConfig(fixed_start=True, max_error_m=0.2))
    env.reset()
    for _ in range(60):
        _, _, dones, infos = env.step(np.zeros((1, 33)))
        if dones[0]:
            break
    assert infos[0]["fell"] and not infos[0]["TimeLimit.truncated"]
    episode, weights = infos[0]["episode"], env.sim.config.reward.weights
    mean = sum(w * infos[0][term] for w, term in zip(weights, reward.TERMS, strict=True))
    assert mean == pytest.approx(episode["r"] / episode["l"])
    assert infos[0]["clip"] == "b" and infos[0]["kind"] == "wave"

    env = QuestVecEnv(CLIPS[1:2], EnvConfig(fixed_start=True, privileged=True, max_error_m=9.0))
    obs = env.reset()
    step = 0
    while not (step and dones[0]):
        obs, _, dones, infos = env.step(hold(env, obs))
        step += 1
    assert step == len(CLIPS[1]) - 1
    assert infos[0]["TimeLimit.truncated"] and not infos[0]["fell"]
    assert infos[0]["episode"]["l"] == step
    assert not np.array_equal(infos[0]["terminal_observation"], obs[0])


def test_a_tracker_observes_the_pose_midway_and_the_torques_of_the_motion() -> None:
    sim = BatchSim(CLIPS[:1], EnvConfig(fixed_start=True, privileged=True, heights=(1.4, 1.4)))
    sim.reset()
    sim.step(np.zeros((1, 33)))
    clip, seen = CLIPS[0].scaled(1.75), sim.observation[0]
    midway, takes = clip.qpos[1:3, 7:].mean(0), reference_torques([clip])[1:3].mean(0)
    np.testing.assert_allclose(seen[sim.layout["midway_joint_angles"]], midway, atol=1e-5)
    np.testing.assert_allclose(seen[sim.layout["reference_torques"]], 0.8 * takes, atol=1e-5)


def test_a_tracker_observes_the_error_of_each_link() -> None:
    sim = BatchSim(CLIPS[:1], EnvConfig(fixed_start=True, privileged=True, heights=(1.6, 1.6)))
    sim.reset()
    part = sim.layout["tracking_errors"]
    assert np.abs(sim.observation[0, part]).max() < 0.01  # it begins on the reference
    for _ in range(3):
        sim.step(np.zeros((1, 33)))
    errors = sim.observation[0, part].reshape(16, 12)
    clip = CLIPS[0].scaled(1.6)
    from_s = rot.yaw_quat(rot.heading(sim.qpos[0, 3:7]))
    velocity, data = np.zeros((16, 6)), sim.batch.get_data(0)
    for b in range(16):
        kind = mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(build_body(1.6).model, data, kind, b + 1, velocity[b], 0)
    turn = rot.quat_multiply(clip.link_quat[3], rot.quat_conjugate(sim.link_quats[0]))
    turn = turn * np.sign(turn[:, :1])
    for column, expected in (
        (0, clip.link_position[3] - sim.link_positions[0]),
        (3, 2.0 * turn[:, 1:]),
        (6, clip.link_velocity[3] - velocity[:, 3:]),
        (9, clip.link_angular_velocity[3] - velocity[:, :3]),
    ):
        seen = rot.quat_rotate(from_s, errors[:, column : column + 3])
        np.testing.assert_allclose(seen, expected, atol=2e-3)


def test_heights_are_spread_and_clips_scaled_to_them() -> None:
    env = QuestVecEnv(CLIPS, EnvConfig(heights=(1.4, 2.0)), num_envs=4)
    env.reset()
    np.testing.assert_allclose(env.sim.heights, [1.4, 1.6, 1.8, 2.0])
    np.testing.assert_allclose(env.sim.observation[:, 474], env.sim.heights, rtol=1e-6)
    head = env.sim.link_positions[:, LINKS.index("head"), 2]
    np.testing.assert_allclose(head / env.sim.heights, head[0] / 1.4, rtol=0.02)


def test_physics_that_is_not_finite_ends_the_episode_and_is_counted() -> None:
    env = QuestVecEnv(CLIPS, EnvConfig(), num_envs=3, seed=0)
    env.reset()
    env.sim.qvel[1] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        obs, rewards, dones, infos = env.step(np.zeros((3, 33)))
    assert list(dones) == [False, True, False] and infos[1]["fell"]
    assert env.sim.unstable_count == 1
    assert np.isfinite(obs).all() and np.isfinite(rewards).all()
    assert np.isfinite(infos[1]["terminal_observation"]).all()
    _, _, dones, _ = env.step(np.zeros((3, 33)))
    assert not dones[1]


def test_terms_that_are_not_finite_are_zero_in_reward_and_info() -> None:
    sim = BatchSim(CLIPS, EnvConfig(fixed_start=True))
    sim.reset()
    sim.qpos[1, 8] = np.nan
    sim._after_step()
    assert sim.unstable.tolist() == [False, True, False]
    assert sim.reward[1] == 0.0 and (sim.reward_terms[1] == 0.0).all()
    assert np.isfinite(sim.observation).all() and np.isfinite(sim.reward_terms).all()


def resumable(seed: int) -> QuestVecEnv:
    return QuestVecEnv(CLIPS, EnvConfig(sampling="failure"), num_envs=5, seed=seed)


def test_a_restored_environment_goes_on_to_the_bit() -> None:
    env = resumable(seed=9)
    env.reset()
    plan = actions(5, 60, 0.5)
    for action in plan[:30]:
        env.step(action)
    other = resumable(seed=1)
    other.seed(4)  # as a learner does when it is made
    other.set_state(env.get_state())
    np.testing.assert_array_equal(other.reset(), env.sim.observation)
    ended = 0
    for action in plan[30:]:
        here, there = env.step(action), other.step(action)
        for a, b in zip(here[:3], there[:3], strict=True):
            np.testing.assert_array_equal(a, b)
        ended += here[2].sum()
        for a, b in zip(here[3], there[3], strict=True):
            assert a.get("episode", {}).get("r") == b.get("episode", {}).get("r")
            assert a.get("contact") == b.get("contact")
    assert ended > 5
    np.testing.assert_array_equal(other.reset(), env.reset())


def test_a_state_of_another_number_of_environments_is_refused() -> None:
    with pytest.raises(InputError, match="of 5 simulations"):
        QuestVecEnv(CLIPS, num_envs=2).set_state(resumable(seed=0).get_state())


def test_clips_that_fail_come_more_often_and_none_is_forgotten() -> None:
    sim = BatchSim(CLIPS, EnvConfig(sampling="failure"), num_envs=1)
    sampler = Sampler(sim.reference, weighted=True)
    for _ in range(30):
        sampler.record(np.array([0, 1, 2]), np.zeros(3, int), np.full(3, 9), np.arange(3) == 2)
    drawn, first = sampler.draw(np.random.default_rng(0).random((4000, 2)))
    share = np.bincount(drawn, minlength=3) / 4000
    assert share[2] > 2 * share[0] and share.min() > 0.02
    lengths = np.array([len(c) for c in CLIPS])
    assert (first < lengths[drawn] - 1).all()


@pytest.mark.parametrize("options", [{"num_envs": 0}, {"num_envs": -3}, {"num_threads": 0}])
def test_no_environments_and_no_threads_are_refused(options: dict) -> None:
    with pytest.raises(InputError, match="takes a whole number from 1 on"):
        BatchSim(CLIPS, **options)
    with pytest.raises(InputError, match="no clips"):
        BatchSim([])


def test_a_motion_shorter_than_the_future_window_is_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"short.*6 frames"):
        BatchSim([swaying_clip("short", frames=6)], EnvConfig())
    BatchSim([swaying_clip("short", frames=6)], EnvConfig(future_frames=2))


@pytest.mark.parametrize(
    "options",
    [
        {"sensors": "X"},
        {"sensors": "H+2C+2IMU"},
        {"future_frames": 7},
        {"sampling": "y"},
        {"heights": (1.0, 2.0)},
    ],
)
def test_impossible_options_are_refused(options: dict) -> None:
    with pytest.raises(InputError):
        EnvConfig(**options)


def test_noise_disturbs_only_what_the_policy_sees() -> None:
    clean = BatchSim(CLIPS, EnvConfig(fixed_start=True))
    noisy = BatchSim(
        CLIPS, EnvConfig(fixed_start=True, noise=SensorNoise(position_std_m=0.02)), seed=3
    )
    clean.reset()
    noisy.reset()
    user = clean.layout["o_user"]
    difference = np.abs(noisy.observation - clean.observation)
    assert difference[:, user].max() > 0.01
    difference[:, user] = 0.0
    assert difference.max() == 0.0


@pytest.mark.parametrize("name", ["QuestSim-v0", "QuestSimHeadset-v0"])
def test_both_libraries_accept_the_environment(name: str) -> None:
    env = gym.make(name, motions=CLIPS)
    size = {"QuestSim-v0": 475, "QuestSimHeadset-v0": 367}[name]
    assert env.observation_space.shape == (size,)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        gym_check_env(env.unwrapped, skip_render_check=True)
        sb3_check_env(env.unwrapped)
    env.close()


def test_make_vec_gives_the_batch_and_the_same_steps_as_the_vecenv() -> None:
    vector = gym.make_vec("QuestSim-v0", num_envs=4, motions=CLIPS, autoreset_mode="SAME_STEP")
    assert isinstance(vector.unwrapped, QuestVectorEnv)
    sb3 = QuestVecEnv(CLIPS, num_envs=4)
    obs, _ = vector.reset(seed=3)
    sb3.seed(3)
    np.testing.assert_array_equal(obs, sb3.reset())
    for action in actions(4, 40, 0.5).astype(np.float32):
        obs, r, fell, ended, infos = vector.step(action)
        sb3_obs, sb3_r, dones, _ = sb3.step(action)
        np.testing.assert_array_equal(obs, sb3_obs)
        np.testing.assert_array_equal(fell | ended, dones)
        np.testing.assert_array_equal(r.astype(np.float32), sb3_r)
    assert set(reward.TERMS) <= set(infos)


def test_reward_terms_are_in_info_by_name() -> None:
    env = QuestEnv(CLIPS)
    env.reset(seed=0)
    _, total, _, _, info = env.step(np.zeros(33, np.float32))
    weights = dict(zip(reward.TERMS, env.sim.config.reward.weights, strict=True))
    assert total == pytest.approx(sum(weights[t] * info[t] for t in reward.TERMS))


def test_poses_of_the_reference_score_full_marks_without_physics() -> None:
    env = KinematicVecEnv(CLIPS, EnvConfig(fixed_start=True))
    env.reset()
    for frame in range(1, 20):
        poses = np.stack([clip.qpos[frame] for clip in CLIPS])
        _, _, dones, _ = env.step(poses)
        assert not dones.any()
        assert env.sim.error.max() < 1e-5
        assert env.reward_terms[:, 0].min() > 0.999
        for i, clip in enumerate(CLIPS):
            expected = np.zeros(39)
            mujoco.mj_differentiatePos(
                build_body().model, expected, 1 / 36, clip.qpos[frame - 1], clip.qpos[frame]
            )
            np.testing.assert_allclose(env.sim.qvel[i], expected, atol=1e-4)
    with pytest.raises(InputError, match="not a finite number"):
        env.step(np.full((3, 40), np.nan))


def test_headset_alone_drops_the_controllers_from_the_observation() -> None:
    both = BatchSim(CLIPS, EnvConfig(fixed_start=True))
    alone = BatchSim(CLIPS, replace(EnvConfig(fixed_start=True), sensors="H"))
    both.reset()
    alone.reset()
    headset = both.observation[:, both.layout["o_user"]].reshape(3, 6, 3, 9)[:, :, 0]
    np.testing.assert_array_equal(
        alone.observation[:, alone.layout["o_user"]].reshape(3, 6, 9), headset
    )


def test_a_teacher_observes_its_own_devices_without_errors_beside_its_students() -> None:
    own = EnvConfig(sensors="H", future_frames=0, teacher_devices=("H+2C", 6))
    config = replace(own, randomisation=REAL_DEVICES, terrain=Terrain("rough", size_m=16.0))
    sim = BatchSim(CLIPS, config, num_envs=4, seed=2)
    exact = BatchSim(CLIPS, replace(EnvConfig(), terrain=config.terrain), num_envs=4, seed=2)
    for each in (sim, exact):
        each.reset()
        each.step(np.zeros((4, 33)))
    assert "o_teacher" not in exact.layout
    np.testing.assert_array_equal(
        sim.observation[:, sim.layout["o_teacher"]], exact.observation[:, exact.layout["o_user"]]
    )
    assert np.abs(sim.observation[:, sim.layout["o_user"]]).max() > 0.0
    for wrong, message in (((1, 6), "takes the name"), (("H", 99), "future_frames is 99")):
        with pytest.raises(InputError, match=message):
            replace(own, teacher_devices=wrong)
