"""The reference on ground that is not level: when feet stand, and where."""

from __future__ import annotations

import numpy as np
import pytest
from test_terrain import CLIPS, STANDING, gliding_clip

from envs import BatchSim, EnvConfig, Terrain
from envs.footed_clip import footed_clip
from envs.footsteps import footsteps_of, steps_of_foot
from envs.terrain import height_field
from questsim.heightfield import HeightField
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import clip_from_qpos, sole_positions
from questsim.motion.spec import load_motions
from questsim.skeleton import DOFS, FOOT_LINKS, LINKS

FEET = list(FOOT_LINKS)


def soles(of: Clip) -> np.ndarray:
    return sole_positions(of.link_position[:, FEET], of.link_quat[:, FEET], of.height_m)


def test_a_foot_goes_from_the_stance_before_to_the_one_after() -> None:
    stands = np.array([0, 1, 1, 1, 0, 0, 0, 1, 1, 1, 0], bool)
    middle = np.zeros((11, 2))
    middle[7:, 0] = 0.6
    before, after, first, last, swings, stays = steps_of_foot(stands, middle)
    assert before.tolist() == [2] * 7 + [8] * 4
    assert after.tolist() == [2] * 4 + [8] * 7
    assert swings.tolist() == [0, 0, 0, 0, 1, 1, 1, 0, 0, 0, 0]
    assert set(first[4:7]) == {3} and set(last[4:7]) == {7}
    assert not stays.any()


def test_a_foot_that_slides_as_it_stands_goes_from_place_to_place() -> None:
    middle = np.stack([np.linspace(0.0, 0.3, 31), np.zeros(31)], -1)
    before, after, first, last, swings, _ = steps_of_foot(np.ones(31, bool), middle).astype(int)
    assert not swings.any() and len(set(before)) >= 3
    moving = before != after
    assert (middle[after[moving], 0] - middle[before[moving], 0]).max() < 0.11
    rows = np.arange(31)[moving]
    assert ((first[moving] < rows) & (rows <= last[moving])).all()


def test_feet_of_a_standing_person_stay_and_those_of_a_walking_one_do_not() -> None:
    walking = load_motions("synthetic:walk")[3]
    steps = footsteps_of([c.scaled(1.75) for c in (STANDING, walking, gliding_clip())])
    end = len(STANDING)
    assert (steps.stays[:end] == 1.0).all() and (steps.before[:end] == steps.after[:end]).all()
    assert (steps.stays[end : end + len(walking)] == 0.0).all()
    inside = slice(end + 20, end + len(walking) - 20)
    assert 0.2 < steps.swings[inside].mean() < 0.6
    rows = np.arange(end + len(walking), len(steps.before))  # it glides: never on one place
    np.testing.assert_array_equal(steps.before[rows], np.stack([rows, rows], -1))
    np.testing.assert_array_equal(steps.after[rows], steps.before[rows])
    for part in (steps.before, steps.after):
        assert (part[end : end + len(walking)] >= end).all()


@pytest.mark.parametrize("amplitude", [0.04, 0.08])
def test_feet_swing_over_the_ground_and_no_faster_than_they_must(amplitude: float) -> None:
    walking = load_motions("synthetic:walk")[3]
    field = height_field(Terrain("rough", amplitude_m=amplitude))
    place = np.array([1.0, 2.0, 1.0, 0.0])
    footed = footed_clip(walking, place, field)
    above = soles(footed)
    above = above[..., 2] - field.height_at(above)
    assert np.percentile(above.min(axis=-1), 5) > -0.012
    speed = np.diff(footed.link_position[:, FEET], axis=0) * FPS
    level = np.diff(walking.link_position[:, FEET], axis=0) * FPS
    assert np.abs(speed[..., 2]).max() < np.abs(level[..., 2]).max() + 2.0
    told = footed.link_velocity[1:-1][:, FEET, 2]
    central = 0.5 * (speed[1:, :, 2] + speed[:-1, :, 2])
    assert np.abs(told - central).mean() < 0.1


def test_a_footed_clip_keeps_the_bodys_lengths_and_its_upper_body() -> None:
    clip = gliding_clip()
    field = HeightField.of(np.fromfunction(lambda row, column: 0.1 * column, (30, 30)), 0.5)
    place = np.array([0.5, -0.3, np.cos(0.4), np.sin(0.4)])
    footed = footed_clip(clip, place, field)
    again = clip_from_qpos("again", footed.qpos, clip.height_m)
    np.testing.assert_allclose(again.link_position, footed.link_position, atol=1e-9)
    upper = DOFS.index("spine_y")
    np.testing.assert_allclose(footed.qpos[:, 7 + upper :], clip.qpos[:, 7 + upper :])
    moved = np.diff(footed.link_position[:, LINKS.index("head")], axis=0) * FPS
    np.testing.assert_allclose(
        footed.link_velocity[1:-1, LINKS.index("head")], moved[:-1], atol=0.05
    )


@pytest.mark.parametrize("amplitude", [0.04, 0.08])
def test_feet_that_stand_in_a_clip_stand_on_the_ground_in_the_world(amplitude: float) -> None:
    clip = CLIPS[0]
    field = height_field(Terrain("rough", amplitude_m=amplitude))
    standing = soles(clip)[..., 2].min(axis=-1) < 0.01
    assert standing.mean() > 0.3
    for place in ((2.0, 1.0), (-3.0, 4.0), (0.3, -7.0)):
        footed = soles(footed_clip(clip, np.array([*place, np.cos(1.0), np.sin(1.0)]), field))
        above = (footed[..., 2] - field.height_at(footed)).min(axis=-1)
        assert np.abs(above[standing]).max() < 0.015


def test_on_level_ground_a_footed_clip_is_the_clip() -> None:
    field = HeightField.of(np.full((20, 20), 0.3), 0.5)
    footed = footed_clip(CLIPS[0], np.array([0.0, 0.0, 1.0, 0.0]), field)
    np.testing.assert_allclose(footed.qpos[:, 7:], CLIPS[0].qpos[:, 7:], atol=1e-6)
    lifted = CLIPS[0].link_position + np.array([0.0, 0.0, 0.3])
    np.testing.assert_allclose(footed.link_position, lifted, atol=1e-6)


def test_a_foot_stands_on_a_slope_as_on_a_plane() -> None:
    """With capsules alone soles sank in by a centimetre, and feet crept."""
    terrain = Terrain("slope", direction="across")
    config = EnvConfig(fixed_start=True, privileged=True, terrain=terrain)
    clip = next(clip for clip in load_motions("synthetic:stand"))
    sim = BatchSim([clip], config)
    sim.reset()
    gain = 4.0 * sim.body.damping / 0.08 / sim.body.torque_limits
    columns = sim.layout["midway_joint_angles"]
    for _ in range(15):
        sim.step(gain * (sim.observation[:, columns] - sim.joint_angles))
        assert sim.foot_clearance.min() > -0.006
