"""``questsim live``: what its server and its command refuse, and how a user is measured."""

import asyncio
import contextlib
import json
import threading
import time
from pathlib import Path

import aiohttp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from agents.follower.bridge import IDENTITY
from agents.follower.calibration import Calibration
from agents.follower.follower import Follower
from agents.follower.replay import calibrated, replayed
from agents.headset.messages import MAX_BYTES, MAX_PER_SECOND, Allowance, frame_of, read_message
from agents.headset.server import PAGE, ground_of, parts_of
from agents.headset.session import (
    CALIBRATING,
    CALIBRATION_S,
    FOLLOWING,
    MOST_WAITING,
    WAITING,
    LiveSession,
)
from agents.headset.tls import known_host, server_context
from envs.objects import WorldObject
from envs.terrain import height_field, terrain_named
from questsim.cli import main
from questsim.devices import DeviceFrame, DevicePose, from_ours
from questsim.errors import InputError
from questsim.recordings import DeviceRecording, read_recording, write_recording
from questsim.synthetic_user import STILL_S, SyntheticUser, stream
from tests.live_listener import UPRIGHT, PoseOfHead, connect, frame_text, served, settled


def test_frames_of_a_driver_arrive_in_our_axes():
    async def run():
        async with served() as (_, session, client, address), connect(client, address) as socket:
            await socket.send_str(frame_text(headset=[0.5, 1.6, -2.0, 0.0, 0.0, 0.0, 1.0]))
            await settled(lambda: session.frames)
        assert session.frames[0].poses["headset"].position == pytest.approx([2.0, -0.5, 1.6])

    asyncio.run(run())


@pytest.mark.parametrize(
    "headers", [{"Host": "evil.example"}, {"Origin": "http://evil.example"}, {"Origin": "null"}]
)
def test_foreign_hosts_and_origins_are_refused(headers):
    async def run():
        async with served() as (_, session, client, address):
            async with client.get(f"{address}/ws?role=driver", headers=headers) as answer:
                assert answer.status == 403
            async with client.get(f"{address}/avatar.glb", headers=headers) as answer:
                assert answer.status == 403
            assert session.begun == 0

    asyncio.run(run())


def test_socket_without_an_origin_is_refused():
    async def run():
        async with served() as (_, _session, client, address):
            with pytest.raises(aiohttp.WSServerHandshakeError):
                await client.ws_connect(f"{address}/ws?role=driver")

    asyncio.run(run())


def test_beyond_loopback_only_tls_and_the_token_open_the_page():
    async def run():
        context = server_context(None, None, ["127.0.0.1"])
        async with served("secret", context) as (_, session, client, address):
            for path in ("/", "/avatar.glb", "/ws"):
                for query in ("", "?token=wrong"):
                    async with client.get(f"{address}{path}{query}") as answer:
                        assert answer.status == 403, path
            async with client.get(f"{address}/avatar.glb?token=secret") as answer:
                assert answer.status == 200
                assert (await answer.read())[:4] == b"glTF"
            async with connect(client, address, token="secret") as socket:
                await socket.send_str(frame_text())
                await settled(lambda: session.frames)

    asyncio.run(run())


def test_one_client_drives_and_another_may_when_it_has_gone():
    async def run():
        async with served() as (_, session, client, address):
            first = await connect(client, address)
            await settled(lambda: session.begun == 1)
            async with connect(client, address) as second:
                message = await second.receive()
                assert message.type == aiohttp.WSMsgType.CLOSE and message.data == 4001
            async with connect(client, address, "watcher") as watcher:
                assert json.loads((await watcher.receive()).data)["type"] == "state"
            await first.close()
            await settled(lambda: session.ended == 1)
            async with connect(client, address):
                await settled(lambda: session.begun == 2)

    asyncio.run(run())


def test_driver_whose_connection_was_lost_takes_over_from_it_and_goes_on():
    async def run():
        async with served() as (_, session, client, address):
            lost = await connect(client, address, page="a")
            await settled(lambda: session.begun == 1)
            async with connect(client, address, page="b") as other:
                assert (await other.receive()).data == 4001
            async with connect(client, address, page="a") as socket:
                await settled(lambda: lost.closed or session.resumed == 1)
                await socket.send_str(frame_text())
                await settled(lambda: session.frames)
                assert (session.begun, session.resumed, session.ended) == (1, 1, 0)
            await settled(lambda: session.ended == 1)

    asyncio.run(run())


