"""Seated clips, and the chair that they need."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import mujoco
import numpy as np
import pytest

from agents.evaluation.follow import evaluation_sim, follow
from agents.evaluation.rollout import env_config
from agents.policy.checkpoint import find_policy, load_policy
from envs import BatchSim, EnvConfig, Terrain, WorldObject
from envs.objects import objects_named
from envs.options import config_from
from envs.world import build_world
from questsim.body import build_body
from questsim.errors import InputError
from questsim.motion.clip import Clip
from questsim.motion.kinematics import link_poses, sole_positions
from questsim.motion.spec import load_motions
from questsim.motion.synthesis.pose import link_centers
from questsim.motion.synthesis.synthetic import KINDS, seated_clips, synthesise
from questsim.skeleton import FOOT_LINKS

CLIPS = seated_clips()
CHAIR = (WorldObject("chair"),)


def from_chair(sim: BatchSim, i: int, clip: Clip) -> np.ndarray:
    """Least distance in metres of the placed clip from its chair, in each frame."""
    model = build_world(float(sim.heights[i]), terrain=sim.config.terrain, objects=CHAIR).model
    data = mujoco.MjData(model)
    owner = model.geom_bodyid
    chair = np.flatnonzero(owner == model.body("object0").id)
    avatar = np.flatnonzero((owner >= 1) & (owner <= 16))
    data.qpos[40:] = sim.objects.pose[i, 0]
    least, points = [], np.zeros(6)
    for pose in sim.placed_clip(i, clip).qpos[::3]:
        data.qpos[:40] = pose
        mujoco.mj_kinematics(model, data)
        least.append(
            min(
                mujoco.mj_geomDistance(model, data, a, c, 0.5, points)
                for a in avatar
                for c in chair
            )
        )
    return np.array(least)


@pytest.mark.parametrize("height", [1.4, 1.75, 2.0])
def test_the_seat_touches_and_nothing_goes_into_the_chair(height: float) -> None:
    clips = CLIPS[:2]
    config = EnvConfig(fixed_start=True, objects=CHAIR, heights=(height, height))
    sim = BatchSim(clips, config)
    sim.reset()
    for i, clip in enumerate(clips):
        distance = from_chair(sim, i, clip)
        assert distance.min() > 0.0
        sitting = clip.qpos[::3, 2] < clip.qpos[:, 2].min() + 1e-3
        assert sitting.sum() > 20
        assert distance[sitting].max() < 0.006
        assert distance[0] > 0.03 and distance[-1] > 0.03


def test_the_mass_is_over_the_feet_until_the_seat_bears_it() -> None:
    for clip in CLIPS:
        centers, share = link_centers(clip.qpos)
        mass = np.einsum("l,tlk->tk", share, centers)[:, 0]
        feet = list(FOOT_LINKS)
        soles = sole_positions(clip.link_position[:, feet], clip.link_quat[:, feet], 1.75)
        assert np.ptp(soles, axis=0).max() < 1e-6  # the feet stay where they are
        back, front = soles[0, ..., 0].min(), soles[0, ..., 0].max()
        standing = clip.qpos[:, 2] > clip.qpos[:, 2].min() + 5e-3
        assert standing.sum() > 100
        assert mass[standing].min() > back + 0.02 and mass[standing].max() < front - 0.02
        assert mass[~standing].min() < back  # sitting up, nobody could do it without a seat


def test_seated_clips_stay_within_the_joints_limits_and_differ() -> None:
    limits = build_body().model.jnt_range[1:34]
    for clip in CLIPS:
        angles = clip.qpos[:, 7:]
        assert (angles > limits[:, 0]).all() and (angles < limits[:, 1]).all()
        position, _ = link_poses(clip.qpos, 1.75)
        np.testing.assert_allclose(position, clip.link_position, atol=1e-6)
    assert np.abs(CLIPS[0].qpos - CLIPS[1].qpos).max() > 0.05
    np.testing.assert_array_equal(seated_clips()[1].qpos, CLIPS[1].qpos)


def test_hands_move_a_little_in_seated_clips() -> None:
    for clip in CLIPS:
        sitting = clip.qpos[:, 2] < clip.qpos[:, 2].min() + 1e-3
        hands = clip.link_position[sitting][:, [12, 15]]
        assert 0.03 < np.ptp(hands, axis=0).max() < 0.6


def test_seated_clips_come_only_if_asked_for() -> None:
    assert "sit" not in KINDS
    plain = load_motions("synthetic")
    assert len(plain) == 54 and not any(clip.kind == "sit" for clip in plain)
    assert [clip.name for clip in load_motions("synthetic:sit")] == [c.name for c in CLIPS]
    both = load_motions("synthetic:stand+sit")
    assert [clip.kind for clip in both] == ["stand"] * 3 + ["sit"] * 4


def test_a_seated_clip_is_made_of_any_height_and_length_but_too_short_ones() -> None:
    clip = synthesise("sit", duration=12.0, height_m=1.5, seed=3)
    assert clip.kind == "sit" and len(clip) == 433
    assert clip.qpos[:, 2].min() == pytest.approx(0.534 * 1.5 / 1.75, abs=2e-3)
    with pytest.raises(InputError, match="duration 4 s"):
        synthesise("sit", duration=4.0)
    with pytest.raises(InputError, match="begins and ends standing"):
        synthesise("sit", start=True, duration=8.0)


def test_an_avatar_that_follows_a_seated_clip_by_springs_is_carried_by_the_chair() -> None:
    """Without the chair nobody could hold the pose: the mass is behind the feet."""
    heights = []
    for objects in (CHAIR, ()):
        sim = BatchSim(CLIPS[:1], EnvConfig(privileged=True, objects=objects), num_envs=1)
        sim.reset(clip=0, frame=150)
        gain = 4.0 * sim.body.damping / 0.08 / sim.body.torque_limits
        columns = sim.layout["reference_joint_angles"]
        forces = []
        for _ in range(36):
            sim.step(gain * (sim.observation[:, columns] - sim.observation[:, :33]))
            if objects:
                forces.append(sim.objects.force[0, 0, 2])
        heights.append(sim.qpos[0, 2])
        if objects:
            weight = 9.81 * build_body().model.body_mass[1:17].sum()
            assert -1.1 * weight < np.mean(forces[12:]) < -0.4 * weight
    assert heights[0] == pytest.approx(CLIPS[0].qpos[150, 2], abs=0.03)
    assert heights[1] < heights[0] - 0.1


def test_the_tracker_sits_down_on_a_chair_and_stands_up_again() -> None:
    tracker = load_policy(find_policy("tracker"))
    sim = evaluation_sim(CLIPS[:2], replace(env_config(tracker), objects=CHAIR))
    tracker.bind(sim)
    followed = follow(tracker, sim, CLIPS[:2])
    assert not followed.fell.any()
    assert sim.qpos[:, 2].min() > 0.8  # they end upright


def test_a_chair_stands_elsewhere_for_clips_that_do_not_sit() -> None:
    clips = [CLIPS[0], *load_motions("synthetic:stand")[:1]]
    sim = BatchSim(clips, EnvConfig(fixed_start=True, objects=CHAIR, terrain=Terrain("flat")))
    sim.reset()
    apart = np.linalg.norm(sim.objects.pose[:, 0, :2] - sim.qpos[:, :2], axis=-1)
    assert 0.3 < apart[0] < 0.5 and apart[1] >= 0.55 - 1e-6


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("stool", "unknown object 'stool'"),
        ("ball:kg=1", "'kg=1' is not an option of an object here"),
        ("ball:mass_kg=1..2", "'1..2' is no value"),
        ("ball:ahead_s=1..2..3", "'1..2..3' is no value"),
        ("ball:ahead_s=3..1", "ahead_s"),
        ("ball:mass_kg=nan", "mass_kg"),
    ],
)
def test_an_invalid_object_is_refused(text: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        objects_named([text])


def test_objects_can_be_given_by_name() -> None:
    assert objects_named(["ball:mass_kg=1,ahead_s=2", "chair:aside_m=-1..3"]) == (
        WorldObject("ball", ahead_s=(2.0, 2.0), mass_kg=1.0),
        WorldObject("chair", aside_m=(-1.0, 3.0)),
    )
    assert config_from({"objects": ("chair", WorldObject("ball"))}).objects == (
        WorldObject("chair"), WorldObject("ball"),
    )  # fmt: skip
    env = gym.make("QuestSim-v0", motions="synthetic:sit", objects=("chair",))
    env.reset(seed=0, options={"clip": 0, "frame": 0})
    _, _, _, _, info = env.step(env.action_space.sample())
    assert info["object_pose"].shape == (1, 7)
    env.close()
