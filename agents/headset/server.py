"""The web server of ``questsim live``: the page, one driver (a headset) and many watchers."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import ssl
from collections.abc import Awaitable, Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from aiohttp import WSCloseCode, WSMsgType, web

from agents.follower.scene import PLAIN, Scene
from agents.headset.messages import (
    MAX_BYTES,
    MAX_FAULTS,
    MAX_PER_SECOND,
    Allowance,
    frame_of,
    read_message,
)
from agents.headset.session import LiveSession
from agents.headset.tls import known_host
from envs.objects import WorldObject, shapes_of
from envs.terrain import Terrain, height_field
from questsim.body import DEFAULT_HEIGHT_M
from questsim.errors import InputError
from questsim.exporting.glb import avatar_glb

PAGE = Path(__file__).parent / "page"
FILES = {"/": ("index.html", "text/html"), "/live.js": ("live.js", "text/javascript")}
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'unsafe-inline'; "
    "connect-src 'self' blob:; img-src 'self' data: blob:; frame-ancestors 'none'"
)
GROUND_M, GROUND_POINTS = 16.0, 161
"""Side of the square of ground that a page shows, and points along it."""
MAX_CLIENTS = 32
CLOSE_S = 1.0
"""How long a client may take to answer a close (s)."""
SLOW_S = 10.0
"""A client that receives nothing for longer than this (s) is disconnected."""
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def check_page() -> None:
    """Require that the page has been built.

    Raises:
        InputError: the page is missing; the message says how to build it.
    """
    if not all((PAGE / name).is_file() for name, _ in FILES.values()):
        raise InputError("the page is not built", "questsim live", "run make live in a checkout")


class LiveServer:
    """Serves one session.

    Args:
        host: address to listen on.
        token: required in every address; empty on loopback, where none is needed.
        context: TLS context; None for plain HTTP on loopback.
        page_drives: whether a page may drive the avatar.
        scene: the ground and the objects that pages show.

    Attributes:
        session: set this before ``start``.
        received: number of accepted frames of drivers.
        failed: set when the session's thread has failed.
        port: the port that it listens on.
    """

    def __init__(
        self,
        host: str,
        token: str,
        context: ssl.SSLContext | None,
        page_drives: bool = True,
        scene: Scene = PLAIN,
    ) -> None:
        self._scene = scene
        self._host, self._token, self._context = host, token, context
        self._page_drives = page_drives
        self._clients: dict[web.WebSocketResponse, _Outbox] = {}
        self._driver: web.WebSocketResponse | None = None
        self._driver_id = ""
        self._loop = asyncio.get_running_loop()
        self.session: LiveSession | None = None
        self.failed = asyncio.Event()
        self.received = 0
        self.port = 0

    async def start(self, port: int) -> None:
        """Start listening.

        Raises:
            OSError: the port is taken.
        """
        app = web.Application(middlewares=[self._guard], client_max_size=MAX_BYTES)
        for path in FILES:
            app.router.add_get(path, self._file)
        app.router.add_get("/avatar.glb", self._avatar)
        app.router.add_get("/ground.json", self._ground)
        app.router.add_get("/objects.json", self._objects)
        app.router.add_get("/ws", self._socket)
        self._runner = web.AppRunner(app, access_log=None, handle_signals=False)
        await self._runner.setup()
        site = web.TCPSite(self._runner, self._host, port, ssl_context=self._context)
        await site.start()
        self.port = int(self._runner.addresses[0][1])

    async def stop(self) -> None:
        """Disconnect all clients and close."""
        for socket in list(self._clients):
            await socket.close(code=WSCloseCode.GOING_AWAY, message=b"the server ends")
        await self._runner.cleanup()

    def publish(self, state: dict[str, Any]) -> None:
        """Send a state to all pages; may be called from any thread."""
        text = json.dumps(state, separators=(",", ":"), allow_nan=False)
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._broadcast, text, state["type"])

    def _broadcast(self, text: str, kind: str) -> None:
        if kind == "failure":
            self.failed.set()
        for outbox in self._clients.values():
            outbox.put(text, kind)

    @web.middleware
    async def _guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse foreign hosts, foreign origins and missing tokens before anything else."""
        host = request.headers.get("Host", "")
        if not known_host(host, self._host):
            raise web.HTTPForbidden(text="this host is not served")
        scheme = "http" if self._context is None else "https"
        origin = request.headers.get("Origin")
        if origin is not None and origin != f"{scheme}://{host}":
            raise web.HTTPForbidden(text="this origin is not served")
        if request.path == "/ws" and origin is None:
            raise web.HTTPForbidden(text="no origin")
        given = request.query.get("token", "").encode()
        # The script is public; everything about the user requires the token.
        has_token = hmac.compare_digest(given, self._token.encode())
        if self._token and not has_token and request.path != "/live.js":
            raise web.HTTPForbidden(text="the address lacks its token")
        return await handler(request)

    async def _file(self, request: web.Request) -> web.StreamResponse:
        name, kind = FILES[request.path]
        headers = {
            "Content-Security-Policy": POLICY,
            "Cache-Control": "no-cache",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
        }
        body = (PAGE / name).read_bytes()
        return web.Response(body=body, content_type=kind, charset="utf-8", headers=headers)

    async def _avatar(self, request: web.Request) -> web.StreamResponse:
        try:
            height = float(request.query.get("height", "1.75"))
            if not 1.2 <= height <= 2.2:
                raise ValueError
        except ValueError:
            raise web.HTTPBadRequest(text="height is not a stature") from None
        body = await asyncio.to_thread(_glb, round(height, 2))
        return web.Response(body=body, content_type="model/gltf-binary")

    async def _ground(self, _: web.Request) -> web.StreamResponse:
        """Heights of the ground around the origin for the page; null for a plane."""
        terrain = self._scene.terrain
        return web.json_response(None if terrain is None else ground_of(terrain))

    async def _objects(self, _: web.Request) -> web.StreamResponse:
        """Parts of each object for the page."""
        assert self.session is not None
        height = self.session.height_m or DEFAULT_HEIGHT_M
        return web.json_response([parts_of(obj, height) for obj in self._scene.objects])

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        if len(self._clients) >= MAX_CLIENTS:
            raise web.HTTPServiceUnavailable(text="too many watchers")
        socket = web.WebSocketResponse(
            timeout=CLOSE_S, max_msg_size=MAX_BYTES, heartbeat=20.0, compress=False
        )
        await socket.prepare(request)
        drives = request.query.get("role") == "driver"
        page_id = request.query.get("id", "")
        again = drives and page_id != "" and page_id == self._driver_id
        if drives and (not self._page_drives or (self._driver is not None and not again)):
            reason = b"another page drives" if self._page_drives else b"the page only watches"
            await socket.close(code=4001, message=reason)
            return socket
        assert self.session is not None
        outbox = _Outbox(socket)
        self._clients[socket] = outbox
        outbox.put(json.dumps(self.session.status()), "state")
        sender = asyncio.create_task(outbox.run())
        if drives:
            self._take_over(socket, page_id, again)
        try:
            await self._listen(socket, drives)
        finally:
            sender.cancel()
            del self._clients[socket]
            if self._driver is socket:
                self._driver = None
                self.session.end()
        return socket

    def _take_over(self, socket: web.WebSocketResponse, page_id: str, again: bool) -> None:
        """Let a page drive; one whose connection was lost goes on without a new calibration."""
        assert self.session is not None
        lost, self._driver, self._driver_id = self._driver, socket, page_id
        if lost is not None:  # without this, only a missed heartbeat would end it
            self._ending = asyncio.create_task(lost.close())
        if again:
            self.session.resume()
        else:
            self.session.begin()

    async def _listen(self, socket: web.WebSocketResponse, drives: bool) -> None:
        allowance, faults = Allowance(MAX_PER_SECOND), 0
        async for message in socket:
            if message.type != WSMsgType.TEXT:
                faults += 1
            elif not allowance.take():
                continue
            elif not drives:
                faults += 1  # watchers must not send messages
            else:
                try:
                    self._handle(read_message(message.data))
                except InputError as error:
                    faults += 1
                    self._clients[socket].put(json.dumps({"type": "refused", "text": str(error)}))
            if faults > MAX_FAULTS:
                await socket.close(code=WSCloseCode.POLICY_VIOLATION, message=b"too many faults")
                return

    def _handle(self, message: dict[str, Any]) -> None:
        assert self.session is not None
        kind = message["type"]
        if kind == "frame":
            self.session.push(frame_of(message))
            self.received += 1
        elif kind == "calibrate":
            self.session.begin()
        elif kind == "assist" and isinstance(message.get("on"), bool):
            self.session.assist(message["on"])
        else:
            raise InputError(f"{kind[:40]!r} is not a request that a page may send", "message")


