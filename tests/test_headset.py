"""``questsim live``: what its server refuses, and a person in an emulated headset end to end."""

import asyncio
import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import aiohttp
import browser
import numpy as np
import pytest

from agents.headset.messages import MAX_BYTES, MAX_PER_SECOND, Allowance, frame_of, read_message
from agents.headset.server import PAGE, LiveServer
from agents.headset.session import CALIBRATING, FOLLOWING, LiveSession
from agents.headset.tls import known_host, server_context
from questsim.cli import main
from questsim.devices import DeviceFrame, from_ours
from questsim.errors import InputError
from questsim.recordings import Recording, read_recording

ROOT = Path(__file__).parents[1]
IWER = ROOT / "web" / "node_modules" / "iwer" / "build" / "iwer.min.js"
UPRIGHT = [0.0, 1.6, 0.0, 0.0, 0.0, 0.0, 1.0]


class Listener:
    """In place of a session: keeps what the server lets through."""

    def __init__(self):
        self.frames, self.begun, self.ended, self.assists = [], 0, 0, []

    def push(self, frame):
        self.frames.append(frame)

    def begin(self):
        self.begun += 1

    def end(self):
        self.ended += 1

    def assist(self, on):
        self.assists.append(on)

    def status(self):
        return {"type": "state", "state": "waiting"}


@contextlib.asynccontextmanager
async def served(token: str = "", context=None):
    server = LiveServer("127.0.0.1", token, context)
    session = Listener()
    server.session = session  # type: ignore[assignment]
    await server.start(0)
    scheme = "http" if context is None else "https"
    address = f"{scheme}://127.0.0.1:{server.port}"
    connector = aiohttp.TCPConnector(ssl=False)
    async with aiohttp.ClientSession(connector=connector) as client:
        try:
            yield server, session, client, address
        finally:
            await server.stop()


def connect(client, address: str, role: str = "driver", origin: str | None = None, token: str = ""):
    headers = {"Origin": origin or address}
    return client.ws_connect(f"{address}/ws?role={role}&token={token}", headers=headers)


async def settled(true, seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        await asyncio.sleep(0.01)


def frame_text(time_s: float = 1.0, **changes) -> str:
    return json.dumps({"type": "frame", "t": time_s, "headset": UPRIGHT} | changes)


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
    frame_text(headset=[1e9, *UPRIGHT[1:]]), frame_text(pelvis_tracker=UPRIGHT),
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


def test_client_that_goes_on_sending_rubbish_is_sent_away():
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
def walk() -> Recording:
    """The first seven seconds of the shipped recording."""
    whole = read_recording(Path("synthetic"))
    end = whole.frames[0].time_s + 7.0
    return Recording(tuple(f for f in whole.frames if f.time_s < end))


class PoseOfHead:
    """A follower that is ready at once; its pose is no matter."""

    latency_s, assist_n, names = 0.0, 100.0, ("headset",)
    calibration = None

    def calibrate(self, frames, *, height_m, pose):
        from agents.follower.calibration import calibrate

        self.calibration = calibrate(frames, height_m=height_m, pose=pose)
        return self.calibration


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


def test_user_who_moves_is_asked_to_stand_still_again():
    said = []
    with LiveSession(PoseOfHead(), said.append) as session:  # type: ignore[arg-type]
        session.begin()
        for number in range(160):
            sway = 0.3 * np.sin(number / 5.0)
            session.push(DeviceFrame.of(number / 45, {"headset": [sway, 0, 1.6, 1, 0, 0, 0]}))
            time.sleep(0.001)
    assert any("; again" in state["text"] for state in said)
    assert session.state == CALIBRATING


@pytest.mark.parametrize(
    "words, fault",
    [
        (["--pose", "sitting"], "--pose"),
        (["--assist", "-1"], "--assist"),
        (["--replay", "synthetic", "--vmc-in", "39540"], "--vmc-in"),
        (["--host", "no.such.host.invalid"], "--host"),
    ],
)
@pytest.mark.skipif(not PAGE.is_dir(), reason="the page is not built: run make page")
def test_command_refuses_options_that_cannot_be_used(words, fault, capsys):
    assert main(["live", *words]) == 2
    assert fault in capsys.readouterr().err


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


# An emulated headset that shows one recorded row a frame, at the row's own time.
EMULATOR = """
const device = new IWER.XRDevice(IWER.metaQuest3);
device.installRuntime({ forceInstall: true });
device.stereoEnabled = false;
const rows = ROWS;
let current = -1, started = false;
window.startRows = () => { started = true; };
window.rowsDone = () => current >= rows.length;
const times = (a, b) => [
  a[3]*b[0] + a[0]*b[3] + a[1]*b[2] - a[2]*b[1], a[3]*b[1] - a[0]*b[2] + a[1]*b[3] + a[2]*b[0],
  a[3]*b[2] + a[0]*b[1] - a[1]*b[0] + a[2]*b[3], a[3]*b[3] - a[0]*b[0] - a[1]*b[1] - a[2]*b[2]];
const back = (q) => [-q[0], -q[1], -q[2], q[3]];
const turned = (q, v) => times(times(q, [...v, 0]), back(q)).slice(0, 3);
const list = (v) => [v.x, v.y, v.z];
// The emulator is set by target rays, the recording has grips: a fixed offset lies between.
const offsets = {};
function place(row) {
  device.position.set(...row.headset.slice(0, 3));
  device.quaternion.set(...row.headset.slice(3));
  for (const side of ["left", "right"]) {
    const grip = row[`${side}_controller`], hand = device.controllers[side];
    hand.connected = Boolean(grip);
    if (!grip) continue;
    const quat = times(grip.slice(3), back(offsets[side].quat));
    const shift = turned(quat, offsets[side].position);
    hand.position.set(...grip.slice(0, 3).map((x, i) => x - shift[i]));
    hand.quaternion.set(...quat);
  }
}
const request = navigator.xr.requestSession.bind(navigator.xr);
navigator.xr.requestSession = async (...words) => {
  const session = await request(...words);
  const next = session.requestAnimationFrame.bind(session);
  session.requestAnimationFrame = (call) => next(function shown(time, frame) {
    if (Object.keys(offsets).length < 2) {
      for (const source of session.inputSources) {
        const pose = frame.getPose(source.gripSpace, source.targetRaySpace);
        if (pose) offsets[source.handedness] = {
          position: list(pose.transform.position),
          quat: [...list(pose.transform.orientation), pose.transform.orientation.w],
        };
      }
    }
    if (current >= 0 && current < rows.length) {
      Object.defineProperty(frame, "predictedDisplayTime", { value: 1000 * rows[current].t });
      call(time, frame);
    } else next(shown);
    // What is set now is seen in the next frame.
    if (started && current < rows.length && Object.keys(offsets).length === 2) {
      current += 1;
      if (current < rows.length) place(rows[current]);
    }
  });
  return session;
};
"""


def why_no_page() -> str:
    """Why the page cannot be tried here; empty if it can."""
    if browser.missing():
        return browser.missing()
    if not (PAGE / "live.js").is_file():
        return "the page is not built: run make page"
    if not IWER.is_file():
        return "iwer, the emulated headset, is not installed: run make page"
    return ""


def rows_of(recording: Recording) -> list[dict]:
    """A recording's frames as WebXR would show them; those without a headset are left out."""
    rows = []
    for frame in recording.frames:
        if "headset" not in frame.poses:
            continue
        row: dict = {"t": frame.time_s}
        for name, pose in frame.poses.items():
            row[name] = np.concatenate(from_ours(pose.position, pose.quat, "openxr")).tolist()
        rows.append(row)
    return rows


@contextlib.contextmanager
def running(*words: str):
    """``questsim live`` in a process of its own; gives its address."""
    command = [sys.executable, "-m", "questsim", "live", "--port", "0", *words]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, text=True, env=environment
    )
    try:
        assert process.stdout is not None
        found = re.search(r"http\S+", process.stdout.readline())
        assert found
        yield found[0]
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0