def test_watchers_see_every_state_and_move_nothing():
    async def run():
        async with served() as (server, session, client, address):
            async with connect(client, address, "watcher") as watcher:
                await watcher.receive()
                await watcher.send_str(frame_text())
                threading.Thread(target=server.publish, args=({"type": "pose", "t": 3.5},)).start()
                assert json.loads((await watcher.receive()).data) == {"type": "pose", "t": 3.5}
            assert session.frames == [] and session.begun == 0

    asyncio.run(run())


RUBBISH = [
    "no json", "[]", '{"type": 3}', '{"type": "shutdown"}', '{"type": "assist", "on": "yes"}',
    frame_text(headset=[0.0] * 7), frame_text(headset=[float("nan")] * 7),
    frame_text(headset=["0"] * 7), frame_text(headset=UPRIGHT[:6]), frame_text(headset=None),
    frame_text(headset=[1e9, *UPRIGHT[1:]]), frame_text(headset=[10**400, *UPRIGHT[1:]]),
    frame_text(pelvis_tracker=UPRIGHT),
    frame_text(float("inf")), frame_text(-1.0), '{"type": "frame"}', "[" * 4000,
]  # fmt: skip


@pytest.mark.parametrize("text", RUBBISH)
def test_messages_that_are_no_frames_are_refused_in_words_and_the_driver_stays(text):
    async def run():
        async with served() as (_, session, client, address), connect(client, address) as socket:
            await socket.receive()
            await socket.send_str(text)
            assert json.loads((await socket.receive()).data)["type"] == "refused"
            await socket.send_str(frame_text())
            await settled(lambda: len(session.frames) == 1)

    asyncio.run(run())


def test_a_client_that_keeps_sending_invalid_messages_is_disconnected():
    async def run():
        async with served() as (_, session, client, address):
            async with connect(client, address) as socket:
                with contextlib.suppress(ConnectionError):
                    for _ in range(60):
                        await socket.send_str("rubbish")
                await settled(lambda: session.ended == 1)
            async with connect(client, address):
                await settled(lambda: session.begun == 2)

    asyncio.run(run())


def test_flood_is_dropped_beyond_the_rate():
    async def run():
        async with served() as (_, session, client, address), connect(client, address) as socket:
            began = time.monotonic()
            for number in range(2000):
                await socket.send_str(frame_text(1.0 + number))
            await socket.close()
            await settled(lambda: session.ended == 1)
            allowed = MAX_PER_SECOND * (1.0 + time.monotonic() - began)
            assert len(session.frames) <= min(allowed + 1, 1999)
            assert len(session.frames) >= 100

    asyncio.run(run())


def test_message_that_is_too_long_closes_its_connection_alone():
    async def run():
        async with served() as (_, session, client, address):
            async with connect(client, address) as socket:
                await socket.receive()
                await socket.send_str("x" * (MAX_BYTES + 1))
                assert (await socket.receive()).data == aiohttp.WSCloseCode.MESSAGE_TOO_BIG
            async with connect(client, address, "watcher") as watcher:
                assert json.loads((await watcher.receive()).data)["type"] == "state"
            assert session.frames == []

    asyncio.run(run())


def test_allowance_is_its_rate_and_a_burst_of_one_second():
    now = [0.0]
    allowance = Allowance(10.0, lambda: now[0])
    assert [allowance.take() for _ in range(12)] == [True] * 10 + [False] * 2
    now[0] = 0.25
    assert [allowance.take() for _ in range(3)] == [True, True, False]


@pytest.mark.parametrize(
    "header, known",
    [
        ("127.0.0.1:8085", True), ("localhost:8085", True), ("[::1]:8085", True),
        ("192.168.1.7:8085", True), ("evil.example:8085", False), ("", False),
        ("127.0.0.1.evil.example", False),
    ],
)  # fmt: skip
def test_only_names_of_this_machine_and_plain_addresses_are_known(header, known):
    assert known_host(header, "127.0.0.1") is known


def test_frame_of_a_message_is_the_devices_frame():
    frame = frame_of(read_message(frame_text(2.5, left_controller=[-0.3, 1, 0, 0, 0, 0, 1])))
    assert frame.time_s == 2.5 and set(frame.poses) == {"headset", "left_controller"}
    assert frame.poses["left_controller"].position == pytest.approx([0.0, 0.3, 1.0])


@pytest.fixture(scope="module")
def walk() -> DeviceRecording:
    """The first seven seconds of the shipped recording."""
    whole = read_recording(Path("synthetic"))
    end = whole.frames[0].time_s + 7.0
    return DeviceRecording(tuple(f for f in whole.frames if f.time_s < end))