class _Outbox:
    """Messages that wait to be sent to a client: the newest pose, and all other messages.

    A slow client misses poses, so that the server's memory use stays bounded.
    """

    def __init__(self, socket: web.WebSocketResponse) -> None:
        self._socket = socket
        self._messages: list[str] = []
        self._pose: str | None = None
        self._news = asyncio.Event()

    def put(self, text: str, kind: str = "") -> None:
        """Queue one message."""
        if kind == "pose":
            self._pose = text
        else:
            self._messages = [*self._messages[-31:], text]
        self._news.set()

    async def run(self) -> None:
        """Send until the client disconnects or stops receiving."""
        try:
            while True:
                await self._news.wait()
                self._news.clear()
                texts, self._messages = self._messages, []
                if self._pose is not None:
                    texts.append(self._pose)
                    self._pose = None
                for text in texts:
                    await asyncio.wait_for(self._socket.send_str(text), SLOW_S)
        except (ConnectionError, RuntimeError):
            return
        except TimeoutError:
            await self._socket.close()


@lru_cache(maxsize=8)
def _glb(height_m: float) -> bytes:
    return avatar_glb(height_m)


def ground_of(terrain: Terrain) -> dict[str, Any]:
    """A square of ``GROUND_M`` around the origin in the page's axes.

    Returns:
        ``points`` along each side, ``side_m``, and ``heights`` in metres, row by row towards the
        user's back, each from left to right.
    """
    along = np.linspace(-0.5 * GROUND_M, 0.5 * GROUND_M, GROUND_POINTS)
    right, back = np.meshgrid(along, along)
    heights = height_field(terrain).ground_at(np.stack([-back, -right], axis=-1))
    return {
        "points": GROUND_POINTS,
        "side_m": GROUND_M,
        "heights": [round(float(height), 3) for height in heights.ravel()],
    }


def parts_of(obj: WorldObject, height_m: float) -> list[dict[str, Any]]:
    """Balls and boxes of an object in the page's axes (x right, y up, z back).

    Returns:
        For each part ``shape``, ``size`` (the radius, or the whole edges) and ``place`` in metres.
    """
    parts = []
    for shape in shapes_of(obj, height_m):
        forward, left, up = shape.place
        size = list(shape.size)
        if shape.shape == "box":
            size = [2.0 * shape.size[axis] for axis in (1, 2, 0)]
        parts.append({"shape": shape.shape, "size": size, "place": [-left, up, -forward]})
    return parts
