"""Only the page's own requests are answered: not another website's, not a rebound name's."""

from __future__ import annotations

import asyncio
import http.client
from collections.abc import Iterator

import pytest
import websockets
from websockets.asyncio.client import connect

from questsim.viewing.page_access import COOKIE, Access
from questsim.viewing.page_server import LOOPBACK, address_of, close_server, open_server


@pytest.fixture(scope="module")
def server() -> Iterator[object]:
    server = open_server(LOOPBACK, 0, "test")
    yield server
    close_server(server)


@pytest.fixture(scope="module")
def open_one() -> Iterator[object]:
    """A server that others may reach; nothing but this machine asks it here."""
    server = open_server("0.0.0.0", 0, "test")
    yield server
    close_server(server)


def get(server, path: str = "/", **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection(LOOPBACK, server.get_port(), timeout=20)
    connection.putrequest("GET", path, skip_host=True)
    given = {"Host": f"{LOOPBACK}:{server.get_port()}"} | headers
    for name, value in given.items():
        if value:
            connection.putheader(name, value)
    connection.endheaders()
    return connection.getresponse()


def accepted(server, origin: str | None, host: str | None = None, cookie: str = "") -> bool:
    """Whether a WebSocket is opened for a page of this origin that asked for this host."""

    async def attempt() -> bool:
        headers = {"Cookie": cookie} if cookie else {}
        address = f"ws://{host or LOOPBACK}:{server.get_port()}"
        options = {"host": LOOPBACK, "port": server.get_port(), "additional_headers": headers}
        try:
            async with connect(address, origin=origin, proxy=None, **options):  # type: ignore[arg-type]
                return True
        except websockets.InvalidStatus as error:
            assert error.response.status_code == 403
            return False

    return asyncio.run(attempt())


def test_the_pages_own_requests_are_answered(server):
    port = server.get_port()
    assert get(server).status == 200
    assert get(server, Host=f"localhost:{port}").status == 200
    assert accepted(server, f"http://{LOOPBACK}:{port}")
    assert accepted(server, f"http://localhost:{port}", "localhost")


@pytest.mark.parametrize("origin", ["https://evil.example", "null", "http://localhost:1"])
def test_another_websites_socket_is_refused(server, origin):
    assert not accepted(server, origin)


def test_a_rebound_name_is_refused(server):
    port = server.get_port()
    response = get(server, Host=f"evil.example:{port}")
    assert response.status == 403
    assert b"not 'evil.example" in response.read()
    assert not accepted(server, f"http://evil.example:{port}", "evil.example")
    assert get(server, Host="").status == 403


def test_a_page_that_others_reach_wants_its_token(open_one):
    address = address_of(open_one)
    path = address[address.index("/?") :]
    assert get(open_one).status == 403
    assert get(open_one, "/?token=wrong").status == 403
    first = get(open_one, path)
    assert first.status == 303
    cookie = (first.getheader("Set-Cookie") or "").partition(";")[0]
    assert cookie.startswith(COOKIE)
    assert get(open_one, Cookie=cookie).status == 200
    own = f"http://{LOOPBACK}:{open_one.get_port()}"
    assert accepted(open_one, own, cookie=cookie)
    assert not accepted(open_one, own)
    assert not accepted(open_one, "https://evil.example", cookie=cookie)


def test_an_open_page_accepts_ip_addresses_and_no_foreign_names():
    access = Access.of("0.0.0.0")
    assert access.token
    assert access.refusal("192.0.2.7:8080", None) is None
    assert access.refusal("evil.example:8080", None)
    assert Access.of("127.0.0.1").refusal("192.0.2.7:8080", None)
