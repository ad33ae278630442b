"""A live session does what viewers ask, refuses what it cannot do, and goes on."""

import os
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers import swaying_clip
from PIL import Image

from agents.agent import Needs, ZeroAgent
from agents.live.demo import DemoArgs, PlayArgs, _clips, demo, drivers_beside, play
from agents.live.drivers import TorqueDriver
from agents.live.recording import record
from agents.live.runner import Runner
from agents.live.session import AFTER_FALL_S, DemoSession
from agents.live.users import Recordings
from agents.live.watcher import Watcher, load_checkpoint, newest_checkpoint
from agents.loading import load_agent
from agents.policy.checkpoint import CARD_FILE, WEIGHTS_FILE, save_policy
from agents.policy.export import check_exportable
from agents.policy.policy_agent import PolicyAgent, new_policy
from agents.policy.spec import Layout, PolicySpec
from envs.config import EnvConfig
from envs.core import BatchSim
from envs.layout import observation_layout
from questsim.bodies import read_body
from questsim.errors import InputError
from questsim.motion.clip import FPS
from questsim.motion.spec import load_motions
from questsim.skeleton import LINKS
from questsim.viewing import gl
from questsim.viewing.live import Settings, Trace
from questsim.viewing.live_film import Take, film, take_frames

NOBODY = Recordings("synthetic", [])
DRIVERS = {
    "demo": lambda: TorqueDriver(load_agent("demo")),
    "zero": lambda: TorqueDriver(ZeroAgent()),
}


def session(agent: str = "demo", **settings) -> DemoSession:
    clips = [swaying_clip("first", frames=144), swaying_clip("second", frames=54)]
    return DemoSession(clips, DRIVERS, Settings("first", agent, **settings))


def advance(live: DemoSession, steps: int):
    for _ in range(steps):
        live.advance()
    return live.snapshot()


def test_time_goes_on_by_one_frame_a_step():
    live = session()
    assert live.snapshot().time_s == 0.0
    assert advance(live, 36).time_s == 1.0


def test_a_paused_session_stands_still_and_steps_singly():
    live = session()
    live.pause(True)
    assert not live.advance() and live.snapshot().paused
    live.step_once()
    assert live.advance() and not live.advance()
    assert live.snapshot().step == 1
    live.pause(False)
    assert advance(live, 3).step == 4


def test_a_snapshot_keeps_its_moment():
    live = session()
    before = live.snapshot()
    position = before.position.copy()
    advance(live, 10)
    np.testing.assert_array_equal(before.position, position)


def test_the_reference_and_the_devices_are_those_of_the_clip():
    live = session(height_m=1.6)
    shown = advance(live, 10)
    clip = swaying_clip("first", frames=144).scaled(1.6)
    np.testing.assert_allclose(shown.reference_position, clip.link_position[10])
    head = shown.reference_position[LINKS.index("head")]
    assert np.linalg.norm(shown.device_position[0] - head) < 0.3
    assert shown.device_position.shape == (3, 3)


def test_a_user_of_another_size_stands_in_its_own_where_the_avatar_is_to_be():
    live = session("zero", height_m=1.9, avatar_height_m=1.5)
    begun, shown = live.snapshot(), advance(live, 10)
    assert (shown.scenery.height_m, shown.scenery.user_m) == (1.5, 1.9)
    clip = swaying_clip("first", frames=144)
    small, tall = clip.scaled(1.5).link_position[10], clip.scaled(1.9).link_position[10]
    spot = (small[0] - tall[0]) * [1.0, 1.0, 0.0]
    np.testing.assert_allclose(shown.reference_position, tall + spot, atol=1e-6)
    np.testing.assert_allclose(shown.reference_qpos[:3], shown.reference_position[0])
    head = LINKS.index("head")
    assert np.linalg.norm(shown.device_position[0] - small[head]) < 0.25  # as the avatar is told
    first = clip.scaled(1.5).link_position[0]
    assert np.linalg.norm(begun.position - first, axis=-1).max() < 0.03


