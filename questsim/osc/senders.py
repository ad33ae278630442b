"""Send the avatar's motion over OSC, as a VMC performer or as VRChat's trackers.

Sources: VMC protocol specification 3.1; VRChat's documentation, "OSC Trackers".
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message_builder import OscMessageBuilder
from pythonosc.udp_client import UDPClient

from questsim import rotations as rot
from questsim.avatar_pose import AvatarPose
from questsim.body import DEFAULT_HEIGHT_M
from questsim.devices import from_ours
from questsim.errors import InputError
from questsim.osc.humanoid import t_pose_quats, unity_bones
from questsim.skeleton import LINKS

LOOPBACK = "127.0.0.1"
VMC_PORT, VRCHAT_PORT = 39539, 9000
TRACKERS: dict[int, str] = {
    1: "pelvis", 2: "left_foot", 3: "right_foot", 4: "left_shin", 5: "right_shin",
    6: "left_forearm", 7: "right_forearm",
}  # fmt: skip
"""Hip, feet, knees (where the shins begin) and elbows (where the forearms begin)."""
_HEAD_UP_M = 0.185
"""From the neck to the middle of the head, of the 1.75 m body."""


class Destination(NamedTuple):
    """Destination of OSC messages.

    Attributes:
        host: a numeric address or a name.
        port: 1 to 65535.
    """

    host: str
    port: int

    @staticmethod
    def of(text: str, port: int, option: str) -> Destination:
        """From ``HOST``, ``HOST:PORT`` or ``:PORT``; an empty host is this machine.

        Raises:
            InputError: no such host, or no port.
        """
        host, colon, number = text.rpartition(":") if ":" in text else (text, "", "")
        if colon:
            if not number.isdigit() or not 1 <= int(number) <= 65535:
                raise InputError(f"{number!r} is not a port", option, f"as in {LOOPBACK}:{port}")
            port = int(number)
        host = host or LOOPBACK
        try:
            address = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)[0][4][0]
        except (OSError, UnicodeError):
            raise InputError(f"{host!r} is not a known host", option) from None
        if ipaddress.ip_address(address).is_multicast or address == "255.255.255.255":
            raise InputError(
                f"{host} is not the address of one machine", option, "name one address"
            )
        return Destination(str(address), port)


class _Sender:
    """Sends bundles of messages to one address; network errors are counted, not raised."""

    def __init__(self, target: Destination) -> None:
        self.target = target
        self.refused = 0
        self._client = UDPClient(target.host, target.port)

    def _send(self, messages: Sequence[tuple[str, Sequence[int | float | str]]]) -> None:
        bundle = OscBundleBuilder(IMMEDIATELY)
        for address, values in messages:
            message = OscMessageBuilder(address)
            for value in values:
                message.add_arg(value)
            bundle.add_content(message.build())
        try:
            self._client.send(bundle.build())
        except OSError:  # no program listens there, or the network is down
            self.refused += 1


class VmcPerformer(_Sender):
    """Sends ``/VMC/Ext/OK``, ``/T``, ``/Root/Pos`` and sixteen ``/Bone/Pos`` with every pose."""

    def send(self, pose: AvatarPose) -> None:
        """One pose; the root stays at the origin, the hips move in it."""
        messages: list[tuple[str, Sequence[int | float | str]]] = [
            ("/VMC/Ext/OK", [1]),
            ("/VMC/Ext/T", [float(pose.time_s)]),
            ("/VMC/Ext/Root/Pos", ["root", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        ]
        for bone in unity_bones(pose):
            numbers = np.concatenate([bone.position, bone.quat]).tolist()
            messages.append(("/VMC/Ext/Bone/Pos", [bone.name, *numbers]))
        self._send(messages)


class VrchatTrackers(_Sender):
    """Sends seven trackers and the head, by which VRChat aligns them with the user."""

    def send(self, pose: AvatarPose) -> None:
        """One pose: ``/tracking/trackers/N/position`` and ``/rotation``, which is in degrees."""
        world = t_pose_quats(pose.link_quat)
        messages: list[tuple[str, Sequence[int | float | str]]] = []
        for number, link in TRACKERS.items():
            row = LINKS.index(link)
            messages += _tracker(str(number), pose.link_position[row], world[row])
        head = LINKS.index("head")
        up = np.array([0.0, 0.0, _HEAD_UP_M * pose.height_m / DEFAULT_HEIGHT_M])
        middle = pose.link_position[head] + rot.quat_rotate(world[head], up)
        messages += _tracker("head", middle, world[head])
        self._send(messages)


def _tracker(
    name: str, position: np.ndarray, quat: np.ndarray
) -> list[tuple[str, Sequence[int | float | str]]]:
    place, turn = from_ours(position, quat, "unity")
    return [
        (f"/tracking/trackers/{name}/position", place.tolist()),
        (f"/tracking/trackers/{name}/rotation", unity_euler(turn).tolist()),
    ]


def unity_euler(quat: np.ndarray) -> np.ndarray:
    """Unity's Euler angles x, y, z in degrees ``(3,)`` of a quaternion xyzw.

    They turn about z first, then x, then y, about fixed axes, as Unity's ``eulerAngles``. The
    handedness needs no care: angles and quaternion turn the same way about each axis.
    """
    z, x, y = rot.as_rotation(quat[[3, 0, 1, 2]]).as_euler("zxy", degrees=True)[0]
    return np.array([x, y, z])
