"""TLS certificates, and the host names by which a browser may address this machine."""

from __future__ import annotations

import ipaddress
import socket
import ssl
from pathlib import Path

from questsim.errors import InputError

LOOPBACK_NAMES = ("127.0.0.1", "localhost", "::1")


def own_addresses() -> list[str]:
    """Addresses of this machine that other machines can reach, as far as it can tell."""
    found = []
    for target in ("192.0.2.1", "2001:db8::1"):  # documentation addresses; nothing is sent
        kind = socket.AF_INET6 if ":" in target else socket.AF_INET
        try:
            with socket.socket(kind, socket.SOCK_DGRAM) as probe:
                probe.connect((target, 9))
                found.append(str(probe.getsockname()[0]))
        except OSError:
            continue
    return found


def server_context(cert: Path | None, key: Path | None, names: list[str]) -> ssl.SSLContext:
    """TLS with the given certificate, or with a new temporary one for these names.

    Raises:
        InputError: only one of certificate and key is given, or they cannot be read.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    if (cert is None) != (key is None):
        raise InputError("a certificate needs its key", "--cert, --key", "give both")
    if cert is not None:
        try:
            context.load_cert_chain(cert, key)
        except (ssl.SSLError, OSError) as error:
            raise InputError(f"cannot be used ({error.strerror or error})", cert) from None
        return context
    import trustme

    trustme.CA().issue_cert(*names).configure_cert(context)
    return context


def known_host(header: str, host: str) -> bool:
    """Whether a Host header names this machine; rejects DNS names that others could control."""
    name = header.rsplit(":", 1)[0] if not header.endswith("]") else header
    name = name.strip("[]").lower()
    own = socket.gethostname().lower()
    if name in (*LOOPBACK_NAMES, host.lower(), own, f"{own}.local"):
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
