"""The live follower: agents of all kinds, calibration, and streams with faults of all kinds."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from agents.agent import ZeroAgent
from agents.follower import Calibration, Follower, calibrate
from agents.follower.bridge import Bridge
from agents.follower.moving import MovingUser
from agents.follower.stance import estimated_pose
from envs.objects import objects_named
from questsim import rotations as rot
from questsim.devices import DeviceFrame, DevicePose
from questsim.errors import InputError
from questsim.motion.clip import FPS
from questsim.motion.kinematics import link_poses, standing_clip
from questsim.motion.synthesis.synthetic import synthetic_clips
from questsim.sensors import SENSOR_SETS, device_poses
from questsim.skeleton import FOOT_LINKS, LINKS
from questsim.synthetic_user import STILL_S, SyntheticUser, stream

CLIPS = {clip.name: clip for clip in synthetic_clips()}
WALK = CLIPS["synthetic-walk-1.2-start-stop"]
USER = SyntheticUser(1.75)


def followed(follower, frames):
    """Poses of all frames; none of them may ever hold a number that is not finite."""
    poses = [follower.step(frame) for frame in frames]
    for pose in poses:
        assert np.isfinite(pose.qpos).all() and np.isfinite(pose.link_position).all()
        assert np.isfinite(pose.contact_force).all() and np.isfinite(pose.assist_force).all()
    return poses


def said(poses):
    """All that happened."""
    return [event for pose in poses for event in pose.events]


def link_errors(poses, span):
    """Mean distance of the links from a clip's, in metres, of the poses within it."""
    known = span.start_s + np.arange(len(span.clip)) / 36.0
    flat = span.clip.link_position.reshape(len(known), -1)
    errors = []
    for pose in poses:
        if span.start_s <= pose.time_s <= span.end_s:
            want = np.array([np.interp(pose.time_s, known, c) for c in flat.T]).reshape(-1, 3)
            errors.append(np.linalg.norm(pose.link_position - want, axis=-1).mean())
    return np.array(errors)


def shifted(frame, metres):
    """A frame whose devices are further to the left."""
    poses = {
        name: DevicePose(pose.position + np.array([0.0, metres, 0.0]), pose.quat)
        for name, pose in frame.poses.items()
    }
    return DeviceFrame(frame.time_s, poses)


def cut(frames, first_s, last_s):
    """The frames of a part of a stream."""
    return [frame for frame in frames if first_s <= frame.time_s < last_s]


@pytest.mark.parametrize(
    ("agent", "centimetres"),
    [("questsim", 9.0), ("questsim-now", 11.0)],
)
def test_an_avatar_follows_a_calibrated_user_without_ever_seeing_the_body(agent, centimetres):
    user = replace(USER, height_m=1.62)
    frames, (span,) = stream(user, [WALK], 72.0)
    follower = Follower(agent)
    follower.calibrate(cut(frames, 0.0, STILL_S))
    poses = followed(follower, cut(frames, STILL_S - 1.0, 99.0))
    # A policy without future frames often falls as the user stops within a step after the walk.
    assert said([pose for pose in poses if pose.time_s <= span.end_s]) == []
    errors = link_errors(poses, span)
    assert len(errors) > 400
    assert 100 * errors.mean() < centimetres
    assert poses[-1].time_s == pytest.approx(frames[-1].time_s - follower.latency_s, abs=0.03)


def test_a_kinematic_system_shows_its_poses_without_forces():
    follower = Follower("ik", "6T", height_m=1.75)
    trackers, (span,) = stream(replace(USER, devices="6T"), [WALK], 60.0)
    poses = followed(follower, cut(trackers, span.start_s - 0.5, span.start_s + 2.0))
    assert 100 * link_errors(poses, span).mean() < 6.0
    assert not any(pose.contact_force.any() for pose in poses)


def test_a_policy_of_the_whole_body_is_refused():
    with pytest.raises(InputError, match="whole body"):
        Follower("tracker")


def test_step_before_calibration_is_refused():
    with pytest.raises(InputError, match="stature is not known"):
        Follower("questsim").step(DeviceFrame(0.0, {}))


@pytest.fixture(scope="module")
def follower():
    """One avatar for the tests below; each begins a stream of its own."""
    return Follower("questsim", height_m=1.75)


