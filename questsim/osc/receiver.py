"""Devices from other programs over OSC: VMC's ``/VMC/Ext/Hmd``, ``/Con`` and ``/Tra``.

They come as name (a serial), position and quaternion xyzw, in Unity's axes and in the world of
the tracking. Source: VMC protocol specification 3.1.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from pythonosc.dispatcher import Dispatcher, Handler
from pythonosc.osc_server import BlockingOSCUDPServer

from questsim.devices import DeviceFrame
from questsim.errors import InputError
from questsim.osc.senders import LOOPBACK

VMC_IN_PORT = 39540
MAX_PER_SECOND = 2000
"""Messages beyond that are dropped."""
SILENT_S = 0.5
"""A device without a message for longer does not report."""
_KINDS = ("Hmd", "Con", "Tra")


class _Exactly(Dispatcher):
    """Takes messages when they come, by their exact address.

    python-osc's own dispatcher waits until the time of a bundle, which may be years ahead, and
    makes a regular expression of each address, which may take hours to match. VMC needs neither.
    """

    def __init__(self) -> None:
        super().__init__(strict_timing=False)

    def handlers_for_address(self, address_pattern: str) -> Iterator[Handler]:  # type: ignore[override]
        """The handlers of this very address."""
        yield from self._map.get(address_pattern, ())


class VmcReceiver:
    """Listens for device poses and makes a frame of every message about the headset.

    Args:
        take: called with each frame, in a thread of the receiver's own; its times are seconds of
            ``time.monotonic``.
        host, port: where to listen; by default on this machine only.
        roles: device by serial, e.g. ``{"LHR-1234": "left_foot_tracker"}``. Controllers whose
            serial says left or right, in any case, need none.

    Attributes:
        port: where it listens.
        refused: number of dropped messages: invalid poses, too many, or devices without a role.

    Raises:
        InputError: the port is in use, or an unknown device is named.
    """

    def __init__(
        self,
        take: Callable[[DeviceFrame], None],
        host: str = LOOPBACK,
        port: int = VMC_IN_PORT,
        roles: Mapping[str, str] | None = None,
    ) -> None:
        self._take, self._roles = take, dict(roles or {})
        DeviceFrame.of(0.0, dict.fromkeys(self._roles.values()))
        self._poses: dict[str, tuple[float, list[float]]] = {}
        self._local_s = -1.0
        self._budget, self._counted_s = float(MAX_PER_SECOND), time.monotonic()
        self.refused = 0
        dispatcher = _Exactly()
        for kind in _KINDS:
            for ending in ("", "/Local"):
                dispatcher.map(f"/VMC/Ext/{kind}/Pos{ending}", self._receive)
        try:
            # One thread for all messages: they are taken in the order in which they come.
            self._server = BlockingOSCUDPServer((host, port), dispatcher)
        except OSError as error:
            raise InputError(f"cannot listen at {host}:{port} ({error.strerror})", "OSC") from None
        self._server.handle_error = self._count_broken  # type: ignore[method-assign]
        self.port = int(self._server.server_address[1])
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)

    def __enter__(self) -> VmcReceiver:
        self._thread.start()
        return self

    def __exit__(self, *_: Any) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()

    def _count_broken(self, *_: Any) -> None:
        self.refused += 1

    def _receive(self, address: str, *values: Any) -> None:
        now, kind = time.monotonic(), address.split("/")[3]
        local = address.endswith("/Local")
        device = self._device(kind, values)
        if not self._affordable(now) or device is None:
            self.refused += 1
            return
        # Poses at the avatar's scale are left out where the devices' own come as well.
        if local:
            self._local_s = now
        elif now - self._local_s < SILENT_S and self._local_s >= 0.0:
            return
        numbers = list(values[1:])
        try:
            DeviceFrame.of(now, {device: numbers}, "unity")
        except InputError:
            self.refused += 1
            return
        self._poses[device] = (now, numbers)
        if device == "headset":
            fresh = {n: pose for n, (at, pose) in self._poses.items() if now - at <= SILENT_S}
            self._take(DeviceFrame.of(now, fresh, "unity"))

    def _affordable(self, now: float) -> bool:
        self._budget += (now - self._counted_s) * MAX_PER_SECOND
        self._budget, self._counted_s = min(self._budget, float(MAX_PER_SECOND)), now
        self._budget -= 1.0
        return self._budget >= 0.0

    def _device(self, kind: str, values: tuple[Any, ...]) -> str | None:
        """The device of a message; None for an unknown device or an invalid pose."""
        if len(values) != 8 or not isinstance(values[0], str):
            return None
        serial = values[0]
        if serial in self._roles:
            return self._roles[serial]
        if kind == "Hmd":
            return "headset"
        if kind == "Con":
            for side in ("left", "right"):
                if side in serial.lower():
                    return f"{side}_controller"
        return None