def test_a_user_of_another_size_stands_on_the_terrain():
    live = session("zero", height_m=1.9, avatar_height_m=1.5, terrain="rough", roughness=2.0)
    shown = advance(live, 5)
    assert shown.scenery.ground is not None
    above = shown.reference_position[0, 2] - float(
        shown.scenery.ground.ground_at(shown.position[0])
    )
    tall = swaying_clip("first", frames=144).scaled(1.9)
    assert above == pytest.approx(tall.link_position[5, 0, 2], abs=0.03)


def test_an_avatar_of_its_users_height_goes_along_with_it():
    live = session("zero")
    live.change(height_m=1.6)
    assert live.settings.avatar_m == 1.6
    live.change(avatar_height_m=1.5)
    live.change(height_m=1.8)
    assert (live.settings.height_m, live.settings.avatar_m) == (1.8, 1.5)
    live.change(avatar_height_m=1.8)
    live.change(height_m=1.7)
    assert live.settings.avatar_m == 1.7


def test_a_seated_clip_brings_its_chair_and_takes_it_away():
    seated = replace(swaying_clip("seated", frames=54), kind="sit")
    live = DemoSession([swaying_clip("first"), seated], DRIVERS, Settings("first", "zero"))
    assert live.change(clip="seated").object == "chair" and live.snapshot().object_pose is not None
    assert live.change(clip="first").object == "none"
    live.change(object="ball")
    assert live.change(clip="seated").object == "ball"  # what was chosen stays
    live.change(object="none")
    assert live.change(clip="first").object == "none"


def test_the_avatar_follows_and_its_feet_bear_its_weight():
    shown = advance(session(), 60)
    assert shown.outcome == "" and shown.error_m < 0.1
    assert 400.0 < shown.contact_force[:, 2].sum() < 1100.0


def test_a_push_moves_the_avatar_where_it_is_aimed():
    chest = LINKS.index("chest")
    calm = advance(session(), 30).position[chest]
    for direction, axis, sign in ((0.0, 0, 1.0), (90.0, 1, 1.0), (180.0, 0, -1.0)):
        live = session()
        advance(live, 20)
        live.push(150.0, direction)
        assert np.linalg.norm(advance(live, 1).push_n) == pytest.approx(150.0)
        moved = advance(live, 9).position[chest] - calm
        assert sign * moved[axis] > 0.02
        assert not live.snapshot().push_n.any()


def test_an_avatar_that_fell_lies_for_a_moment_and_begins_again():
    live = session("zero")
    for _ in range(300):
        live.advance()
        if live.snapshot().outcome:
            break
    assert live.snapshot().outcome == "fell"
    assert advance(live, round(AFTER_FALL_S * FPS) + 1).time_s == 0.0
    assert live.snapshot().outcome == ""


def test_a_clip_that_was_followed_begins_again():
    live = session()
    live.change(clip="second")
    assert advance(live, 53).outcome == "completed"
    assert advance(live, 40).time_s < 1.0


def test_changes_take_effect_at_once_and_begin_the_clip_again():
    live = session()
    scenery = advance(live, 20).scenery
    live.change(clip="second", height_m=1.5)
    shown = live.snapshot()
    assert (live.settings.clip, shown.time_s, shown.scenery.height_m) == ("second", 0.0, 1.5)
    assert shown.scenery.number > scenery.number
    assert shown.duration_s == pytest.approx(53 / FPS)


def test_a_change_of_speed_goes_on_from_where_it_is():
    live = session()
    advance(live, 20)
    live.change(speed=0.5)
    assert live.snapshot().time_s == pytest.approx(20 / FPS)


@pytest.mark.parametrize(
    "wish",
    [
        {"clip": "third"},
        {"agent": "nobody"},
        {"sensors": "H"},
        {"sensors": "H+2C+2IMU"},
        {"height_m": 3.0},
        {"avatar_height_m": 3.0},
        {"terrain": "sea"},
        {"roughness": 5.0},
        {"object": "elephant"},
        {"height_m": "tall"},
        {"speed": 1e9},
        {"colour": "red"},
    ],
)
def test_impossible_requests_are_refused_in_one_line_and_change_nothing(wish):
    live = session()
    before = advance(live, 20)
    with pytest.raises(InputError) as error:
        live.change(**wish)
    assert "\n" not in str(error.value)
    assert live.settings == Settings("first", "demo")
    assert advance(live, 1).step == before.step + 1