def test_session_measures_the_user_for_three_seconds_and_then_follows(walk):
    said = []
    with LiveSession(PoseOfHead(), said.append) as session:  # type: ignore[arg-type]
        session.begin()
        for frame in walk.frames[:120]:  # less than three seconds
            session.push(frame)
            time.sleep(0.001)
        end = time.monotonic() + 20
        while "1 s" not in session.status()["text"]:
            assert time.monotonic() < end
            time.sleep(0.01)
        assert session.state == CALIBRATING and session.height_m is None
        for frame in walk.frames[120:140]:
            if session.state != FOLLOWING:
                session.push(frame)
            time.sleep(0.02)
    assert session.failure is None or session.height_m is not None
    assert any(state["state"] == FOLLOWING for state in said if state["type"] == "state")
    assert session.height_m == pytest.approx(1.75, abs=0.1)


def test_session_publishes_the_poses_of_a_replay(walk):
    frames = [f for f in walk.frames if f.time_s < walk.frames[0].time_s + 4.5]
    pulled = frames[-9]
    poses = {name: pose for name, pose in pulled.poses.items() if name != "left_controller"}
    frames[-9] = DeviceFrame(pulled.time_s, poses)
    said = []
    with LiveSession(Follower("questsim-now"), said.append) as session:
        session.begin()
        for number, frame in enumerate(frames):
            while session.state == WAITING or session.taken < number:
                time.sleep(0.0005)
            session.push(frame)
    follower = Follower("questsim-now")
    rest = calibrated(follower, DeviceRecording(tuple(frames)))
    shown = [state for state in said if state["type"] == "pose"]
    assert len(shown) == len(rest) > 50
    for state, pose in zip(shown, replayed(follower, rest), strict=True):
        position, _ = from_ours(pose.link_position, pose.link_quat, "openxr")
        assert np.reshape(state["p"], (16, 3)) == pytest.approx(position, abs=1e-4)
    assert [s["seen"] for s in shown if s["silent"]] == [pytest.approx(pulled.time_s, abs=1e-4)]
    assert shown[-9]["silent"] == ["left_controller"]


@pytest.mark.parametrize("known, state", [(Calibration(1.7), FOLLOWING), (None, CALIBRATING)])
def test_lost_connection_starts_neither_calibration_nor_avatar_anew(known, state):
    follower = PoseOfHead()
    with LiveSession(follower, lambda _: None, calibration=known) as session:  # type: ignore[arg-type]
        for call, expected in (
            (session.begin, state), (session.end, WAITING), (session.resume, state)
        ):  # fmt: skip
            call()
            end = time.monotonic() + 20
            while session.state != expected:
                assert time.monotonic() < end
                time.sleep(0.001)
    assert follower.used == (known is not None)


def test_a_user_who_moves_during_calibration_is_asked_to_stand_still():
    said = []
    with LiveSession(PoseOfHead(), said.append) as session:  # type: ignore[arg-type]
        session.begin()
        for number in range(160):
            sway = 0.3 * np.sin(number / 5.0)
            session.push(DeviceFrame.of(number / 45, {"headset": [sway, 0, 1.6, 1, 0, 0, 0]}))
            time.sleep(0.001)
    assert any("; again" in state["text"] for state in said)
    assert session.state == CALIBRATING


def test_session_with_palms_locates_the_controllers_after_six_seconds():
    mount = (0.02, -0.01, 0.015)
    mounts = {"left_controller": (mount, (0.2, 0.0, 0.0))}
    frames, _ = stream(SyntheticUser(1.8, mounts=mounts, palms_deg=45.0), [])  # type: ignore
    frames = [frame for frame in frames if frame.time_s >= STILL_S - CALIBRATION_S - 0.2]
    follower, said = PoseOfHead(), []
    with LiveSession(follower, said.append, palms=True) as session:  # type: ignore[arg-type]
        session.begin()
        for frame in frames:
            if session.state != FOLLOWING:
                session.push(frame)
                time.sleep(0.001)
    assert any(state.get("text", "").startswith("let your arms hang and turn") for state in said)
    assert follower.calibration is not None
    found = follower.calibration.mounts["left_controller"].apply(DevicePose(np.zeros(3), IDENTITY))
    true = -Rotation.from_rotvec([0.2, 0.0, 0.0]).inv().apply(mount)
    assert np.linalg.norm(found.position - true) < 0.01


