"""Devices on the body, IMU signals, noise, and the reward's terms by hand."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from helpers import swaying_clip
from scipy.spatial.transform import Rotation

from questsim import reward
from questsim import rotations as rot
from questsim.body import build_body
from questsim.errors import InputError
from questsim.sensors import (
    DEVICES,
    SENSOR_SETS,
    SensorNoise,
    device_poses,
    imu_signal,
    sensor_set,
)


def test_devices_sit_where_the_bodys_sites_are() -> None:
    clip = swaying_clip(height_m=1.6)
    names = SENSOR_SETS["H+2C"]
    position, quat = device_poses(clip.link_position, clip.link_quat, names, 1.6)
    model = build_body(1.6).model
    data = mujoco.MjData(model)
    data.qpos[:] = clip.qpos[20]
    mujoco.mj_forward(model, data)
    for index, name in enumerate(names):
        np.testing.assert_allclose(position[20, index], data.site(name).xpos, atol=1e-9)
        matrix = data.site(name).xmat.reshape(3, 3)
        np.testing.assert_allclose(rot.quat_to_matrix(quat[20, index]), matrix, atol=1e-7)


def test_sets_have_the_devices_their_names_say() -> None:
    kinds = {name: [DEVICES[d].kind for d in devices] for name, devices in SENSOR_SETS.items()}
    assert kinds["H"] == ["headset"]
    assert kinds["H+2C"] == ["headset", "controller", "controller"]
    assert kinds["H+2C+2IMU"].count("imu") == 2 and kinds["H+2C+3IMU"].count("imu") == 3
    assert [len(kinds[name]) for name in ("6T", "4T", "3T")] == [6, 4, 3]
    with pytest.raises(InputError, match="unknown sensor set 'H\\+3C'"):
        sensor_set("H+3C")


def test_imu_of_a_circular_motion_points_to_the_centre_and_is_causal() -> None:
    fps, spin, radius = 360.0, 2.0, 0.5
    angle = spin * np.arange(720) / fps
    position = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)[:, None]
    quat = rot.as_quat(Rotation.from_rotvec(angle[:, None] * [0, 0, 1]))[:, None]
    signal = imu_signal(position, quat, fps)
    np.testing.assert_allclose(signal.angular_velocity[5:, 0], [[0, 0, spin]] * 715, atol=1e-6)
    inward = np.sum(signal.acceleration[5:, 0] * -position[4:-1, 0] / radius, axis=-1)
    np.testing.assert_allclose(inward, spin**2 * radius, rtol=1e-3)
    shorter = imu_signal(position[:300], quat[:300], fps)
    np.testing.assert_array_equal(shorter.acceleration, signal.acceleration[:300])


def test_noise_latency_and_dropout() -> None:
    rng = np.random.default_rng(0)
    position = np.cumsum(np.ones((400, 2, 3)), axis=0)
    quat = np.tile([1.0, 0, 0, 0], (400, 2, 1))
    late, _ = SensorNoise(latency_frames=3).apply(position, quat, rng)
    np.testing.assert_array_equal(late[3:], position[:-3])
    noisy, turned = SensorNoise(position_std_m=0.1, rotation_std_rad=0.2).apply(position, quat, rng)
    assert np.std(noisy - position) == pytest.approx(0.1, rel=0.1)
    angles = rot.angle_between(turned, quat)
    assert np.sqrt(np.mean(angles**2) / 3) == pytest.approx(0.2, rel=0.1)
    dropped, _ = SensorNoise(dropout=0.05, dropout_frames=10).apply(position, quat, rng)
    repeats = (np.diff(dropped[:, 0, 0]) == 0).mean()
    assert 0.1 < repeats < 0.6
    clean, _ = SensorNoise().apply(position, quat, rng)
    np.testing.assert_array_equal(clean, position)


def test_a_device_mounted_off_keeps_its_place_on_the_link_while_that_turns():
    turning = Rotation.from_rotvec(np.linspace(0.0, 2.0, 50)[:, None] * [0.0, 0.0, 1.0])
    quat = rot.as_quat(turning)[:, None].repeat(2, axis=1)
    position = np.zeros((50, 2, 3))
    noise = SensorNoise(mount_m=0.03, mount_rad=0.17)
    moved, turned = noise.apply(position, quat, np.random.default_rng(0))
    for device in range(2):
        inside = turning.inv().apply(moved[:, device])
        np.testing.assert_allclose(inside, np.tile(inside[0], (50, 1)), atol=1e-12)
        assert 0.0 < np.linalg.norm(inside[0]) <= 0.03
        off = turning.inv() * rot.as_rotation(turned[:, device])
        assert 0.0 < off.magnitude().max() <= 0.17


def test_terms_of_a_hand_computed_case() -> None:
    a, b = np.zeros((1, 33)), np.full((1, 33), 0.1)
    assert reward.tracking(a, b, 40.0)[0] == pytest.approx(np.exp(-0.4))
    links = np.zeros((1, 16, 3))
    moved = links.copy()
    moved[0, :8, 0] = 0.2
    assert reward.link_tracking(links, moved, 6.0)[0] == pytest.approx(np.exp(-6 * 0.04 / 2))
    previous, now = np.array([[300.0, 400.0]]), np.array([[250.0, 500.0]])
    assert reward.unloading(previous, now, 0.01)[0] == pytest.approx(np.exp(-0.5))
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (1, 2, 1))
    turned = upright.copy()
    turned[0, 1] = [-np.cos(0.2), 0.0, 0.0, -np.sin(0.2)]  # 0.4 rad, by the other quaternion
    assert reward.turn_tracking(upright, turned, 10.0)[0] == pytest.approx(np.exp(-10 * 0.16 / 2))


def test_default_weights_and_published_kernels() -> None:
    np.testing.assert_array_equal(reward.RewardConfig().weights, [0.4, 0.1, 0.2, 0.1, 0.2, 0.0])
    np.testing.assert_array_equal(reward.PAPER_REWARD.kernels, [40.0, 0.3, 6.0, 2.0, 0.01, 10.0])
