"""Recordings: our format, iwer's and CSV; the shipped one, replayed and scored."""

import gzip
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.follower import Follower
from agents.follower.replay import (
    ReplayArgs,
    ShowRecordingArgs,
    calibrated,
    moves_backwards,
    replay,
    replayed,
    show_recording,
)
from questsim import rotations as rot
from questsim.devices import CONVENTIONS, DeviceFrame, from_ours
from questsim.errors import InputError
from questsim.exporting import write_clip
from questsim.motion.clip import FPS
from questsim.motion.kinematics import clip_from_qpos
from questsim.motion.synthesis.synthetic import synthetic_clips
from questsim.recordings import DeviceRecording, read_recording, write_recording
from questsim.skeleton import FOOT_LINKS
from questsim.stream_metrics import stream_scores, track_of
from questsim.synthetic_user import SyntheticUser, example_frames, stream

FRAMES = stream(SyntheticUser(1.7), [], 72.0, jitter_s=0.002)[0][:100]
FRAMES[7].poses.pop("left_controller")  # type: ignore[attr-defined]


def same(a, b, metres=2e-5, radians=2e-4):
    """Whether two streams report the same poses at the same times."""
    assert len(a) == len(b)
    for one, other in zip(a, b, strict=True):
        assert one.time_s == pytest.approx(other.time_s, abs=1e-4)
        assert one.poses.keys() == other.poses.keys()
        for name, pose in one.poses.items():
            assert np.abs(pose.position - other.poses[name].position).max() < metres
            assert rot.angle_between(pose.quat, other.poses[name].quat) < radians
    return True


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_a_recording_comes_back_in_every_convention(tmp_path, convention):
    path = tmp_path / "me.jsonl.gz"
    write_recording(path, FRAMES, convention)
    assert same(read_recording(path).frames, FRAMES)


def test_the_same_frames_are_the_same_bytes(tmp_path):
    one, other = tmp_path / "a.jsonl.gz", tmp_path / "b.jsonl.gz"
    write_recording(one, FRAMES)
    write_recording(other, FRAMES)
    assert one.read_bytes() == other.read_bytes()


def test_a_recording_that_is_interrupted_leaves_no_file(tmp_path):
    def broken():
        yield FRAMES[0]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_recording(tmp_path / "me.jsonl.gz", broken())
    assert not list(tmp_path.iterdir())


def test_csv_of_unity_is_read_with_its_silent_devices(tmp_path):
    parts = ("x", "y", "z", "qx", "qy", "qz", "qw")
    devices = ("headset", "left_controller", "right_controller")
    lines = [",".join(["time_s", *(f"{d}_{p}" for d in devices for p in parts)])]
    for frame in FRAMES:
        cells = [f"{frame.time_s:.6f}"]
        for name in devices:
            pose = frame.poses.get(name)
            numbers = [""] * 7 if pose is None else np.concatenate(from_ours(*pose, "unity"))
            cells += [str(number) for number in numbers]
        lines.append(",".join(cells))
    path = tmp_path / "unity.csv"
    path.write_text("\n".join(lines))
    assert same(read_recording(path, "unity").frames, FRAMES)
    with pytest.raises(InputError, match="does not state its axes"):
        read_recording(path)


def iwer(frames):
    """What iwer's ActionRecorder logs: rays are somewhere else, poses rounded to 1e-3."""
    source = {"targetRayMode": "tracked-pointer", "hasGrip": True, "hasHand": False}
    sides = ("left", "right")
    lines = []
    for frame in frames:
        line = [round(1000 * frame.time_s, 1), *numbers(frame.poses["headset"])]
        for index, side in enumerate(sides):
            pose = frame.poses.get(f"{side}_controller")
            if pose is not None:
                line.append([index, *[0.0] * 6, 1.0, numbers(pose), [[0, 0, 0], 0.0]])
        lines.append(line)
    schema = [[i, source | {"handedness": side}] for i, side in enumerate(sides)]
    return {"schema": schema, "frames": lines}


def numbers(pose):
    return [round(x, 3) for x in np.concatenate(from_ours(*pose, "openxr")).tolist()]  # type: ignore


def test_a_recording_of_iwer_is_read_by_its_grips(tmp_path):
    path = tmp_path / "iwer.json"
    path.write_text(json.dumps(iwer(FRAMES)))
    assert same(read_recording(path).frames, FRAMES, 1e-3, 3e-3)


