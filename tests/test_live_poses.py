"""Kinematic systems on the live page: the poses of the comparison, frame by frame, no physics."""

import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers import swaying_clip

from agents.comparison.film import over_users_floor
from agents.kinematic.estimates import Job, estimated
from agents.kinematic.interface import KinematicSystem, Poses
from agents.kinematic.recurrent.poser import RecurrentModule
from agents.kinematic.registry import AGENTS
from agents.kinematic.scenario import Scenario
from agents.kinematic.store import CARD_FILE, load_system, save_system
from agents.live import watcher
from agents.live.demo import available_drivers
from agents.live.load_driver import load_driver
from agents.live.poses import PoseDriver, PoseStream
from agents.live.recording import record
from agents.live.session import DemoSession
from agents.live.users import Recordings
from agents.live.watcher import Watcher, first_checkpoint, load_checkpoint, newest_checkpoint
from agents.run_folder import RECORD
from questsim.body import build_body
from questsim.errors import InputError
from questsim.motion.clip import FPS
from questsim.motion.kinematics import link_poses
from questsim.motion.retarget import to_clip
from questsim.motion.retarget_back import to_motion
from questsim.motion.retarget_stream import StreamRetargeter, _within_limits
from questsim.sensors import SENSOR_SETS
from questsim.skeleton import JOINTS, NUM_JOINTS
from questsim.viewing.live import Settings
from questsim.viewing.page_panel import status_text

CLIPS = [swaying_clip("first", frames=72), swaying_clip("second", frames=40)]
USERS = Recordings("synthetic", CLIPS)


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    torch.set_num_threads(1)


def session(agent: str = "hmdposer", sensors: str = "", **settings) -> DemoSession:
    return DemoSession(
        CLIPS, available_drivers(USERS), Settings("first", agent, sensors, **settings)
    )


def advance(live: DemoSession, steps: int):
    for _ in range(steps):
        live.advance()
    return live.snapshot()


def single(motion, frame: int):
    """One frame of a motion."""
    here = slice(frame, frame + 1)
    return replace(
        motion, root_position=motion.root_position[here], rotations=motion.rotations[here]
    )


class FarAway(KinematicSystem):
    """Everything two metres beside the user; keeps where it was told that the head is."""

    name, devices, required = "far", SENSOR_SETS["H+2C"], ("headset",)

    def __init__(self) -> None:
        self.told: list[np.ndarray] = []

    def _begin(self, body) -> None:
        self._offsets = body.offsets

    def _next(self, signals) -> Poses:
        rotations = np.zeros((1, NUM_JOINTS, 4))
        rotations[..., 0] = 1.0
        self.told.append(signals.position[0, 0])
        root = signals.position[:, 0] + [2.0, 0.0, -0.8]
        return Poses(root, rotations, self._offsets[None])


# --- the avatar's pose --------------------------------------------------------------------------


@pytest.mark.parametrize("floor_m", [0.0, 0.3])
def test_single_poses_are_put_on_the_avatar_as_whole_motions_are(floor_m):
    motion = to_motion(CLIPS[0])
    motion = replace(motion, root_position=motion.root_position + np.array([0.0, 0.0, floor_m]))
    whole = to_clip(motion)
    put = StreamRetargeter(motion, whole.height_m)
    for frame in (0, 17, 50):
        position, _ = link_poses(put(single(motion, frame)), whole.height_m)
        np.testing.assert_allclose(position[0], whole.link_position[frame], atol=1e-3)


def test_floating_and_sinking_poses_keep_their_height_over_the_floor():
    motion = to_motion(CLIPS[0])
    put = StreamRetargeter(motion, 1.75)
    pose = single(motion, 20)
    for lift in (0.1, -0.1):
        lifted = replace(pose, root_position=pose.root_position + np.array([0.0, 0.0, lift]))
        moved = link_poses(put(lifted), 1.75)[0] - link_poses(put(pose), 1.75)[0]
        np.testing.assert_allclose(moved[0, :, 2], lift, atol=0.01)


@pytest.mark.parametrize("agent", ["hmdposer", "ik"])
def test_the_avatar_takes_the_poses_that_the_comparison_scores(agent):
    live = session(agent)
    motion = to_motion(CLIPS[0]).resampled(60.0)
    scenario = Scenario("", SENSOR_SETS[live.settings.sensors])
    whole = over_users_floor(estimated(Job(agent, scenario, motion)), motion).scaled(1.75)
    for frame in range(1, 60):
        shown = advance(live, 1)
        np.testing.assert_allclose(shown.position, whole.link_position[frame], atol=4e-3)


def test_no_pose_is_made_from_later_readings_than_the_next_one():
    user, frame = to_motion(CLIPS[0]).resampled(60.0), 20
    shoulder, next_reading = JOINTS.index("left_shoulder"), 34  # 20 / 36 s is reading 33.3
    poses = []
    for changed in (None, next_reading, next_reading + 1):
        rotations = user.rotations.copy()
        if changed is not None:
            rotations[changed:, shoulder] = user.rotations[0, JOINTS.index("left_elbow")]
        stream = PoseStream(
            load_system("hmdposer"), replace(user, rotations=rotations), 1.75, "H+2C"
        )
        poses.append([stream.at(k) for k in range(1, frame + 1)][-1])
    np.testing.assert_array_equal(poses[0], poses[2])
    assert not np.array_equal(poses[0], poses[1])