@pytest.mark.parametrize("rate", [36.0, 72.0, 90.0, 120.0])
def test_the_rate_of_the_frames_hardly_matters(follower, rate):
    follower.reset()
    frames, (span,) = stream(
        USER, [CLIPS["synthetic-wave-1"]], rate, jitter_s=0.3 / rate, loss=0.01
    )
    poses = followed(follower, cut(frames, STILL_S, STILL_S + 4.0))
    assert said(poses) == []
    assert 100 * link_errors(poses, span).mean() < 6.0


def test_poses_are_of_the_moment_that_the_latency_says(follower):
    follower.reset()
    frames, _ = stream(USER, [], 90.0)
    poses = followed(follower, frames[:120])
    late = [f.time_s - p.time_s for f, p in zip(frames[40:120], poses[40:], strict=True)]
    np.testing.assert_allclose(late, follower.latency_s, atol=1e-6)


def test_late_and_repeated_frames_change_nothing(follower):
    frames, _ = stream(USER, [WALK], 72.0)
    frames = cut(frames, STILL_S, STILL_S + 2.0)
    follower.reset()
    plain = followed(follower, frames)
    follower.reset()
    disturbed = [other for i, f in enumerate(frames) for other in (f, frames[max(i - 3, 0)])]
    poses = followed(follower, disturbed)[::2]
    np.testing.assert_array_equal(plain[-1].qpos, poses[-1].qpos)


def test_two_seconds_without_a_headset_are_bridged_where_the_user_stays(follower):
    follower.reset()
    frames, _ = stream(USER, [CLIPS["synthetic-stand-1"]], 72.0)
    frames = cut(frames, STILL_S, STILL_S + 5.0)
    blind = [replace(f, poses={}) if STILL_S + 2 < f.time_s < STILL_S + 4 else f for f in frames]
    poses = followed(follower, blind)
    assert said(poses) == ["tracking is back after 2.0 s"]
    follower.reset()
    poses = followed(follower, [f for f in blind if f.poses])  # the same, without any frames
    assert said(poses) == ["tracking is back after 2.0 s"]


def test_a_user_who_comes_back_elsewhere_finds_the_avatar_there(follower):
    follower.reset()
    frames, _ = stream(USER, [CLIPS["synthetic-stand-1"]], 72.0)
    frames = cut(frames, STILL_S, STILL_S + 5.0)
    away = [f for f in frames if f.time_s < STILL_S + 1]
    back = [moved(f, [2.0, 0.0, 0.0]) for f in frames if f.time_s > STILL_S + 3]
    poses = followed(follower, away + back)
    assert said(poses) == ["tracking is back after 2.0 s: set up again"]
    assert abs(poses[-1].root_position[0] - poses[60].root_position[0] - 2.0) < 0.1


def moved(frame, shift, yaw=0.0):
    """The frame of a user who was put elsewhere."""
    turn = rot.yaw_quat(np.array(yaw))
    poses = {
        name: DevicePose(
            rot.quat_rotate(turn, pose.position) + np.array(shift),
            rot.quat_multiply(turn, pose.quat),
        )
        for name, pose in frame.poses.items()
    }
    return DeviceFrame(frame.time_s, poses)


def test_recentring_carries_the_avatar_along_unchanged(follower):
    frames, _ = stream(USER, [WALK], 72.0)
    frames = cut(frames, STILL_S, STILL_S + 4.0)
    follower.reset()
    plain = followed(follower, frames)
    follower.reset()
    jumped = [moved(f, [3.0, -1.0, 0.0], 1.2) if f.time_s > STILL_S + 2 else f for f in frames]
    poses = followed(follower, jumped)
    assert said(poses) == ["the headset jumped: the avatar is carried along"]
    # The last frame's avatar is that of the stream without a jump, but for the one frame between.
    want, turn = plain[-1], rot.yaw_quat(np.array(1.2))
    there = rot.quat_rotate(turn, want.link_position) + np.array([3.0, -1.0, 0.0])
    assert np.linalg.norm(poses[-1].link_position - there, axis=-1).mean() < 0.06


