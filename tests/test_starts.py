"""How episodes begin when it is not in the reference's own state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import swaying_clip

from envs.config import EnvConfig
from envs.core import BatchSim
from envs.sampler import Sampler
from envs.starts import Starts
from envs.terrain import terrain_named
from questsim.errors import InputError

CLIPS = [swaying_clip(height_m=1.75, frames=40)] * 6


def sim_with(starts: Starts, **options) -> BatchSim:
    sim = BatchSim(CLIPS, EnvConfig(starts=starts, **options), 64, seed=3)
    sim.reset()
    return sim


@pytest.mark.parametrize("terrain", [None, "rough"])
def test_a_standing_start_is_upright_at_rest_with_a_sole_on_the_ground(terrain):
    ground = None if terrain is None else terrain_named(terrain)
    sim = sim_with(Starts(standing=1.0), terrain=ground)
    assert not sim.qvel.any()
    assert not sim.joint_angles.any()
    np.testing.assert_allclose(sim.qpos[:, 4:6], 0.0, atol=1e-9)
    np.testing.assert_allclose(sim.foot_clearance.min(1), 0.0, atol=1e-6)


def test_disturbed_starts_are_off_by_no_more_than_asked_and_never_in_the_ground():
    still = sim_with(Starts(), fixed_start=False)
    starts = Starts(disturbed=1.0, lean_m=0.1, speed_m_s=0.6, place_m=0.0, joints_rad=0.0)
    sim = sim_with(starts)
    speed = np.linalg.norm(sim.qvel[:, :2], axis=1)
    # The root is about as high as the centre of mass.
    assert 0.3 < np.max(speed) < 0.9
    lean = 2 * np.arccos(np.clip(np.abs(sim.qpos[:, 3]), 0, 1))
    assert 0.05 < np.max(lean) < 0.2
    assert sim.foot_clearance.min() > -1e-6
    assert not np.allclose(sim.qpos[:, :3], still.qpos[:, :3])


def test_disturbed_starts_may_be_in_mid_air():
    starts = Starts(
        disturbed=1.0, lean_m=0.0, speed_m_s=0.0, place_m=0.0, joints_rad=0.0, lift_m=0.1
    )
    on_the_ground = sim_with(replace(starts, lift_m=0.0))
    lifted = sim_with(starts).qpos - on_the_ground.qpos
    assert 0.08 < lifted[:, 2].max() <= 0.1 and lifted[:, 2].min() >= 0.0
    np.testing.assert_allclose(np.delete(lifted, 2, axis=1), 0.0, atol=1e-9)


def test_shares_of_episodes_begin_as_asked():
    sim = sim_with(Starts(standing=0.25, disturbed=0.25))
    standing = ~sim.qvel.any(axis=1) & ~sim.joint_angles.any(axis=1)
    assert 5 <= standing.sum() <= 28


def test_invalid_starts_are_refused():
    with pytest.raises(InputError, match="at most 1"):
        Starts(standing=0.7, disturbed=0.7)
    with pytest.raises(InputError, match="lean_m"):
        Starts(lean_m=-0.1)


def test_a_rare_kind_comes_more_often_than_its_frames():
    many = [replace(CLIPS[0], kind="walk") for _ in range(16)]
    sim = BatchSim([*many, replace(CLIPS[0], kind="bow")], EnvConfig(), 1)
    numbers = np.random.default_rng(0).random((4000, 2))
    clips, _ = Sampler(sim.reference, weighted=True, by_kind=True).draw(numbers)
    # Kinds of 16 to 1 frames come 4 to 1.
    assert np.mean(clips == 16) == pytest.approx(0.2, abs=0.03)


@pytest.mark.parametrize("by_kind", [False, True])
def test_weights_multiply_how_often_clips_are_drawn(by_kind: bool) -> None:
    clips = [replace(CLIPS[0], kind=kind, weight=weight) for kind, weight in (("a", 3.0), ("b", 1))]
    sim = BatchSim(clips, EnvConfig(), 1)
    numbers = np.random.default_rng(0).random((4000, 2))
    drawn, _ = Sampler(sim.reference, weighted=True, by_kind=by_kind).draw(numbers)
    assert np.mean(drawn == 0) == pytest.approx(0.75, abs=0.03)


def test_variations_count_as_the_kind_that_they_vary():
    """Else a fifth of variations, each of a kind of its own, would be half of the samples."""
    changes = ("crouch", "bow", "reach", "crouch+reach")
    varied = [replace(CLIPS[0], kind=f"walk+{change}") for change in changes]
    walks = [replace(CLIPS[0], kind="walk") for _ in range(12)]
    sim = BatchSim([*walks, *varied, replace(CLIPS[0], kind="bow")], EnvConfig(), 1)
    numbers = np.random.default_rng(0).random((4000, 2))
    clips, _ = Sampler(sim.reference, weighted=True, by_kind=True).draw(numbers)
    assert np.mean(clips == 16) == pytest.approx(0.2, abs=0.03)
    assert np.mean((clips >= 12) & (clips < 16)) == pytest.approx(0.2, abs=0.03)


def test_a_still_start_has_the_references_pose_at_rest():
    sim = sim_with(Starts(still=1.0), fixed_start=False)
    assert not sim.qvel.any()
    rows = sim.reference.qpos[sim.frame]
    np.testing.assert_allclose(sim.joint_angles, rows[:, 7:], atol=1e-6)
