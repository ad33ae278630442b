"""Errors of poses, in cases that can be computed by hand."""

import numpy as np
import pytest

from questsim import rotations as rot
from questsim.motion.kinematics import clip_from_qpos
from questsim.motion.retarget_back import to_motion
from questsim.pose_metrics import (
    FEET,
    HANDS,
    HEAD,
    LOWER,
    UPPER,
    floating_cm,
    floor_penetration_cm,
    foot_skate_cm_s,
    jitter_100_m_s3,
    mpjre_components_deg,
    pose_samples,
    rot_local_deg,
)
from questsim.root_force import root_force
from questsim.skeleton import JOINTS, NUM_JOINTS
from tests.helpers import swaying_clip

MOTION = to_motion(swaying_clip())
POSITION, _ = MOTION.forward_kinematics()


def samples(position=POSITION, rotations=MOTION.rotations):
    return pose_samples(position, rotations, POSITION, MOTION.rotations, MOTION.fps)


def test_the_reference_itself_has_no_error():
    told = samples()
    for name in ("mpjpe_cm", "pos_cm", "rot_deg", "mpjre_deg", "ee_cm", "vel_cm_s", "world_cm"):
        assert told[name].max() == pytest.approx(0.0, abs=1e-5), name


def test_a_body_moved_as_a_whole_is_wrong_only_in_the_world():
    told = samples(POSITION + np.array([0.0, 0.03, 0.04]))
    assert told["world_cm"].mean() == pytest.approx(5.0)
    assert told["mpjpe_cm"].max() < 1e-9 and told["pos_cm"].max() < 1e-9


def test_a_moved_head_is_every_other_joints_error_by_head_and_its_own_by_root():
    position = POSITION.copy()
    position[:, HEAD] += [0.0, 0.0, 0.10]
    told = samples(position)
    assert told["mpjpe_cm"].mean() == pytest.approx(10.0 * (NUM_JOINTS - 1) / NUM_JOINTS)
    assert told["h_pe_cm"].mean() == pytest.approx(10.0)
    assert told["r_pe_cm"].mean() == pytest.approx(10.0)
    assert told["pos_cm"].mean() == pytest.approx(10.0 / NUM_JOINTS)
    assert told["ee_cm"].mean() == pytest.approx(2.0)


def test_upper_and_lower_body_share_out_all_joints():
    assert sorted((*UPPER, *LOWER)) == list(range(NUM_JOINTS))
    position = POSITION.copy()
    position[:, HANDS] += [0.05, 0.0, 0.0]
    told = samples(position)
    assert told["l_pe_cm"].max() < 1e-9
    assert told["u_pe_cm"].mean() == pytest.approx(5.0 * 2 / len(UPPER))


def test_mpjre_by_components_is_a_third_of_the_angle_about_one_axis():
    still = np.zeros((1, NUM_JOINTS, 4))
    still[..., 0] = 1.0
    turned = still.copy()
    turned[:, 1:] = rot.yaw_quat(np.radians(30.0))
    assert mpjre_components_deg(turned, still)[0] == pytest.approx(10.0)
    assert rot_local_deg(turned, still)[0] == pytest.approx(30.0 * 21 / 22)


def test_rot_counts_a_turned_spine_again_for_all_joints_above_it_and_root_is_the_roots_way():
    rotations = MOTION.rotations.copy()
    spine = JOINTS.index("spine1")
    rotations[:, spine] = rot.quat_multiply(rotations[:, spine], rot.yaw_quat(np.radians(22.0)))
    told = samples(POSITION + np.array([0.03, 0.04, 0.0]), rotations)
    assert told["rot_local_deg"] == pytest.approx(22.0 / NUM_JOINTS)
    above = 13  # spine, neck, head and both arms
    assert told["rot_deg"] == pytest.approx(22.0 * above / NUM_JOINTS)
    assert told["root_cm"] == pytest.approx(5.0)


