"""Device frames and the conventions of other programs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from questsim import rotations as rot
from questsim.devices import CONVENTIONS, DeviceFrame, from_ours
from questsim.errors import InputError

HALF = np.sqrt(0.5)
# A headset 2 m ahead, 1 m to the left and 1.6 m up, turned 90 degrees to the left, as each
# program reports it.
LEFT_TURN = {
    "questsim": [2.0, 1.0, 1.6, HALF, 0.0, 0.0, HALF],
    "openxr": [-1.0, 1.6, -2.0, 0.0, HALF, 0.0, HALF],
    "steamvr": [-1.0, 1.6, -2.0, 0.0, HALF, 0.0, HALF],
    "unity": [-1.0, 1.6, 2.0, 0.0, -HALF, 0.0, HALF],
    "unreal": [200.0, -100.0, 160.0, 0.0, 0.0, -HALF, HALF],
}


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_a_known_pose_is_the_same_from_every_convention(convention):
    frame = DeviceFrame.of(0.0, {"headset": LEFT_TURN[convention]}, convention)
    pose = frame.poses["headset"]
    np.testing.assert_allclose(pose.position, [2.0, 1.0, 1.6], atol=1e-12)
    np.testing.assert_allclose(
        rot.quat_rotate(pose.quat, np.array([1.0, 0, 0])), [0, 1, 0], atol=1e-12
    )
    np.testing.assert_allclose(
        rot.quat_rotate(pose.quat, np.array([0, 0, 1.0])), [0, 0, 1], atol=1e-12
    )


def test_a_matrix_of_steamvr_is_the_pose_that_its_quaternion_is():
    # Looking left in OpenVR: local -z, forward, is world -x.
    matrix = np.array([[0.0, 0.0, 1.0, -1.0], [0.0, 1.0, 0.0, 1.6], [-1.0, 0.0, 0.0, -2.0]])
    one = DeviceFrame.of(0.0, {"headset": matrix}, "steamvr").poses["headset"]
    other = DeviceFrame.of(0.0, {"headset": LEFT_TURN["steamvr"]}, "steamvr").poses["headset"]
    np.testing.assert_allclose(one.position, other.position, atol=1e-12)
    assert rot.angle_between(one.quat, other.quat) < 1e-6


@given(
    st.sampled_from(sorted(CONVENTIONS)),
    st.lists(st.floats(-5, 5), min_size=3, max_size=3),
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
)
def test_poses_come_back_from_every_convention(convention, position, quat):
    unit = np.array(quat) / np.linalg.norm(quat)
    there = np.concatenate(from_ours(np.array(position), unit, convention))
    back = DeviceFrame.of(0.0, {"headset": there}, convention).poses["headset"]
    np.testing.assert_allclose(back.position, position, atol=1e-9)
    assert rot.angle_between(back.quat, unit) < 1e-6


@pytest.mark.parametrize(
    ("poses", "says"),
    [
        ({"headset": [0, 0, np.nan, 1, 0, 0, 0]}, "not finite"),
        ({"headset": [0, 0, 1, 2, 0, 0, 0]}, "length 2"),
        ({"headset": [0, 0, 1, 1e300, 0, 0, 0]}, "above 1e\\+09"),
        ({"hat": [0, 0, 1, 1, 0, 0, 0]}, "unknown device 'hat'"),
        ({"headset": [0, 0, 1]}, "shape"),
        ({"headset": [0, 0, 1e9, 1, 0, 0, 0]}, "further than"),
        ({"headset": np.diag([1.0, 1.0, -1.0, 1.0])}, "not a rotation"),
        ({"headset": "standing"}, "not made of numbers"),
    ],
)
def test_an_invalid_pose_is_refused_with_its_devices_name(poses, says):
    with pytest.raises(InputError, match=says):
        DeviceFrame.of(0.0, poses)


def test_a_device_that_does_not_report_is_left_out():
    frame = DeviceFrame.of(1.5, {"headset": LEFT_TURN["questsim"], "left_controller": None})
    assert list(frame.poses) == ["headset"] and frame.time_s == 1.5