def test_a_clip_that_begins_again_is_a_new_stream():
    live = session()
    first = advance(live, 12).qpos
    advance(live, 10)
    live.restart()
    np.testing.assert_array_equal(advance(live, 12).qpos, first)


def test_a_user_of_another_height_has_other_devices_and_another_avatar():
    heads, pelvises = [], []
    for height in (1.75, 1.4):
        system = FarAway()
        live = DemoSession(
            CLIPS,
            {"far": lambda system=system: PoseDriver(system, USERS)},
            Settings("first", "far", "", height_m=height),
        )
        advance(live, 1)
        heads.append(system.told[0][2])
        pelvises.append(advance(session(height_m=height), 30).position[0, 2])
    assert heads[1] / heads[0] == pytest.approx(1.4 / 1.75)
    assert pelvises[1] / pelvises[0] == pytest.approx(1.4 / 1.75, abs=0.02)


def test_a_stream_that_begins_within_a_clip_does_not_see_earlier_frames():
    system = FarAway()
    user = to_motion(CLIPS[0])
    stream = PoseStream(system, user, 1.75, "H+2C")
    stream.at(37)
    assert len(system.told) == 3  # readings 60, 61 and 62 for 37 / 36 s
    stream.at(37)
    assert len(system.told) == 3
    stream.at(38)
    assert len(system.told) == 5


def test_poses_are_lifted_by_the_ground_under_the_avatar():
    flat = advance(session(), 20)
    rough = advance(session(terrain="rough", roughness=2.0), 20)
    ground = rough.scenery.ground
    assert ground is not None and ground.height.std() > 0.01
    above = rough.position[0, 2] - float(ground.ground_at(rough.position[0]))
    assert above == pytest.approx(flat.position[0, 2], abs=1e-6)
    assert rough.error_m == pytest.approx(flat.error_m, abs=0.02)
    assert np.linalg.norm(rough.position[0, :2]) > 1.0  # where its user walks


def test_imus_are_worn_where_the_system_reads_them():
    live = session()
    assert live.choices.sensors == ("H+2C", "H+2C+2IMU", "H+2C+3IMU", "3T")
    without = advance(live, 20).qpos
    live.change(sensors="H+2C+3IMU")
    shown = advance(live, 20)
    assert shown.device_position.shape == (6, 3)
    assert np.abs(shown.qpos - without).max() > 1e-3
    live.change(agent="zero")
    assert live.settings.sensors == "H+2C"


def test_a_system_begins_with_six_trackers_where_it_reads_them():
    assert session("dragposer").settings.sensors == "6T"
    assert session("dragposer").choices.sensors == ("H+2C", "6T", "4T", "3T")


# --- no physics ---------------------------------------------------------------------------------


def test_nothing_pushes_it_and_the_page_says_so_and_goes_on():
    live, calm = session(), session()
    for one in (live, calm):
        advance(one, 5)
    with pytest.raises(InputError, match="has no physics"):
        live.push(200.0, 90.0)
    shown = advance(live, 5)
    np.testing.assert_array_equal(shown.qpos, advance(calm, 5).qpos)
    assert not shown.contact_force.any() and not shown.push_n.any()
    assert "no physics" in status_text(shown, live.settings)
    live.change(agent="zero")
    assert "no physics" not in status_text(live.snapshot(), live.settings)
    live.push(200.0, 90.0)
    assert advance(live, 1).push_n.any()


def test_an_object_stays_where_it_is():
    live = session(object="ball")
    begun, shown = live.snapshot().object_pose, advance(live, 40).object_pose
    assert begun is not None and shown is not None
    np.testing.assert_array_equal(begun[0], shown[0])


def test_poses_that_are_far_off_are_no_fall_and_the_clip_goes_on_to_its_end():
    live = DemoSession(
        CLIPS, {"far": lambda: PoseDriver(FarAway(), USERS)}, Settings("second", "far", "H+2C")
    )
    shown = advance(live, 20)
    assert shown.error_m > 1.0 and shown.outcome == ""
    shown = advance(live, 19)
    assert shown.outcome == "completed"
    assert "shown to the end" in status_text(shown, live.settings)
    assert advance(live, 30).time_s < 0.3


def test_a_film_of_poses_has_no_pushes():
    takes = record(session(), 1.5, 100.0)
    assert len(takes[0].moments) == 54
    assert not any(moment.push_n.any() for moment in takes[0].moments)


# --- which there are ----------------------------------------------------------------------------


