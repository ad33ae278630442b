"""Devices on the 22 joints, and people of other proportions."""

import numpy as np
import pytest

from questsim.errors import InputError
from questsim.joint_sensors import joint_poses, mount, readings
from questsim.motion.checks import stature_of
from questsim.motion.retarget_back import to_motion
from questsim.proportions import (
    BONES,
    NUM_BONES,
    bone_lengths,
    measurements,
    random_scales,
    resized,
)
from questsim.sensors import DEVICES, device_poses
from questsim.skeleton import JOINTS
from tests.helpers import swaying_clip

CLIP = swaying_clip()
MOTION = to_motion(CLIP)


def test_devices_are_where_the_avatar_wears_them():
    got = readings(MOTION, list(DEVICES))
    position, quat = device_poses(
        CLIP.link_position, CLIP.link_quat, list(DEVICES), stature_of(MOTION.offsets)
    )
    assert np.abs(got.position - position).max() < 1e-3
    assert np.allclose(np.abs((got.quat * quat).sum(-1)), 1.0)


def test_joint_poses_undo_the_mounting():
    names = ["headset", "left_controller", "pelvis_tracker", "right_toe_tracker"]
    seen = readings(MOTION, names)
    mounts = [mount(name, MOTION.offsets) for name in names]
    position, quat = joint_poses(seen.position, seen.quat, mounts)
    want, turned = MOTION.forward_kinematics()
    at = [JOINTS.index(j) for j in ("head", "left_wrist", "root", "right_ankle")]
    assert np.allclose(position, want[:, at])
    assert np.allclose(np.abs((quat * turned[:, at]).sum(-1)), 1.0)


def test_an_unknown_tracker_is_refused_by_name():
    with pytest.raises(InputError, match="unknown tracker 'left_ear'"):
        readings(MOTION, ["left_ear"])


def test_resizing_scales_each_bone_group_and_keeps_the_feet_on_the_floor():
    scales = np.ones(NUM_BONES)
    names = [name for name, _ in BONES]
    scales[names.index("left forearm")] = 1.3
    scales[[i for i, name in enumerate(names) if "thigh" in name or "shin" in name]] = 1.1
    other = resized(MOTION, scales)
    assert np.allclose(bone_lengths(other.offsets), bone_lengths(MOTION.offsets) * scales)
    ankles = [JOINTS.index("left_ankle"), JOINTS.index("right_ankle")]
    before = MOTION.forward_kinematics()[0][:, ankles, 2].min()
    after = other.forward_kinematics()[0][:, ankles, 2].min()
    assert after == pytest.approx(1.1 * before)


def test_arms_legs_and_trunk_vary_independently():
    log = np.log(random_scales(np.random.default_rng(0), 4000))
    names = [name for name, _ in BONES]
    apart = [names.index(n) for n in ("hip width", "left thigh", "neck", "left forearm")]
    between = np.corrcoef(log[:, apart].T) - np.eye(4)
    assert np.abs(between).max() < 0.06
    sides = np.corrcoef(log[:, names.index("left shin")], log[:, names.index("right shin")])
    assert sides[0, 1] > 0.95


def test_measurements_are_stature_and_limbs():
    told = measurements(MOTION.offsets)
    assert told[0] == pytest.approx(stature_of(MOTION.offsets))
    knee = np.linalg.norm(MOTION.offsets[JOINTS.index("left_knee")])
    assert told[1] == pytest.approx(knee)
