"""For tests of ``questsim live``: a session that only listens, its server, and a bare follower."""

import asyncio
import contextlib
import json
import time

import aiohttp

from agents.headset.server import LiveServer

UPRIGHT = [0.0, 1.6, 0.0, 0.0, 0.0, 0.0, 1.0]


class Listener:
    """In place of a session: keeps what the server lets through."""

    def __init__(self):
        self.frames, self.begun, self.ended, self.assists, self.resumed = [], 0, 0, [], 0

    def push(self, frame):
        self.frames.append(frame)

    def begin(self):
        self.begun += 1

    def resume(self):
        self.resumed += 1

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


def connect(client, address: str, role: str = "driver", token: str = "", page: str = ""):
    query = f"role={role}&token={token}&id={page}"
    return client.ws_connect(f"{address}/ws?{query}", headers={"Origin": address})


async def settled(true, seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        await asyncio.sleep(0.01)


def frame_text(time_s: float = 1.0, **changes) -> str:
    return json.dumps({"type": "frame", "t": time_s, "headset": UPRIGHT} | changes)


class PoseOfHead:
    """A follower that is ready at once; its pose is no matter."""

    latency_s, assist_n, names = 0.0, 100.0, ("headset",)
    calibration, used = None, 0

    def use(self, calibration):
        self.calibration, self.used = calibration, self.used + 1

    def calibrate(self, frames, *, height_m, pose, palms):
        from agents.follower.calibration import calibrate

        self.calibration = calibrate(frames, height_m=height_m, pose=pose, palms=palms)
        return self.calibration
