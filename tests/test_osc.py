"""OSC: every message that is sent, on a pose whose numbers are known; and what is taken in."""

import time
from dataclasses import replace

import numpy as np
import pytest
from pythonosc.osc_bundle_builder import OscBundleBuilder
from pythonosc.osc_message_builder import OscMessageBuilder
from pythonosc.udp_client import SimpleUDPClient

from questsim import rotations as rot
from questsim.avatar_pose import AvatarPose
from questsim.errors import InputError
from questsim.osc.receiver import VmcReceiver
from questsim.osc.senders import Destination, VmcPerformer, VrchatTrackers, unity_euler
from questsim.skeleton import LINKS
from tests.osc_ends import listening, pose_of, wait_for


def sent(sender_class, pose: AvatarPose, count: int) -> list[tuple]:
    with listening() as (port, got):
        sender_class(Destination("127.0.0.1", port)).send(pose)
        wait_for(lambda: len(got) >= count)
        time.sleep(0.05)
    assert len(got) == count
    return got


def test_performer_sends_state_time_root_and_every_bone():
    got = sent(VmcPerformer, pose_of(), 19)
    assert got[0] == ("/VMC/Ext/OK", 1)
    assert got[1] == ("/VMC/Ext/T", 1.5)
    assert got[2] == ("/VMC/Ext/Root/Pos", "root", 0, 0, 0, 0, 0, 0, 1)
    bones = {message[1] for message in got[3:]}
    assert {message[0] for message in got[3:]} == {"/VMC/Ext/Bone/Pos"}
    assert bones == {
        "Hips", "Spine", "Chest", "Neck",
        *(f"{side}{part}" for side in ("Left", "Right") for part in
          ("UpperLeg", "LowerLeg", "Foot", "UpperArm", "LowerArm", "Hand")),
    }  # fmt: skip
    assert all(len(m) == 9 and all(np.isfinite(m[2:])) for m in got[3:])


def test_performers_axes_are_left_handed_y_up_z_forward():
    # Two metres ahead, turned 90 degrees to the left: +2 along z, -90 degrees about y in Unity.
    pose = pose_of(turn_deg=90.0, x=2.0)
    bones = {m[1]: np.array(m[2:]) for m in sent(VmcPerformer, pose, 19)[3:]}
    half = np.sqrt(0.5)
    hips = bones["Hips"]
    assert hips[:3] == pytest.approx([0.0, pose.root_position[2], 2.0], abs=1e-5)
    assert hips[3:] == pytest.approx([0.0, -half, 0.0, half], abs=1e-5)
    # Local to the parent: the left hip is 8.5 cm to the left, -x in Unity, whatever the heading.
    assert bones["LeftUpperLeg"] == pytest.approx([-0.085, 0, 0, 0, 0, 0, 1], abs=1e-4)


def test_hanging_arms_are_turned_down_from_unitys_t_pose():
    bones = {m[1]: np.array(m[2:]) for m in sent(VmcPerformer, pose_of(), 19)[3:]}
    half = np.sqrt(0.5)
    # A left arm along -x that turns by +90 degrees about z (x to y) points to -y: down.
    assert bones["LeftUpperArm"][3:] == pytest.approx([0, 0, half, half], abs=1e-5)
    assert bones["RightUpperArm"][3:] == pytest.approx([0, 0, -half, half], abs=1e-5)
    # In the T-pose the forearm begins along the upper arm: to the left, -x.
    lower = bones["LeftLowerArm"]
    assert lower[0] < -0.25 and abs(lower[1:3]).max() < 0.02
    assert lower[3:] == pytest.approx([0, 0, 0, 1], abs=1e-5)


def test_bent_knee_turns_about_unitys_x_axis():
    # A shin that swings back turns about +x in Unity: y (up) to z (forward), -y to -z.
    bones = {m[1]: np.array(m[2:]) for m in sent(VmcPerformer, pose_of(left_knee_y=60.0), 19)[3:]}
    assert bones["LeftLowerLeg"][3:] == pytest.approx([0.5, 0, 0, np.sqrt(0.75)], abs=1e-5)


def test_vrchat_gets_seven_trackers_and_the_head():
    pose = pose_of(turn_deg=90.0, x=2.0)
    got = {m[0]: np.array(m[1:]) for m in sent(VrchatTrackers, pose, 16)}
    for name in ("1", "2", "3", "4", "5", "6", "7", "head"):
        place = got[f"/tracking/trackers/{name}/position"]
        assert place.shape == got[f"/tracking/trackers/{name}/rotation"].shape == (3,)
    assert got["/tracking/trackers/1/position"] == pytest.approx(
        [0.0, pose.root_position[2], 2.0], abs=1e-5
    )
    assert got["/tracking/trackers/1/rotation"] == pytest.approx([0.0, -90.0, 0.0], abs=1e-3)
    left, right = pose.link_position[[LINKS.index("left_foot"), LINKS.index("right_foot")]]
    # Who looks to the left (-x in Unity) has the left foot at smaller z.
    assert got["/tracking/trackers/2/position"] == pytest.approx(
        [-left[1], left[2], left[0]], abs=1e-5
    )
    assert got["/tracking/trackers/2/position"][2] < 2.0 < right[0]


