"""Options of ``questsim live`` and ``questsim record``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from typing_extensions import Doc

from agents.resolve import LIVE_POLICY, AgentName
from envs.objects import OBJECTS
from questsim.viewing.page_access import LOOPBACK

DEFAULT_PORT = 8085


@dataclass(frozen=True)
class LiveArgs:
    """Control the avatar live from a headset, through a page in the headset's browser."""

    agent: AgentName = LIVE_POLICY
    sensors: str | None = None
    """Set of devices, e.g. H+2C or H; by default the agent's own."""
    height: float | None = None
    """Stature of the user in metres; by default measured, or from --calibration or --replay."""
    pose: str = "hanging"
    """The user's pose during the calibration: hanging or a-pose."""
    palms: bool = False
    """Calibrate for three more seconds, in which the user turns the palms: locates the controllers
    in the hands more precisely."""
    calibration: Path | None = None
    """File written by Calibration.save, used instead of measuring."""
    assist: float | None = None
    """Largest force in N that assists the avatar's balance, by default 300 for agents with physics;
    0 for physics without assistance."""
    terrain: str | None = None
    """Ground under the avatar, e.g. rough or slope:slope_deg=6; the user's own floor is level."""
    objects: Annotated[
        tuple[str, ...], Doc(f"Objects a metre before the avatar: {', '.join(OBJECTS)}.")
    ] = ()
    replay: Path | None = None
    """Drive the avatar from this recording; pages only watch."""
    record: Path | None = None
    """Record the devices' frames to this file, .jsonl.gz."""
    vmc: str | None = None
    """Send the avatar to a VMC marionette at HOST:PORT, e.g. 127.0.0.1:39539."""
    vrchat: str | None = None
    """Send trackers to VRChat at HOST:PORT, e.g. 127.0.0.1:9000."""
    vmc_in: int | None = None
    """Drive the avatar from a VMC program over OSC at this local port, e.g. 39540; pages watch."""
    vmc_roles: tuple[str, ...] = ()
    """Devices of --vmc-in by serial, each SERIAL=DEVICE, e.g. LHR-1234=pelvis_tracker; the headset
    and controllers named left and right need none."""
    host: str = LOOPBACK
    """Address to listen on; any other than the default uses TLS and a token."""
    port: int = DEFAULT_PORT
    """Port of the page; 0 picks a free one."""
    cert: Path | None = None
    """TLS certificate (PEM); by default a temporary one is made where TLS is needed."""
    key: Path | None = None
    """Private key of the certificate (PEM)."""


@dataclass(frozen=True)
class RecordArgs(LiveArgs):
    """Like live, and record the devices' frames to a file."""

    out: tyro.conf.Positional[Path] = Path("recording.jsonl.gz")
    """The recording, .jsonl.gz."""