def test_axes_of_another_hand_are_noticed_by_steps_against_the_gaze():
    walk = next(clip for clip in synthetic_clips() if clip.name == "synthetic-walk-1.2-start-stop")
    frames, _ = stream(SyntheticUser(1.75), [walk], 72.0)

    def read_as(convention):
        numbers = [
            {n: np.concatenate(from_ours(*p, "unity")) for n, p in f.poses.items()} for f in frames
        ]
        return [
            DeviceFrame.of(f.time_s, each, convention)
            for f, each in zip(frames, numbers, strict=True)
        ]

    assert not moves_backwards(read_as("unity")) and moves_backwards(read_as("openxr"))
    assert not moves_backwards(FRAMES) and not moves_backwards([])  # who stands goes nowhere


def test_a_damaged_pose_of_iwer_is_refused(tmp_path):
    damaged = iwer(FRAMES)
    for value, says in (([1.0], "not made of"), (10**400, "not made of"), (1e300, "number above")):
        damaged["frames"][0][-1][8][3] = value
        (tmp_path / "iwer.json").write_text(json.dumps(damaged))
        with pytest.raises(InputError, match=f"iwer.json.*pose of .*_controller .*{says}"):
            read_recording(tmp_path / "iwer.json")


HEADER = {"format": "questsim-recording", "version": 1, "convention": "openxr"}
GOOD = {"t": 0.0, "headset": [0, 1.6, 0, 0, 0, 0, 1]}


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ([], "is empty"),
        ([HEADER | {"version": 9}, GOOD], "line 1: version is 9"),
        ([HEADER | {"format": "x"}, GOOD], "line 1: format is 'x'"),
        ([HEADER | {"convention": "blender"}, GOOD], "unknown convention 'blender'"),
        ([HEADER, GOOD, GOOD], "frame 2: time goes from"),
        ([HEADER, GOOD, {"headset": GOOD["headset"]}], "line 3: has no time t"),
        ([HEADER, GOOD | {"headset": [0, 1]}], "line 2: pose of headset has shape"),
        ([HEADER, GOOD | {"hat": GOOD["headset"]}], "line 2: unknown device 'hat'"),
        ([HEADER, {"t": 0.0}], "no frame has a headset"),
        ([HEADER, 5], "line 2: is not a JSON object"),
    ],
)
def test_a_file_that_is_not_a_recording_is_refused_with_its_line(tmp_path, lines, says):
    path = tmp_path / "bad.jsonl.gz"
    path.write_bytes(gzip.compress("\n".join(map(json.dumps, lines)).encode()))
    with pytest.raises(InputError, match=says):
        read_recording(path)


def test_a_recording_that_ends_too_early_is_refused(tmp_path):
    path = tmp_path / "cut.jsonl.gz"
    write_recording(path, FRAMES)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(InputError, match="is incomplete"):
        read_recording(path)


def test_the_shipped_recording_equals_a_new_one_of_its_script():
    assert same(read_recording(Path("synthetic")).frames, example_frames(), 2e-4, 1e-3)


def test_the_shipped_recording_is_followed_to_its_end():
    recording = read_recording(Path("synthetic"))
    assert 110.0 < recording.duration_s < 130.0
    follower = Follower("questsim")
    frames = calibrated(follower, recording)
    assert follower.calibration is not None
    assert follower.calibration.height_m == pytest.approx(1.68, abs=0.02)
    poses = replayed(follower, frames)
    known = [follower.calibration.apply(frame) for frame in frames]
    track = track_of(known, poses, follower.calibration.floor_m)
    scores = stream_scores(track)
    assert scores["seconds"] == pytest.approx(recording.duration_s - 3.0, abs=0.5)
    assert scores["falls"] <= 10  # 6 with the shipped policy  # type: ignore
    assert scores["mhpe_cm"] < 8.0  # type: ignore
    assert scores["assist_percent"] == 0.0


def test_scores_of_an_avatar_that_is_its_user_are_zero():
    # A kinematic stand-in: the avatar stands where its devices are, for two seconds.
    frames, _ = stream(
        SyntheticUser(1.75, arms_deg=(0.0, 0.0), noise_m=0.0, noise_rad=0.0), [], 36.0
    )
    follower = Follower("questsim-now", height_m=1.75)
    pose = follower.step(frames[0])
    still = [replace(frames[0], time_s=frame.time_s) for frame in frames]
    timed = [replace(pose, time_s=frame.time_s) for frame in frames]
    scores = stream_scores(track_of(still, timed))
    assert scores["seconds"] == pytest.approx(len(frames) / FPS, abs=0.1)
    assert scores["mhpe_cm"] < 2.0  # type: ignore
    assert scores["jitter_km_s3"] == 0.0 and scores["foot_skate_cm_s"] == 0.0
    assert scores["penetration_cm"] < 0.1 and scores["falls"] == 0  # type: ignore


