"""What ``questsim live`` opens, feeds and sends, with a session that only listens."""

import asyncio
import contextlib
import re
import time
from dataclasses import replace

import aiohttp
import pytest
from pythonosc.udp_client import SimpleUDPClient

from agents.follower.calibration import Calibration
from agents.follower.scene import PLAIN
from agents.headset.command import _osc_driver, _serve, _session_maker, feed
from agents.headset.options import LiveArgs
from questsim.osc import receiver
from questsim.osc.receiver import VmcReceiver
from questsim.recordings import DeviceRecording
from questsim.synthetic_user import SyntheticUser, stream
from tests.live_listener import Listener, PoseOfHead, connect, frame_text, served, settled
from tests.osc_ends import listening, pose_of, wait_for

FRAMES = tuple(stream(SyntheticUser(1.7), [], 400.0)[0][:20])
HEAD = ["head", 0.0, 1.7, 0.0, 0.0, 0.0, 0.0, 1.0]


class Session(Listener):
    """A listener that the command can enter."""

    failure = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


@contextlib.asynccontextmanager
async def commanded(args: LiveArgs, capsys):
    """The command's server; gives its session and the address that it has printed."""
    session, publish, said = Session(), [], []

    def make(say):
        publish.append(say)
        return session

    def printed() -> str:
        said.append(capsys.readouterr().out)
        return "".join(said)

    serving = asyncio.create_task(_serve(args, make, None, PLAIN))  # type: ignore[arg-type]
    await settled(lambda: "open " in printed() or serving.done())
    found = re.search(r"open (\S+)", "".join(said))
    assert found is not None
    yield session, found[1]
    publish[0]({"type": "failure"})
    await serving


def test_beyond_loopback_the_printed_address_has_tls_and_a_token_and_nothing_else_opens(capsys):
    async def run():
        async with commanded(LiveArgs(host="0.0.0.0", port=0), capsys) as (session, address):
            found = re.fullmatch(r"https://[^/]+:(\d+)/\?token=(\S{20,})", address)
            assert found is not None
            port, token = found.groups()
            here = f"https://127.0.0.1:{port}"
            connector = aiohttp.TCPConnector(ssl=False)
            async with aiohttp.ClientSession(connector=connector) as client:
                for query, status in (("", 403), ("?token=x", 403), (f"?token={token}", 200)):
                    async with client.get(f"{here}/avatar.glb{query}") as answer:
                        assert answer.status == status
                with pytest.raises(aiohttp.ClientError):
                    await client.get(f"http://127.0.0.1:{port}/?token={token}")
                foreign = {"Origin": "https://evil.example"}
                with pytest.raises(aiohttp.WSServerHandshakeError):
                    await client.ws_connect(f"{here}/ws?token={token}", headers=foreign)
                async with connect(client, here, token=token) as socket:
                    await socket.send_str(frame_text())
                    await settled(lambda: session.frames)

    asyncio.run(run())


def test_on_loopback_the_printed_address_is_plain(capsys):
    async def run():
        async with commanded(LiveArgs(port=0), capsys) as (_, address):
            assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", address)

    asyncio.run(run())


def test_a_recording_is_fed_frame_by_frame_and_begins_anew_at_its_end():
    async def run():
        session = Session()
        feeding = asyncio.create_task(feed(session, DeviceRecording(FRAMES)))  # type: ignore[arg-type]
        await settled(lambda: session.begun == 2 and len(session.frames) >= 25)
        feeding.cancel()
        assert [f.time_s for f in session.frames[:25]] == [f.time_s for f in (*FRAMES, *FRAMES[:5])]

    asyncio.run(run())


def test_a_vmc_program_drives_the_session():
    session = Session()
    with _osc_driver(0, {}, session) as port:  # type: ignore[arg-type]
        assert session.begun == 1 and port is not None
        SimpleUDPClient("127.0.0.1", port).send_message("/VMC/Ext/Hmd/Pos", HEAD)
        wait_for(lambda: len(session.frames) == 1)
    assert session.frames[0].poses["headset"].position == pytest.approx([0.0, 0.0, 1.7])


def test_every_pose_goes_to_the_vmc_and_vrchat_programs_that_are_named():
    class Standing(PoseOfHead):
        def step(self, frame):
            return replace(pose_of(), time_s=frame.time_s)

    with listening() as (port, got):
        args = LiveArgs(vmc=f"127.0.0.1:{port}", vrchat=f":{port}")
        make = _session_maker(args, Standing(), Calibration(1.7), None)  # type: ignore[arg-type]
        with make(lambda _: None) as session:
            session.begin()
            session.push(FRAMES[0])
            wait_for(lambda: len(got) >= 19 + 16)
    names = [message[0] for message in got]
    assert names.count("/VMC/Ext/Bone/Pos") == 16
    assert sum(name.startswith("/tracking/trackers/") for name in names) == 16


def test_a_flood_of_osc_is_dropped_beyond_the_rate(monkeypatch):
    monkeypatch.setattr(receiver, "MAX_PER_SECOND", 5)
    frames = []
    with VmcReceiver(frames.append, port=0) as listener:
        began = time.monotonic()
        client = SimpleUDPClient("127.0.0.1", listener.port)
        for _ in range(200):
            client.send_message("/VMC/Ext/Hmd/Pos", HEAD)
        wait_for(lambda: len(frames) + listener.refused == 200)
        passed_s = time.monotonic() - began
    assert 5 <= len(frames) <= 5 * (1.0 + passed_s) + 1


def test_a_driver_that_vanishes_ends_and_watchers_see_on():
    async def run():
        async with served() as (server, session, client, address):
            async with connect(client, address, "watcher") as watcher:
                await watcher.receive()
                driver = await connect(client, address)
                await driver.send_str(frame_text())
                await settled(lambda: session.frames)
                transport = driver._writer.transport
                assert transport is not None
                transport.abort()  # no closing words
                await settled(lambda: session.ended == 1)
                server.publish({"type": "pose", "t": 2.0})
                assert (await watcher.receive()).json()["t"] == 2.0
            async with connect(client, address):
                await settled(lambda: session.begun == 2)

    asyncio.run(run())