@pytest.mark.parametrize("push", [(2000.0, 0.0), (-1.0, 0.0), (np.nan, 0.0), (10.0, "left")])
def test_a_push_without_sense_is_refused(push):
    live = session()
    with pytest.raises(InputError):
        live.push(*push)
    assert not advance(live, 1).push_n.any()


def test_an_agent_can_be_given_only_the_sensors_it_reads():
    live = session()
    assert live.choices.sensors == ("H+2C", "3T")
    live.change(agent="zero")
    assert "H" in live.choices.sensors and "H+2C+2IMU" not in live.choices.sensors
    live.change(sensors="6T")
    assert live.snapshot().device_position.shape == (6, 3)
    live.change(agent="demo")
    assert live.settings.sensors == "H+2C"


def test_a_driver_that_is_replaced_takes_over_where_the_avatar_is():
    live = session()
    advance(live, 36)
    live.replace_driver("demo", TorqueDriver(ZeroAgent()), "newer")
    shown = live.snapshot()
    assert (shown.time_s, shown.note) == (1.0, "newer")
    assert advance(live, 60).outcome == "fell"


def test_terrain_lifts_the_avatar_and_its_reference():
    live = session(terrain="rough", roughness=2.0)
    shown = advance(live, 5)
    ground = shown.scenery.ground
    assert ground is not None and ground.height.std() > 0.01
    for position in (shown.position, shown.reference_position):
        above = position[0, 2] - float(ground.ground_at(position[0]))
        assert above == pytest.approx(0.91, abs=0.06)
    assert np.linalg.norm(shown.position[0, :2]) > 1.0  # it plays somewhere on the field
    flat = live.change(terrain="flat")
    assert flat.terrain == "flat" and live.snapshot().scenery.ground is None


def test_an_object_is_there_and_rests_on_the_ground():
    live = session(object="ball")
    shown = advance(live, 40)
    assert [part.shape for part in shown.scenery.parts] == ["ball"]
    assert shown.object_pose is not None
    place, quat = shown.object_pose
    assert place[2] == pytest.approx(0.0, abs=0.15)
    assert np.linalg.norm(quat) == pytest.approx(1.0)
    live.change(object="hurdle")
    assert len(live.snapshot().scenery.parts) == 5
    live.change(object="none")
    assert live.snapshot().object_pose is None


def test_same_settings_same_bits():
    def end() -> np.ndarray:
        live = session()
        advance(live, 20)
        live.push(120.0, 45.0)
        return advance(live, 20).position

    np.testing.assert_array_equal(end(), end())


def test_the_runner_keeps_time_and_stops():
    live = session()
    began = time.monotonic()
    with Runner(live) as runner:
        while live.snapshot().step < 18:
            assert runner.running and time.monotonic() < began + 60
            time.sleep(0.02)
    steps = live.snapshot().step
    # A busy machine may be late, but never early.
    assert steps <= FPS * (time.monotonic() - began) + 4
    time.sleep(0.1)
    assert live.snapshot().step == steps


def test_a_failure_of_the_simulation_is_shown_and_ends_the_page(monkeypatch):
    live = session()
    monkeypatch.setattr(live, "advance", lambda: 1 / 0)
    stop = threading.Event()
    with Runner(live, stop) as runner:
        assert stop.wait(10.0)
    assert isinstance(runner.failure, ZeroDivisionError)