@pytest.mark.parametrize(
    "words, fault",
    [
        (["--pose", "sitting"], "--pose"),
        (["--palms", "--calibration", "me.json"], "--palms"),
        (["--assist", "-1"], "--assist"),
        (["--assist", "9000"], "9000 N is not within 0 and 2000 N"),
        (["--height", "9"], "--height: is 9 m, not within 1.2 to 2.2 m"),
        (["--vmc-in", "99999"], "--vmc-in: 99999 is not 0 to 65535"),
        (["--cert", "nothere.pem", "--key", "nothere.pem"], "nothere.pem"),
        (["--replay", "synthetic", "--vmc-in", "39540"], "--vmc-in"),
        (["--vmc-roles", "LHR-1=pelvis_tracker"], "--vmc-roles"),
        (["--vmc-in", "39540", "--vmc-roles", "LHR-1=tail"], "--vmc-roles"),
        (["--host", "no.such.host.invalid"], "--host"),
    ],
)
@pytest.mark.skipif(not PAGE.is_dir(), reason="the page is not built: run make page")
def test_command_refuses_options_that_cannot_be_used(words, fault, capsys, monkeypatch):
    monkeypatch.setattr("agents.headset.command.Follower", None)  # before an agent is loaded
    assert main(["live", *words]) == 2
    assert fault in capsys.readouterr().err


@pytest.mark.skipif(not PAGE.is_dir(), reason="the page is not built: run make page")
@pytest.mark.parametrize("words", [["live", "--replay"], ["replay"]])
def test_command_refuses_to_calibrate_a_user_whose_calibration_is_recorded(words, tmp_path, capsys):
    path = tmp_path / "me.jsonl.gz"
    known = {"height_m": 1.7, "floor_m": 0.0, "heading_rad": 0.0, "mounts": {}}
    write_recording(
        path, [DeviceFrame.of(t, {"headset": UPRIGHT}) for t in (0.0, 0.1)], "openxr", known
    )
    assert main([*words, str(path), "--pose", "a-pose"]) == 2
    assert "--pose: does nothing" in capsys.readouterr().err


def test_command_says_what_builds_a_missing_page(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("agents.headset.server.PAGE", tmp_path)
    assert main(["live"]) == 2
    error = capsys.readouterr().err
    assert "make live" in error and error.count("\n") == 1


def test_certificate_without_its_key_is_refused(tmp_path):
    with pytest.raises(InputError, match="key"):
        server_context(tmp_path / "a.pem", None, [])
    broken = tmp_path / "a.pem"
    broken.write_text("rubbish")
    with pytest.raises(InputError, match=r"a\.pem"):
        server_context(broken, broken, [])


def test_the_page_gets_objects_in_its_own_axes():
    (ball,) = parts_of(WorldObject("ball"), 1.75)
    assert ball == {"shape": "ball", "size": [0.11], "place": [0.0, 0.11, 0.0]}
    seat, back = parts_of(WorldObject("chair"), 1.75)[:2]
    # A seat 44 cm wide and deep; its back, 4 cm thick, is behind it, on the page's +z.
    assert seat["size"] == pytest.approx([0.44, 0.04, 0.44])
    assert back["size"] == pytest.approx([0.44, 0.44, 0.04])
    assert back["place"] == pytest.approx([0.0, 0.67, 0.2])


def test_the_page_gets_the_ground_in_its_own_axes():
    terrain = terrain_named("rough", "--terrain")
    ground = ground_of(terrain)
    expected = []
    for ahead, left in ((1.0, 2.0), (4.0, -5.0), (-6.0, 3.0)):
        row, column = (round((x + 0.5 * ground["side_m"]) / 0.1) for x in (-ahead, -left))
        expected.append(height_field(terrain).ground_at(np.array([ahead, left])))
        found = ground["heights"][row * ground["points"] + column]
        assert found == pytest.approx(expected[-1], abs=1e-3)
    assert max(expected) - min(expected) > 0.01


def test_a_full_queue_drops_frames_and_no_request():
    follower = PoseOfHead()
    session = LiveSession(follower, lambda state: None)  # type: ignore[arg-type]
    session.assist(False)
    for number in range(100):
        session.push(DeviceFrame.of(float(number), {}))
    assert session.dropped == 100 - MOST_WAITING
    with session:
        pass
    assert follower.assist_n == 0.0 and session.taken == MOST_WAITING
    assert not session.status()["assist_on"]
