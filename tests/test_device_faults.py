"""Noise, mounts, jitter and recentring of the devices in the environments."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import swaying_clip
from test_terrain import gliding_clip

from agents.run_folder import check_same_run
from agents.training.options import TrainArgs
from envs import BatchSim, EnvConfig, Randomisation, Terrain
from envs.config import MAX_ERROR_M
from questsim.errors import InputError

CLIPS = [swaying_clip("a", 1.75, frames=90), swaying_clip("b", 1.6, frames=90)]


def devices(
    options: Randomisation | None, frames: int = 40, threads: int = 1, future: int = 6
) -> np.ndarray:
    """``(frames + 1, 2, k, 3, 9)`` o_user of two avatars held in their first pose."""
    config = EnvConfig(fixed_start=True, future_frames=future, randomisation=options)
    sim = BatchSim(CLIPS, config, seed=3, num_threads=threads)
    sim.reset()
    pose, seen = sim.qpos[:, :40].copy(), []
    for frame in range(frames + 1):
        if frame:
            sim.show(pose)
        user = sim.observation[:, sim.layout["o_user"]]
        seen.append(user.reshape(2, max(future, 1), 3, 9).astype(float))
    sim.close()
    return np.array(seen)


def test_noise_has_its_size_and_a_frame_keeps_it_in_every_window_at_any_thread_count() -> None:
    options = Randomisation(noise_m=(0.005, 0.005), noise_rad=(0.0175, 0.0175))
    noisy, clean = devices(options), devices(None)
    difference = noisy - clean
    assert np.std(difference[..., :3]) == pytest.approx(0.005, rel=0.1)
    # Each column of the rotation is turned about two axes that are perpendicular to it.
    assert np.std(difference[..., 3:]) == pytest.approx(0.0175 * np.sqrt(2 / 3), rel=0.1)
    assert abs(difference[..., :3].mean()) < 0.0005
    np.testing.assert_allclose(noisy[1:, :, :-1], noisy[:-1, :, 1:], atol=1e-6)
    steps = difference[:, :, 0, :, 0]
    assert abs(np.corrcoef(steps[1:].ravel(), steps[:-1].ravel())[0, 1]) < 0.3
    np.testing.assert_array_equal(noisy, devices(options, threads=2))


def test_mounts_are_constant_in_an_episode_and_within_their_limits() -> None:
    mounted = devices(Randomisation(mount_m=(0.0, 0.03), mount_rad=(0.0, 0.17)))
    clean = devices(None)
    distance = np.linalg.norm((mounted - clean)[..., :3], axis=-1)
    assert 0.005 < distance.max() < 0.0301
    np.testing.assert_allclose(distance, distance[:1] + np.zeros_like(distance), atol=1e-5)
    assert len(np.unique(np.round(distance[0, :, 0], 5))) == 6, "each device has its own mount"
    columns = (mounted[..., 3:] * clean[..., 3:]).reshape(*mounted.shape[:-1], 2, 3).sum(axis=-1)
    assert 0.01 < np.arccos(np.clip(columns, -1, 1)).max() < 0.171


def test_jitter_delays_frames_by_at_most_its_limit_and_never_goes_back() -> None:
    clean = devices(None, future=0)[:, 0, 0]
    late = devices(Randomisation(latency_jitter_frames=(3, 3)), future=0)[:, 0, 0]
    delay = np.array(
        [
            [t - np.argmin(np.abs(clean[: t + 1, d] - late[t, d]).sum(axis=-1)) for d in range(3)]
            for t in range(len(late))
        ]
    )
    assert delay.max() == 3 and delay.min() == 0 and len(np.unique(delay)) == 4
    assert (np.diff(np.arange(len(delay))[:, None] - delay, axis=0) >= 0).all()


def test_late_and_silent_devices_show_no_other_clip() -> None:
    options = Randomisation(latency_frames=(5, 5), dropout=(1.0, 1.0), dropout_frames=(9, 9))
    shown, clean = devices(options, 3, future=0), devices(None, 3, future=0)
    np.testing.assert_array_equal(shown[1:], np.broadcast_to(clean[:1], shown[1:].shape))


@pytest.mark.parametrize("terrain", [None, Terrain("rough", size_m=16.0, amplitude_m=0.06)])
def test_a_recentred_user_jumps_with_the_reference(terrain: Terrain | None) -> None:
    jump = Randomisation(recentre_m=(0.2, 0.3), recentre_rad=(0.3, 0.5), recentre_s=(0.4, 0.6))
    clips = [gliding_clip(1.0), gliding_clip(1.5, heading=1.0)]
    config = EnvConfig(
        fixed_start=True, randomisation=jump, terrain=terrain, max_error_m=MAX_ERROR_M
    )
    placed: list[np.ndarray] = []
    for attempt in range(2):  # first to learn the places, then to follow them
        sim = BatchSim(clips, config, seed=1)
        sim.reset()
        start, errors = sim.qpos[:, :40].copy(), []
        for frame in range(1, 36):
            sim.show(np.array([p[frame] for p in placed]) if attempt else start)
            errors.append(sim.error.copy())
        placed = [sim.placed_clip(i, clip).qpos for i, clip in enumerate(clips)]
        sim.close()
    assert np.max(errors) < 2e-3
    for qpos in placed:
        step = np.linalg.norm(np.diff(qpos[:, :2], axis=0), axis=-1)
        assert 14 <= step.argmax() <= 22 and 0.15 < step.max() < 0.36
        assert np.median(step) < 0.05


def test_faults_are_restored_to_the_bit() -> None:
    config = EnvConfig(
        randomisation=Randomisation(
            latency_frames=(0, 2), latency_jitter_frames=(0, 3), dropout=(0.05, 0.1),
            noise_m=(0.0, 0.01), mount_rad=(0.0, 0.2), recentre_m=(0.1, 0.3), recentre_s=(0.1, 1.0),
        )
    )  # fmt: skip
    plan = np.random.default_rng(7).normal(0.0, 0.3, (40, 4, 33))

    def played(sim: BatchSim, actions: np.ndarray) -> np.ndarray:
        seen = []
        for action in actions:
            sim.step(action)
            seen.append(sim.observation.copy())
            if (sim.fell | sim.ended).any():
                sim.reset(np.flatnonzero(sim.fell | sim.ended))
        return np.array(seen)

    sim = BatchSim(CLIPS, config, num_envs=4, seed=9)
    sim.reset()
    played(sim, plan[:20])
    state = sim.get_state()
    expected = played(sim, plan[20:])
    other = BatchSim(CLIPS, config, num_envs=4, seed=9, num_threads=2)
    other.set_state(state)
    np.testing.assert_array_equal(played(other, plan[20:]), expected)


def test_a_run_recorded_before_an_option_existed_can_be_resumed(tmp_path) -> None:
    args = TrainArgs(tmp_path)
    old = {"args": {"randomisation": {"friction": [1.0, 1.0]}}, "data": {"sha256": "x"}}
    check_same_run(old, args, {"sha256": "x"}, {"out"}, tmp_path)
    old["args"]["randomisation"] = {"friction": [0.5, 1.0]}
    with pytest.raises(
        InputError, match=r"--randomisation.friction was \[0.5, 1.0\], not \[1.0, 1.0\]"
    ):
        check_same_run(old, args, {"sha256": "x"}, {"out"}, tmp_path)