def test_a_sleeping_controller_sinks_to_the_side_and_comes_back_smoothly():
    frames, _ = stream(USER, [CLIPS["synthetic-raise-both-hands-1"]], 72.0)
    asleep = [
        replace(f, poses={k: v for k, v in f.poses.items() if k != "left_controller"})
        if STILL_S + 2.5 < f.time_s < STILL_S + 5.5
        else f
        for f in cut(frames, STILL_S, STILL_S + 7.0)
    ]
    bridge = Bridge(SENSOR_SETS["H+2C"], 72.0, 1.75)
    moments = [moment for frame in asleep for moment in bridge.push(frame)]
    hand = np.array([moment.position[1] for moment in moments])
    speed = np.linalg.norm(np.diff(hand, axis=0), axis=-1) * 72.0
    assert speed.max() < 4.5  # raising it takes 3 m/s
    times = np.array([moment.time_s for moment in moments])
    sunk = hand[(times > STILL_S + 4.5) & (times < STILL_S + 5.5), 2]
    assert (sunk < 0.9).all()
    assert hand[-1, 2] == pytest.approx(asleep[-1].poses["left_controller"].position[2], abs=0.02)


def test_headset_alone_lets_the_arms_hang(follower):
    follower.reset()
    frames, _ = stream(replace(USER, devices="H"), [CLIPS["synthetic-stand-1"]], 72.0)
    poses = followed(follower, cut(frames, STILL_S, STILL_S + 3.0))
    assert said(poses) == []
    hands = poses[-1].link_position[[LINKS.index("left_hand"), LINKS.index("right_hand")], 2]
    assert (hands < 1.0).all()


def test_an_avatar_that_fell_is_set_up_again_within_a_second():
    follower = Follower("zero", "H", height_m=1.75, objects=objects_named(["ball", "box"]))
    frames = [shifted(frame, 2.0 * frame.time_s) for frame in stream(USER, [], 72.0)[0]]
    poses = followed(follower, frames)
    # The objects are a metre before the user, who looks along x, and apart from each other.
    before = np.array([[1.0, -0.5], [1.0, 0.5]])
    away = poses[0].object_position[:, :2] - poses[0].root_position[:2]
    assert away == pytest.approx(before, abs=0.02)
    assert np.isfinite(poses[-1].object_position).all()
    falls = [pose.time_s for pose in poses if "the avatar fell: set up again" in pose.events]
    assert falls
    heads = np.array([pose.link_position[LINKS.index("head"), 2] for pose in poses])
    low = [pose.time_s for pose, z in zip(poses, heads, strict=True) if z < 0.9]
    assert max(np.diff([low[0], *falls]).max(), falls[0] - low[0]) < 3.0
    assert falls[0] - low[0] < 1.0
    # It is set up where the moving user was at that time, not a frame before.
    times = [frame.time_s for frame in frames]
    for pose in poses:
        if pose.time_s in falls:
            own, _ = device_poses(pose.link_position, pose.link_quat, ["headset"], 1.75)
            walked = [frame.poses["headset"].position[1] for frame in frames]
            assert own[0, 1] == pytest.approx(np.interp(pose.time_s, times, walked), abs=0.02)


def test_the_state_of_a_walking_user_is_estimated_and_that_of_a_standing_one_is_not():
    names, late = SENSOR_SETS["H+2C"], 5  # frames between the avatar's present and the newest one
    user, alone = MovingUser(names, 1.75, late / FPS), MovingUser(("headset",), 1.75, 0.0)
    at, turned = device_poses(WALK.link_position, WALK.link_quat, names, 1.75)
    begun = next(t for t in range(len(WALK)) if at[t, 0, 0] - at[0, 0, 0] > 0.5)
    for position, quat in zip(at[: begun + 40], turned[: begun + 40], strict=True):
        user.show(position, quat)
        alone.show(position[:1], quat[:1])
    state = user.state()
    assert state is not None
    qpos, qvel = state
    links, _ = link_poses(qpos[None], 1.75)
    truth = begun + 39 - late
    assert np.linalg.norm(links[0] - WALK.link_position[truth], axis=-1).mean() < 0.07
    assert qvel[:2] == pytest.approx(WALK.qvel[truth, :2], abs=0.15)
    assert np.linalg.norm(WALK.qvel[truth, :2]) > 0.8
    assert alone.state() is None  # the estimator needs the controllers
    for _ in range(18):
        user.show(at[0], turned[0])
    assert user.state() is None