def test_mpjre_takes_the_short_way_round_half_a_turn():
    a = np.tile(rot.yaw_quat(np.radians(179.0)), (1, NUM_JOINTS, 1))
    b = np.tile(rot.yaw_quat(np.radians(-179.0)), (1, NUM_JOINTS, 1))
    assert mpjre_components_deg(a, b)[0] == pytest.approx(2.0 / 3.0)


def test_velocity_and_jitter_of_a_cubic_path():
    time = np.arange(30) / 60.0
    path = np.zeros((30, NUM_JOINTS, 3))
    path[..., 0] = (time**3)[:, None]
    # The third derivative of t^3 is 6 m/s^3.
    assert jitter_100_m_s3(path, 60.0) == pytest.approx(0.06)
    drift = POSITION.copy()
    drift[:, HANDS] += (np.arange(len(drift)) / MOTION.fps)[:, None, None] * [0.2, 0.0, 0.0]
    assert samples(drift)["vel_cm_s"].mean() == pytest.approx(20.0 * 2 / NUM_JOINTS)


def test_skating_counts_only_feet_that_stand():
    still = np.repeat(POSITION[:1], 10, axis=0)
    slid = still + (np.arange(10) / 60.0)[:, None, None] * [0.3, 0.0, 0.0]
    assert foot_skate_cm_s(slid, still, 60.0) == pytest.approx(30.0)
    assert len(foot_skate_cm_s(slid + np.array([0.0, 0.0, 0.05]), still, 60.0)) == 0


def test_a_foot_that_the_user_swings_near_the_floor_does_not_skate():
    still = np.repeat(POSITION[:1], 10, axis=0)
    swung = still.copy()
    swung[:, FEET[2:], 0] += (np.arange(10) / 60.0 * 0.5)[:, None]  # the right foot, at 0.5 m/s
    told = foot_skate_cm_s(swung, swung, 60.0)
    assert len(told) == 9 * 2 and told.max() == pytest.approx(0.0)


def test_floating_is_the_height_of_feet_where_the_users_stand():
    still = np.repeat(POSITION[:1], 10, axis=0)
    assert floating_cm(still + np.array([0.0, 0.0, 0.03]), still, 60.0) == pytest.approx(3.0)
    assert floating_cm(still - np.array([0.0, 0.0, 0.03]), still, 60.0).max() == 0.0
    raised = still + (np.arange(10) / 10.0)[:, None, None] * [0.0, 0.0, 1.0]
    assert len(floating_cm(still, raised, 60.0)) < 9 * 4  # no longer planted


def test_penetration_is_the_depth_of_the_deepest_foot_joint():
    still = np.repeat(POSITION[:1], len(POSITION), axis=0)
    sunk = still.copy()
    sunk[:, FEET[1], 2] -= 0.04
    assert floor_penetration_cm(sunk, still) == pytest.approx(4.0)
    assert floor_penetration_cm(still + np.array([0.0, 0.0, 0.1]), still).max() == 0.0


def test_hovering_needs_a_root_force_of_one_body_weight_and_free_fall_none():
    clip = swaying_clip(frames=12)
    qpos = np.repeat(clip.qpos[:1], 12, axis=0)
    qpos[:, 2] += 1.0
    hovering = clip_from_qpos("hover", qpos, clip.height_m)
    assert root_force(hovering) == pytest.approx(1.0, abs=1e-6)
    qpos[:, 2] -= 0.99  # a centimetre above the floor, which may carry there
    nearly = clip_from_qpos("nearly", qpos, clip.height_m)
    assert root_force(nearly).max() < 0.3
    qpos[:, 2] += 0.99
    qpos[:, 2] += 3.0 - 0.5 * 9.81 * (np.arange(12) / 36.0) ** 2
    falling = clip_from_qpos("fall", qpos, clip.height_m)
    assert root_force(falling)[2:-2].max() < 0.02