def test_many_threads_may_ask_at_once():
    live = session()
    failures = []

    def ask(number: int) -> None:
        try:
            for i in range(10):
                live.change(height_m=1.5 + 0.01 * ((number + i) % 5))
                live.push(50.0, 90.0)
                assert live.snapshot().position.shape == (16, 3)
        except Exception as failure:
            failures.append(failure)

    with Runner(live):
        threads = [threading.Thread(target=ask, args=(n,)) for n in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert not failures


def test_the_trace_keeps_the_last_seconds_once():
    live = session()
    trace = Trace(seconds=0.5)
    for _ in range(40):
        live.advance()
        trace.add(live.snapshot(), FPS)
        trace.add(live.snapshot(), FPS)
    time_s, error_cm, left, right = trace.columns()
    assert len(time_s) == 19 and time_s[-1] == pytest.approx(40 / FPS)
    assert error_cm[-1] == pytest.approx(100.0 * live.snapshot().error_m)
    forces = np.linalg.norm(live.snapshot().contact_force, axis=-1)
    assert (left[-1], right[-1]) == pytest.approx(tuple(forces))


def test_a_policy_that_observes_proportions_can_be_watched_but_not_exported():
    layout = Layout.of(observation_layout(EnvConfig(observe_proportions=True)))
    policy = new_policy(PolicySpec(hidden=(8,), critic_blocks=()), layout)
    agent = PolicyAgent(policy, Needs(observe_proportions=True))
    assert "H+2C" in TorqueDriver(agent).sensor_sets()
    with pytest.raises(InputError, match="proportions, which the graph does not take"):
        check_exportable(agent)


def checkpoint(folder: Path, steps: int, seed: int) -> None:
    """A small policy with random weights, as a training writes it."""
    torch.manual_seed(seed)
    layout = Layout.of(observation_layout(EnvConfig()))
    policy = new_policy(PolicySpec(hidden=(8,), critic_blocks=()), layout)
    save_policy(folder, policy, Needs(), {"steps": steps, "minutes": 2.0, "motions": "synthetic"})


def test_the_newest_checkpoint_is_that_written_last(tmp_path):
    assert newest_checkpoint(tmp_path) is None
    checkpoint(tmp_path / "teacher" / "best", 1, 1)
    checkpoint(tmp_path / "student" / "last", 2, 2)
    for folder, time_s in (("teacher/best", 2000), ("student/last", 1000)):
        os.utime(tmp_path / folder / CARD_FILE, (time_s, time_s))
    newest = newest_checkpoint(tmp_path)
    assert newest is not None and newest.folder == tmp_path / "teacher" / "best"
    stage = newest_checkpoint(tmp_path / "student")
    assert stage is not None and stage.folder.name == "last"


def test_a_newer_checkpoint_takes_over_and_a_broken_one_does_not(tmp_path):
    run = tmp_path / "run"
    checkpoint(run / "teacher" / "last", 1_000_000, 1)
    first = newest_checkpoint(run)
    assert first is not None
    driver, note = load_checkpoint(run, first, NOBODY)
    assert note == "teacher/last, 1.00 M steps, 2 min"
    live = DemoSession([swaying_clip(frames=144)], {"run": lambda: driver}, Settings("sway", "run"))
    watcher = Watcher(run, "run", live, first, NOBODY)
    assert not watcher.poll()
    advance(live, 5)
    checkpoint(run / "teacher" / "last", 2_000_000, 2)
    assert watcher.poll() and not watcher.poll()
    shown = live.snapshot()
    assert shown.note.startswith("teacher/last, 2.00 M") and shown.step == 5
    (run / "teacher" / "last" / WEIGHTS_FILE).write_bytes(b"half")
    os.utime(run / "teacher" / "last" / CARD_FILE, (2e9, 2e9))
    assert not watcher.poll()
    assert live.snapshot().note == shown.note
    assert advance(live, 1).step == 6


def test_a_run_of_a_shipped_policys_name_is_watched_itself():
    driver = TorqueDriver(ZeroAgent())
    drivers = drivers_beside("questsim", driver, NOBODY)
    assert drivers["questsim"]() is driver and next(iter(drivers)) == "questsim"
    assert {"tracker", "zero", "random"} < set(drivers)


def test_a_long_library_is_shortened_aloud(monkeypatch, capsys):
    clips = [swaying_clip(f"c{i}", frames=8, kind=f"kind{i % 5}") for i in range(90)]
    monkeypatch.setattr("questsim.motion.spec.load_motions", lambda motions, seed: clips)
    listed = _clips("many", "c7")
    assert 80 <= len(listed) <= 81 and "c7" in {clip.name for clip in listed}
    assert capsys.readouterr().err == "80 of 90 clips are listed; --clip NAME adds one\n"


def test_play_refuses_a_folder_that_is_of_no_training(tmp_path):
    with pytest.raises(InputError, match="no policy or system"):
        play(PlayArgs(tmp_path))
    with pytest.raises(InputError, match="no such folder"):
        play(PlayArgs(tmp_path / "nowhere"))


def test_a_video_of_another_kind_is_refused():
    with pytest.raises(InputError, match="--video"):
        demo(DemoArgs(video=Path("out.avi")))


@pytest.mark.skipif(gl.find_gl() is None, reason=gl.missing_gl())
def test_a_session_is_filmed_with_its_push(tmp_path):
    live = session(terrain="rough", object="box")
    takes = record(live, 1.5, 100.0)
    assert [take.settings.clip for take in takes] == ["first"]
    assert len(takes[0].moments) == 54
    takes = record(live, 4.0, 100.0)
    pushed = [moment.push_n for moment in takes[0].moments if moment.push_n.any()]
    assert 7 <= len(pushed) <= 8 and np.linalg.norm(pushed[0]) == pytest.approx(100.0)
    some = [Take(take.settings, take.moments[60:66]) for take in takes[:1]]
    frames = list(take_frames(some[0], 160, 120))
    assert len(frames) == 6 and frames[0].shape == (120, 160, 3)
    picture = Image.open(film(some, tmp_path / "film.gif"))
    assert getattr(picture, "n_frames", 1) == 2 and picture.size == (360, 202)


def test_baselines_can_use_every_set_that_has_poses():
    assert DRIVERS["zero"]().sensor_sets() == ("H", "H+2C", "6T", "4T", "3T")


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ({"object": "bal"}, "ball"),
        ({"terrain": "ruogh"}, "rough"),
        ({"agent": "questim"}, "questsim"),
        ({"motions": "synthetic:stand", "clip": "synthetic-stand-33"}, "synthetic-stand-3"),
    ],
)
def test_a_demo_refuses_what_it_cannot_show_before_its_page_opens(given, meant, monkeypatch):
    monkeypatch.setattr("agents.live.demo.Page", None)
    with pytest.raises(InputError, match=f"did you mean {meant}?"):
        demo(DemoArgs(**given))