def polled(tab, script: str, seconds: float = 60.0):
    """The first value of a script that is true; the page allows no scripts made of text."""
    end = time.monotonic() + seconds
    while not (value := tab.evaluate(script)):
        assert time.monotonic() < end, script
        time.sleep(0.1)
    return value


@pytest.mark.skipif(bool(why_no_page()), reason=why_no_page() or "never")
def test_person_in_an_emulated_headset_moves_the_avatar_as_the_recording_does(walk, tmp_path):
    from agents.follower.follower import Follower
    from agents.follower.replay import calibrated, replayed
    from questsim.stream_metrics import stream_scores, track_of

    # Every second frame of five seconds: browsers that draw in software are slow.
    first = walk.frames[0].time_s
    frames = [frame for frame in walk.frames if frame.time_s < first + 5.0][::2]
    rows, out = rows_of(Recording(tuple(frames))), tmp_path / "came.jsonl.gz"
    words = ("--agent", "hmdposer", "--record", str(out))
    with running(*words) as address, browser.new_browser(160, 120) as context:
        tab = context.pages[0]
        tab.add_init_script(IWER.read_text())
        tab.add_init_script(EMULATOR.replace("ROWS", json.dumps(rows)))
        tab.goto(address)
        tab.evaluate("document.getElementById('VRButton').click()")
        polled(tab, "document.getElementById('text').textContent.startsWith('stand')")
        tab.evaluate("startRows()")
        polled(tab, "rowsDone()", 120.0)
        pose = polled(tab, f"window.lastPose?.seen >= {rows[-1]['t'] - 1e-3} && window.lastPose")
        assert "device error" in tab.inner_text("#numbers")
    came = read_recording(out)
    # Every row arrived, in order, as it was recorded.
    assert [f.time_s for f in came.frames] == pytest.approx([r["t"] for r in rows], abs=2e-5)
    for row, frame in zip(rows, came.frames, strict=True):
        assert set(frame.poses) == set(row) - {"t"}
        for name, found in frame.poses.items():
            expected = DeviceFrame.of(0.0, {name: row[name]}, "openxr").poses[name]
            assert found.position == pytest.approx(expected.position, abs=1e-4)
            assert abs(found.quat @ expected.quat) == pytest.approx(1.0, abs=1e-6)
    # And the avatar is where the same recording puts it without a page.
    follower = Follower("hmdposer", assist_n=100.0)
    rest = calibrated(follower, came)
    poses = replayed(follower, rest)
    last = poses[-1]
    place, _ = from_ours(last.link_position, last.link_quat, "openxr")
    assert np.array(pose["p"]).reshape(16, 3) == pytest.approx(place, abs=0.01)
    assert follower.calibration is not None
    known = follower.calibration
    scores = stream_scores(track_of([known.apply(f) for f in rest], poses, known.floor_m))
    assert scores is not None