def test_systems_are_listed_beside_policies_and_loaded_when_they_are_chosen():
    code = (
        "import sys; from agents.live.demo import available_drivers;"
        "names = list(available_drivers(lambda name: None));"
        "assert {'hmdposer', 'lgsik', 'sparseposer', 'dragposer', 'ik', 'ik+physics'} <= {*names};"
        "sys.exit('agents.kinematic' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=False, cwd=Path(__file__).parents[1])
    assert done.returncode == 0


def test_physics_behind_a_system_moves_the_avatar_by_torques_after_its_poses():
    name = "hmdposer+physics"
    drivers = {name: lambda: load_driver(name, USERS), "zero": lambda: load_driver("zero", USERS)}
    live = DemoSession(CLIPS, drivers, Settings("second", name, "H+2C+3IMU"))
    assert "H+2C+2IMU" in live.choices.sensors and "6T" not in live.choices.sensors
    shown = advance(live, 15)
    assert shown.outcome == "" and shown.physics and shown.contact_force.any()
    assert 0.0 < shown.error_m < 0.15
    live.push(200.0, 90.0)
    assert advance(live, 1).push_n.any()
    seen = live._sim.observation[0].copy()
    assert not np.allclose(seen, live._sim.true_observation[0])
    live.change(height_m=1.5)
    shown = advance(live, 10)
    assert shown.outcome == "" and 0.0 < shown.error_m < 0.15
    with pytest.raises(InputError, match="nobody: is not a kinematic system"):
        load_driver("nobody+physics", USERS)


def test_recordings_that_came_from_files_are_loaded_once(monkeypatch):
    clip = replace(CLIPS[0], source_sha256="0123")
    calls = []

    def load(spec, seed):
        calls.append((spec, seed))
        return [to_motion(clip).resampled(30.0), to_motion(CLIPS[1])]

    monkeypatch.setattr("questsim.motion.spec.load_recordings", load)
    users = Recordings("mine", [clip, replace(CLIPS[1], name="lost", source_sha256="45")], 3)
    assert users("first").fps == 30.0
    assert users("first").fps == 30.0
    assert users("lost").fps == FPS  # a library may have clips alone
    assert calls == [("mine", 3)]


# --- while it learns ----------------------------------------------------------------------------


def checkpoint(folder: Path, steps: int, seed: int) -> None:
    """A small system with random weights, as a training writes it."""
    torch.manual_seed(seed)
    entry = AGENTS["hmdposer"]
    spec = entry.presets["smoke"].spec
    module = entry.build(spec)
    assert isinstance(module, RecurrentModule)
    module.template.copy_(torch.as_tensor(to_motion(CLIPS[0]).offsets))
    training = {"steps": steps, "minutes": 2.0, "motions": "synthetic", "trained": ["network"]}
    save_system(folder, module, "hmdposer", spec, training)


def test_a_newer_checkpoint_of_a_system_takes_over(tmp_path):
    run = tmp_path / "run"
    checkpoint(run / "network" / "last", 500, 1)
    first = newest_checkpoint(run)
    assert first is not None and first.of_system
    assert first.training()["motions"] == "synthetic"
    driver, note = load_checkpoint(run, first, USERS)
    assert note == "network/last, 500 steps, 2 min"
    live = DemoSession(CLIPS, {"run": lambda: driver}, Settings("first", "run", ""))
    watching = Watcher(run, "run", live, first, USERS)
    assert not watching.poll()
    before = advance(live, 10).qpos
    checkpoint(run / "network" / "best", 1000, 2)
    assert watching.poll() and not watching.poll()
    shown = advance(live, 1)
    assert shown.note.startswith("network/best, 1000") and shown.time_s == pytest.approx(11 / FPS)
    assert np.abs(shown.qpos - before).max() > 0.02
    (run / "network" / "best" / CARD_FILE).write_text("half")
    assert not watching.poll()
    assert advance(live, 1).step == 12


def test_play_waits_for_the_first_checkpoint_and_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(watcher, "POLL_S", 0.02)
    (tmp_path / RECORD).write_text("format: questsim-run\n")
    found = []
    thread = threading.Thread(target=lambda: found.append(first_checkpoint(tmp_path)))
    thread.start()
    time.sleep(0.1)
    assert not found
    checkpoint(tmp_path / "network" / "last", 1, 1)
    thread.join(60.0)
    assert [each.folder for each in found] == [tmp_path / "network" / "last"]
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "no checkpoint yet" in error


def test_a_joint_that_leaves_its_range_stays_at_that_end_and_does_not_come_back_at_the_other():
    low, high = build_body().model.jnt_range[1:].T
    joint = int((high - low).argmin())
    out = np.linspace(high[joint] - 0.1, (low + high)[joint] / 2 + 1.05 * np.pi, 12)
    angles = np.zeros((12, len(low)))
    # Each pose arrives as Euler angles do: within half a turn.
    angles[:, joint] = (out + np.pi) % (2 * np.pi) - np.pi
    whole = _within_limits(angles, None)[:, joint]
    np.testing.assert_allclose(whole, np.minimum(out, high[joint]))
    last, streamed = None, []
    for pose in angles:
        last = _within_limits(pose[None], last)[0]
        streamed.append(last[joint])
    np.testing.assert_array_equal(streamed, whole)