def test_replay_writes_scores_and_refuses_what_it_cannot_write(tmp_path, capsys):
    path, out = tmp_path / "me.jsonl.gz", tmp_path / "scores.json"
    write_recording(path, stream(SyntheticUser(1.7), [], 72.0)[0], "openxr")
    replay(ReplayArgs(path, agent="questsim-now", calibrate=1.5, out=out))
    scores = json.loads(out.read_text())["scores"]
    assert scores["falls"] == 0 and "mhpe_cm" in capsys.readouterr().out
    with pytest.raises(InputError, match="the user's height is unknown"):
        replay(ReplayArgs(path, agent="questsim-now", calibrate=0.0))
    with pytest.raises(InputError, match=r"does not end in one of \.json"):
        replay(ReplayArgs(path, out=tmp_path / "x.doc"))
    none, new = tmp_path / "none.csv", tmp_path / "new"
    with pytest.raises(InputError, match=r"none\.csv: there is no such file"):
        replay(ReplayArgs(none, out=new / "x.json"))
    with pytest.raises(InputError, match=r"none\.csv: there is no such file"):
        show_recording(ShowRecordingArgs(none, out=new))
    assert not new.exists()


def test_a_user_who_first_moves_is_measured_as_soon_as_they_stand_still(tmp_path, capsys):
    still = stream(SyntheticUser(1.7), [], 72.0)[0]

    def later(frame, seconds, sway_m=0.0):
        aside = np.array([0.0, sway_m * np.sin(3.0 * frame.time_s), 0.0])
        poses = {
            n: pose._replace(position=pose.position + aside) for n, pose in frame.poses.items()
        }
        return DeviceFrame(frame.time_s + seconds, poses)

    length = still[-1].time_s + 1 / 72
    moving = [later(frame, 0.0, 0.4) for frame in still]
    frames = (*moving, *(later(f, length) for f in still), *(later(f, 2 * length) for f in still))
    follower = Follower("hmdposer")
    rest = calibrated(follower, DeviceRecording(frames), 1.5)
    assert follower.calibration is not None
    assert follower.calibration.height_m == pytest.approx(1.7, abs=0.02)
    assert length - 1.5 < rest[0].time_s - 1.5 < length + 1.5 and rest[-1] is frames[-1]
    assert "calibrated after" in capsys.readouterr().err
    with pytest.raises(InputError, match="moved"):
        calibrated(follower, DeviceRecording(tuple(moving)), 1.5)


@pytest.mark.parametrize("kind", ["bvh", "glb", "npz", "csv"])
def test_replay_writes_the_avatars_motion_over_its_floor(kind, tmp_path, monkeypatch):
    frames = stream(SyntheticUser(1.7), [], 72.0)[0][:144]
    follower = Follower("hmdposer", height_m=1.7)
    rise = np.array([0.0, 0.0, 0.4])  # the floor in the space of the devices
    raised = [
        replace(p, root_position=p.root_position + rise, link_position=p.link_position + rise)
        for p in replayed(follower, frames)
    ]
    track = track_of(frames, raised, floor_m=0.4)
    monkeypatch.setattr("agents.follower.replay.followed", lambda _: track)
    out = tmp_path / f"me.{kind}"
    replay(ReplayArgs(Path("synthetic"), out=out))
    clip = clip_from_qpos("me", track.qpos, 1.7)
    assert len(clip) == len(track.time_s) > 36
    assert abs(clip.link_position - track.link_position).max() < 1e-6
    assert clip.link_position[:, FOOT_LINKS, 2].min() < 0.15
    write_clip(tmp_path / f"same.{kind}", clip)
    assert out.read_bytes().replace(b"me", b"") == (
        (tmp_path / f"same.{kind}").read_bytes().replace(b"me", b"")
    )


def test_show_plots_the_signals_of_a_recording(tmp_path, capsys):
    path = tmp_path / "me.jsonl.gz"
    write_recording(path, stream(SyntheticUser(1.7), [], 72.0)[0], "openxr")
    show_recording(ShowRecordingArgs(path, agent="questsim-now", calibrate=1.5, out=tmp_path))
    assert (tmp_path / "me.png").stat().st_size > 20_000
    assert "headset: reports in 100.0 % of the frames" in capsys.readouterr().out
