"""Access control of the page: requests must name this server, its own page, and its token.

Any website can make a browser send requests to a server on loopback. Two headers identify such
requests: Host is the name that the browser asked for (a foreign name after DNS rebinding), Origin
is the page that sent the request.
"""

from __future__ import annotations

import contextlib
import hmac
import ipaddress
import secrets
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

LOOPBACK = "127.0.0.1"
DEFAULT_PORT = 8080
LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})
COOKIE = "questsim-token"


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches a host's address."""
    try:
        found = {str(address[0]) for *_, address in socket.getaddrinfo(host, None)}
        return all(ipaddress.ip_address(address).is_loopback for address in found)
    except (OSError, ValueError):
        return False


@dataclass(frozen=True)
class Access:
    """Rules that decide which requests a server answers.

    Attributes:
        host: the address on which it listens.
        token: token required in the address of the first request; None on loopback.
    """

    host: str
    token: str | None

    @classmethod
    def of(cls, host: str) -> Access:
        """For a server at this address: with a token where others can reach it."""
        return cls(host, None if is_loopback(host) else secrets.token_urlsafe(16))

    def refusal(self, host: str | None, origin: str | None) -> str | None:
        """Reason to reject a request, from its headers; None if it is allowed.

        Args:
            host: the header Host, with or without a port.
            origin: the header Origin, if there is one.
        """
        if host is None or not self._is_own(_name(host)):
            return f"this server is not {str(host)[:100]!r}"
        if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
            return f"pages of {origin[:100]!r} may not use this server"
        return None

    def knows(self, path: str, cookies: str | None) -> bool:
        """Whether a request has the token, in its address or as a cookie."""
        if self.token is None:
            return True
        given = parse_qs(urlsplit(path).query).get("token", [])
        with contextlib.suppress(CookieError):
            kept = SimpleCookie(cookies or "").get(COOKIE)
            given += [kept.value] if kept is not None else []
        return any(hmac.compare_digest(g.encode(), self.token.encode()) for g in given)

    def _is_own(self, name: str) -> bool:
        if name in LOOPBACK_NAMES or name == self.host.lower():
            return True
        if is_loopback(self.host):
            return False
        # DNS rebinding needs a name; a numeric address was typed by the user.
        with contextlib.suppress(ValueError):
            ipaddress.ip_address(name)
            return True
        return name == socket.gethostname().lower()

    def answer(self, connection: Any, request: Any) -> Any:
        """A response of websockets that refuses a request, or brings the token; None to go on."""
        headers = request.headers
        reason = self.refusal(headers.get("Host"), headers.get("Origin"))
        if reason is None and not self.knows(request.path, headers.get("Cookie")):
            reason = "open the whole address that was printed, token included"
        if reason is not None:
            return connection.respond(HTTPStatus.FORBIDDEN, reason + "\n")
        upgrade = (headers.get("Upgrade") or "").lower() == "websocket"
        if self.token is None or upgrade or "token" not in parse_qs(urlsplit(request.path).query):
            return None
        response = connection.respond(HTTPStatus.SEE_OTHER, "")
        response.headers["Location"] = "/"
        response.headers["Set-Cookie"] = f"{COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/"
        return response


def _name(host: str) -> str:
    """The name of a Host header, without its port."""
    return (urlsplit(f"//{host}").hostname or "").lower()


@contextlib.contextmanager
def checking(access: Access) -> Iterator[None]:
    """Servers of websockets that start meanwhile ask ``access`` before they answer.

    viser starts its server by itself and has no option for this.
    """
    from websockets.asyncio import server

    plain = server.serve

    def serve(*args: Any, process_request: Callable[..., Any] | None = None, **options: Any) -> Any:
        def checked(connection: Any, request: Any) -> Any:
            refused = access.answer(connection, request)
            if refused is not None or process_request is None:
                return refused
            return process_request(connection, request)

        return plain(*args, process_request=checked, **options)

    server.serve = serve  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        server.serve = plain  # type: ignore[misc]