@pytest.mark.parametrize("agent", ["zero", "hmdposer+physics"])
def test_an_avatar_that_fell_while_its_user_walks_is_set_up_in_the_pose_of_the_walk(
    agent, monkeypatch
):
    monkeypatch.setattr("agents.follower.follower.load_agent", lambda _: ZeroAgent())
    follower = Follower(agent, height_m=1.75)
    frames, (span,) = stream(USER, [WALK], 72.0)
    poses = followed(follower, cut(frames, span.start_s + 1.0, span.end_s - 1.5))
    falls = [pose for pose in poses if "the avatar fell: set up again" in pose.events]
    assert len(falls) >= 3
    left, right = FOOT_LINKS
    steps = []
    for pose in falls[1:]:  # before the first there is less than a second to estimate from
        user = span.clip.link_position[round((pose.time_s - span.start_s) * FPS)]
        steps.append(pose.link_position[left, 0] - pose.link_position[right, 0])
        assert steps[-1] == pytest.approx(user[left, 0] - user[right, 0], abs=0.15)
    # Not upright with one foot beside the other, but in the user's step.
    assert max(np.abs(steps)) > 0.3


def test_an_avatar_without_physics_is_not_assisted():
    with pytest.raises(InputError, match="without physics cannot be assisted"):
        Follower("ik", assist_n=100.0)


def test_the_same_stream_gives_the_same_bits(follower):
    frames, _ = stream(USER, [WALK], 90.0, jitter_s=0.004, loss=0.05)
    frames = cut(frames, STILL_S, STILL_S + 2.0)
    ends = []
    for _ in range(2):
        follower.reset()
        ends.append(followed(follower, frames)[-1].qpos)
    np.testing.assert_array_equal(*ends)


def test_the_estimated_pose_has_the_devices_where_they_are():
    names = SENSOR_SETS["H+2C"]
    clip = CLIPS["synthetic-squat-1"].scaled(1.6)
    frame = int(clip.qpos[:, 2].argmin())
    at, turned = device_poses(clip.link_position[frame], clip.link_quat[frame], names, 1.6)
    qpos = estimated_pose(names, at, turned, 1.6)
    got, _ = device_poses(*(x[0] for x in link_poses(qpos[None], 1.6)), names, 1.6)  # type: ignore
    assert np.linalg.norm(got - at, axis=-1).max() < 0.08


# -- calibration ---------------------------------------------------------------------------------


def people(count, arms_deg=1.0):
    """Users of all statures who hold controllers their own way, and nearly stand as they should."""
    rng = np.random.default_rng(5)
    for number in range(count):
        mounts = {
            f"{side}_controller": (rng.normal(0, 0.01, 3), rng.normal(0, 0.3, 3))
            for side in ("left", "right")
        }
        left, right = 8.0 + rng.normal(0.0, arms_deg, 2)
        yield SyntheticUser(
            height_m=rng.uniform(1.45, 1.95),
            eyes_m=rng.normal(0.0, 0.006),
            arms_deg=(left, right),
            arms_ahead_deg=tuple(rng.normal(0.0, arms_deg, 2)),
            mounts=mounts,  # type: ignore
            noise_m=0.002,
            noise_rad=0.01,
            seed=number,
        )


def test_stature_is_within_two_centimetres_and_mounts_within_one_and_a_half():
    statures, still_only, mounts = [], [], []
    for user in people(24):
        user = replace(user, palms_deg=45.0)
        frames, _ = stream(user, [], 72.0, jitter_s=0.003, loss=0.01)
        still, palms = cut(frames, 0.0, STILL_S), cut(frames, STILL_S, 99.0)
        found = calibrate(still, palms=palms)
        statures.append(abs(found.height_m - user.height_m))
        still_only += mount_errors(calibrate(still), user)
        mounts += mount_errors(found, user)
    assert max(statures) < 0.02
    assert np.mean(still_only) < 0.015
    assert max(mounts) < 0.015