def test_euler_angles_turn_about_z_then_x_then_y():
    def about(axis: int, degrees: float) -> np.ndarray:
        quat = np.zeros(4)
        quat[0], quat[1 + axis] = np.cos(np.radians(degrees) / 2), np.sin(np.radians(degrees) / 2)
        return quat

    # Unity's documentation: Euler(x, y, z) is z, then x, then y, so the product is y * x * z.
    quat = rot.quat_multiply(about(1, 50.0), rot.quat_multiply(about(0, 20.0), about(2, -30.0)))
    assert unity_euler(quat[[1, 2, 3, 0]]) == pytest.approx([20.0, 50.0, -30.0])


def test_osc_without_a_receiver_does_not_disturb():
    sender = VmcPerformer(Destination("127.0.0.1", 9))
    for _ in range(5):
        sender.send(pose_of())


@pytest.mark.parametrize("text", ["host.invalid:9000", "127.0.0.1:0", "127.0.0.1:x", "224.0.0.1"])
def test_a_target_that_is_not_an_address_is_refused(text):
    with pytest.raises(InputError, match="--vmc"):
        Destination.of(text, 39539, "--vmc")


def test_the_default_target_is_this_machine():
    assert Destination.of("", 39539, "--vmc") == Destination("127.0.0.1", 39539)
    assert Destination.of(":9001", 39539, "--vmc") == Destination("127.0.0.1", 9001)


def test_devices_of_another_program_become_frames_in_our_axes():
    frames = []
    with VmcReceiver(frames.append, port=0, roles={"LHR-7": "left_foot_tracker"}) as receiver:
        client = SimpleUDPClient("127.0.0.1", receiver.port)
        upright = [0.0, 0.0, 0.0, 1.0]
        client.send_message("/VMC/Ext/Con/Pos", ["Left Controller", -0.3, 1.0, 0.2, *upright])
        client.send_message("/VMC/Ext/Tra/Pos", ["LHR-7", -0.1, 0.1, 0.0, *upright])
        client.send_message("/VMC/Ext/Tra/Pos", ["LHR-8", -0.1, 0.1, 0.0, *upright])
        half = float(np.sqrt(0.5))
        client.send_message("/VMC/Ext/Hmd/Pos", ["head", 0.5, 1.7, 2.0, 0.0, half, 0.0, half])
        wait_for(lambda: len(frames) == 1)
    (frame,) = frames
    assert set(frame.poses) == {"headset", "left_controller", "left_foot_tracker"}
    assert frame.poses["headset"].position == pytest.approx([2.0, -0.5, 1.7])
    # 90 degrees about y in a left-handed frame turn to the right: -90 degrees of ours about z.
    assert rot.heading(frame.poses["headset"].quat) == pytest.approx(-np.pi / 2)
    assert frame.poses["left_controller"].position == pytest.approx([0.2, 0.3, 1.0])
    assert receiver.refused == 1


def test_rubbish_over_osc_is_counted_and_the_receiver_goes_on():
    frames = []
    with VmcReceiver(frames.append, port=0) as receiver:
        client = SimpleUDPClient("127.0.0.1", receiver.port)
        client._sock.sendto(b"\x00\xffrubbish", ("127.0.0.1", receiver.port))
        client.send_message("/VMC/Ext/Hmd/Pos", ["head", float("nan"), 1.7, 0.0, 0, 0, 0, 1.0])
        client.send_message("/VMC/Ext/Hmd/Pos", ["head", 1.7, 0.0])
        client.send_message("/VMC/Ext/Hmd/Pos", ["head", 0.0, 1.7, 0.0, 0.0, 0.0, 0.0, 1.0])
        wait_for(lambda: len(frames) == 1)
    assert receiver.refused >= 2


def bundle(time_s: float, address: str, values: list) -> bytes:
    """A bundle of one message, to be taken at a Unix time."""
    message = OscMessageBuilder(address)
    for value in values:
        message.add_arg(value)
    builder = OscBundleBuilder(time_s)  # type: ignore[arg-type]
    builder.add_content(message.build())  # type: ignore[arg-type]
    return builder.build().dgram


@pytest.mark.parametrize(
    "datagram",
    [
        bundle(2.0e9, "/VMC/Ext/Con/Pos", ["left", 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        bundle(0.0, "/VMC/Ext/" + "*" * 3000 + "x/Pos", [1.0]),
        b"#bundle\x00" + 8 * b"\x00" + b"\xff\xff\xff\xff",
    ],
    ids=["of the year 2033", "with an address of stars", "of an impossible size"],
)
def test_a_bundle_does_not_keep_the_receiver_from_the_next_message(datagram):
    frames = []
    with VmcReceiver(frames.append, port=0) as receiver:
        client = SimpleUDPClient("127.0.0.1", receiver.port)
        client._sock.sendto(datagram, ("127.0.0.1", receiver.port))
        client.send_message("/VMC/Ext/Hmd/Pos", ["head", 0.0, 1.7, 0.0, 0.0, 0.0, 0.0, 1.0])
        wait_for(lambda: len(frames) == 1)


def test_pose_is_not_changed_by_sending_it():
    pose = pose_of()
    copy = replace(pose, link_quat=pose.link_quat.copy())
    VrchatTrackers(Destination("127.0.0.1", 9)).send(pose)
    assert np.array_equal(copy.link_quat, pose.link_quat)
