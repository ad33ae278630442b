"""The web server of a page: its address, and restrictions of viser.

viser serves the page. By default it takes another port when one is in use, lets any viewer publish
the page through a server on the internet, and answers invalid messages with a traceback. This
module prevents all three.
"""

from __future__ import annotations

import contextlib
import io
import logging
import os
import socket
import sys
import traceback
from collections.abc import Iterator
from pathlib import Path
from weakref import WeakKeyDictionary

import viser
from viser import _messages as viser_messages

from questsim.errors import InputError
from questsim.viewing.page_access import LOOPBACK, Access, checking, is_loopback

_ACCESS: WeakKeyDictionary[viser.ViserServer, Access] = WeakKeyDictionary()
"""Who may use each server."""


def open_server(host: str, port: int, title: str) -> viser.ViserServer:
    """A server that listens on exactly the given address.

    Args:
        host: an address or name of this machine.
        port: 0 for any free one.
        title: of the page.

    Raises:
        InputError: the port is in use or not allowed, or the host is not this machine's.
    """
    check_address(host, port)
    _one_line_for_rubbish()
    access = Access.of(host)
    with _silence(), checking(access):
        server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
    if port and server.get_port() != port:  # taken since it was checked
        close_server(server)
        raise _in_use(port)
    # Nothing that a viewer sends may open the page to the world.
    for message in (viser_messages.ShareUrlRequest, viser_messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(message)
    _ACCESS[server] = access
    return server


def close_server(server: viser.ViserServer) -> None:
    """Stop listening."""
    with _silence():
        server.stop()


def check_address(host: str, port: int) -> None:
    """Reject an address on which no server can listen.

    Raises:
        InputError: with the reason.
    """
    if not 0 <= port <= 65535:
        raise InputError(f"{port} is not 0 to 65535", "--port")
    try:
        kind, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(kind) as probe:
            if os.name == "posix":  # as the server itself does; it has another meaning elsewhere
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            probe.listen()
    except socket.gaierror as error:
        raise InputError(f"{host!r} is not an address of this machine", "--host") from error
    except PermissionError as error:
        raise InputError(f"{port} is not allowed", "--port", "choose one above 1023") from error
    except OSError as error:
        if "address already in use" in str(error).lower():
            raise _in_use(port) from error
        raise InputError(f"cannot listen at {host} ({error.strerror})", "--host") from error


def _in_use(port: int) -> InputError:
    return InputError(f"{port} is in use", "--port", "choose another, or 0 for any free one")


def address_of(server: viser.ViserServer) -> str:
    """The URL for a browser on this machine, with the token if one is needed."""
    host, access = server.get_host(), _ACCESS.get(server)
    shown = LOOPBACK if host in ("0.0.0.0", "::", "") else host
    address = f"http://{f'[{shown}]' if ':' in shown else shown}:{server.get_port()}"
    return address if access is None or access.token is None else f"{address}/?token={access.token}"


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Without viser's own greetings."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield


class _OneLine(logging.Filter):
    """Makes one line of what the server logs about a viewer that it could not understand."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Always true: the record is shortened, not dropped."""
        error = record.exc_info[1] if record.exc_info else None
        if error is None or not _comes_from_viewer(error):
            return True
        reason = " ".join(str(error).split())[:100]
        record.msg = f"a viewer sent what cannot be read: {type(error).__name__} {reason}".strip()
        record.args, record.exc_info, record.exc_text = (), None, None
        return True


def _comes_from_viewer(error: BaseException) -> bool:
    """Whether it was raised while a viewer's message was taken in."""
    folders = {
        Path(frame.filename).parts[-3:-1] for frame in traceback.extract_tb(error.__traceback__)
    }
    return any("viser" in folder or "websockets" in folder for folder in folders)


def _one_line_for_rubbish() -> None:
    for name in ("websockets.server", "asyncio"):
        logger = logging.getLogger(name)
        if not any(isinstance(f, _OneLine) for f in logger.filters):
            logger.addFilter(_OneLine())


def warn_if_open(host: str) -> None:
    """Warn on stderr if other machines can reach the page."""
    if not is_loopback(host):
        print(
            f"warning: the page listens on {host} without encryption: anyone who has its address, "
            "token included, can watch and control it",
            file=sys.stderr,
        )