@pytest.mark.parametrize(
    ("given", "fault"),
    [
        ({"seconds": 5.0}, "--seconds: has no effect without --video"),
        ({"push": 0.0}, "--push: has no effect without --video"),
        ({"video": Path("new/x.mp4"), "port": 9000}, "--port: has no effect beside --video"),
        ({"motions": "mine.npz", "seed": 3}, "--seed: has no effect"),
        ({"video": Path("new/x.mp4"), "motions": "mine.npz"}, "no motions 'mine.npz'"),
    ],
)
def test_a_demo_refuses_options_without_an_effect(given, fault, tmp_path, monkeypatch):
    monkeypatch.setattr("agents.live.demo.Page", None)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=fault):
        demo(DemoArgs(**given))
    assert not list(tmp_path.iterdir())


def test_pages_refuse_a_policy_of_another_body_before_they_open(tmp_path, monkeypatch):
    body = read_body("gymnasium-humanoid")
    sim = BatchSim(load_motions("synthetic:stand"), EnvConfig(body=body), 1)
    policy = new_policy(PolicySpec(hidden=(8,), critic_blocks=()), Layout.of(sim.layout), hinges=17)
    save_policy(tmp_path / "best", policy, Needs(body=body), {})
    sim.close()
    monkeypatch.setattr("agents.live.demo.Page", None)
    with pytest.raises(InputError, match="the page shows only the avatar"):
        demo(DemoArgs(agent=str(tmp_path)))
    with pytest.raises(InputError, match="the page shows only the avatar"):
        play(PlayArgs(tmp_path))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"terrain": "ruogh"}, "did you mean rough"),
        ({"height": 9.0}, "height 9 m is not within"),
        ({"motions": "nothere"}, "no motions 'nothere'"),
        ({"motions": "synthetic:stand", "clip": "WRONG"}, "there is no clip 'WRONG'"),
    ],
)
def test_play_refuses_what_it_cannot_show_before_it_waits_for_a_run(
    given, message, tmp_path, monkeypatch
):
    for never in ("Page", "first_checkpoint"):
        monkeypatch.setattr(f"agents.live.demo.{never}", None)
    with pytest.raises(InputError, match=message):
        play(PlayArgs(tmp_path, **given))