def mount_errors(found, user):
    """Distance in metres of each controller's place in the hand from the true one."""
    return [
        np.linalg.norm(found.mounts[name].offset + Rotation.from_rotvec(turn).inv().apply(offset))
        for name, (offset, turn) in user.mounts.items()
    ]


def test_palms_that_hardly_turn_are_refused():
    frames, _ = stream(replace(USER, palms_deg=10.0), [])
    with pytest.raises(InputError, match="turned by"):
        calibrate(cut(frames, 0.0, STILL_S), palms=cut(frames, STILL_S, 99.0))


def test_a_calibrated_user_is_seen_as_the_avatar_carries_devices():
    user = replace(USER, mounts={"left_controller": ((0.02, 0.0, 0.01), (0.5, -0.3, 0.2))})
    frames, _ = stream(user, [])
    calibration = calibrate(frames)
    pose = calibration.apply(frames[50]).poses["left_controller"]
    plain, _ = stream(USER, [])
    want = plain[50].poses["left_controller"]
    assert np.linalg.norm(pose.position - want.position) < 0.03
    assert rot.angle_between(pose.quat, want.quat) < np.radians(4.0)


def test_the_floor_follows_from_a_given_stature():
    frames, _ = stream(USER, [])
    lifted = [moved(frame, [0.0, 0.0, -1.2]) for frame in frames]
    calibration = calibrate(lifted, height_m=1.75)
    assert calibration.floor_m == pytest.approx(-1.2, abs=0.02)
    follower = Follower("questsim-now")
    follower.use(calibration)
    assert follower.step(lifted[0]).root_position[2] == pytest.approx(0.93 - 1.2, abs=0.05)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"height_m": "tall"}, "height_m is missing or not a finite number"),
        ({"floor_m": 10**400}, "floor_m is missing or not a finite number"),
        ({"mounts": {"hat": {}}}, "'hat', which is not a device"),
        ({"mounts": {"headset": {"offset": [0, 0], "turn": [1, 0, 0, 0]}}}, "3 finite numbers"),
        ({"mounts": {"headset": {"offset": [0] * 3, "turn": [0] * 4}}}, "not a unit quaternion"),
    ],
)
def test_a_damaged_calibration_is_refused(change, says):
    whole = {"height_m": 1.7, "floor_m": 0.0, "heading_rad": 0.0, "mounts": {}}
    assert Calibration.of(whole) == Calibration(1.7)
    with pytest.raises(InputError, match=says):
        Calibration.of(whole | change)


def test_a_calibration_comes_back_from_its_file(tmp_path):
    frames, _ = stream(USER, [])
    calibration = calibrate(frames)
    calibration.save(tmp_path / "me.json")
    assert Calibration.load(tmp_path / "me.json") == calibration


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda frames: frames[:10], "fewer than"),
        (lambda frames: [moved(f, [0.3 * f.time_s, 0, 0]) for f in frames], "moved by"),
        (lambda frames: [moved(f, [0, 0, -0.8]) for f in frames], "stature"),
        (lambda frames: [swapped(f) for f in frames], "away from the arms"),
    ],
)
def test_a_failed_calibration_gives_the_reason(change, says):
    frames, _ = stream(USER, [])
    with pytest.raises(InputError, match=says):
        calibrate(change(frames))


def swapped(frame):
    """Controllers in the wrong hands."""
    left, right = frame.poses["left_controller"], frame.poses["right_controller"]
    return replace(
        frame, poses=dict(frame.poses) | {"left_controller": right, "right_controller": left}
    )


def test_standing_is_where_the_headset_is_in_every_heading():
    standing = standing_clip(1.8)
    names = SENSOR_SETS["H+2C"]
    at, turned = device_poses(standing.link_position[0], standing.link_quat[0], names, 1.8)
    for yaw in (0.0, 2.0, -2.5):
        turn = rot.yaw_quat(np.array(yaw))
        there = rot.quat_rotate(turn, at) + np.array([1.0, 2.0, 0.0])
        qpos = estimated_pose(names, there, rot.quat_multiply(turn, turned), 1.8)
        np.testing.assert_allclose(qpos[:2], [1.0, 2.0], atol=0.03)
        assert abs(rot.heading(qpos[3:7]) - yaw) < 0.05
