"""``questsim live``: the avatar of a person with a headset."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import torch

from agents.follower.calibration import POSES, Calibration
from agents.follower.follower import Follower
from agents.follower.scene import Scene
from agents.headset.options import LiveArgs, RecordArgs
from agents.headset.session import LiveSession
from envs.assist import checked_bound
from envs.objects import objects_named
from envs.terrain import terrain_named
from questsim.avatar_pose import AvatarPose
from questsim.body import MAX_HEIGHT_M, MIN_HEIGHT_M
from questsim.devices import DeviceFrame
from questsim.errors import InputError, at_least
from questsim.exporting.formats import needs
from questsim.recordings import DeviceRecording, RecordingWriter, read_recording
from questsim.sensors import DEVICES
from questsim.viewing.page_server import LOOPBACK, check_address, is_loopback

ASSIST_N = 300.0
"""Default bound of the assist of agents with physics."""
MAX_PORT = 65535


def record(args: RecordArgs) -> None:
    """Serve the page and record until Ctrl-C.

    Raises:
        InputError: see ``live``.
    """
    if args.record is not None:
        raise InputError(
            "does not go with questsim record", "--record", "give the file without an option"
        )
    live(args, args.out)


def live(args: LiveArgs, out: Path | None = None) -> None:
    """Serve the page until Ctrl-C.

    Raises:
        InputError: the page is not built, or an agent, file, address or option cannot be used.
    """
    for package in ("aiohttp", "pygltflib", "pythonosc", "trustme"):
        needs(package, "questsim live")
    from agents.headset.server import check_page

    check_page()
    _check(args)
    torch.set_num_threads(1)
    recording = None if args.replay is None else read_recording(args.replay)
    calibration = None if args.calibration is None else Calibration.load(args.calibration)
    if calibration is None and recording is not None and recording.calibration is not None:
        _refuse_calibrating(args)
        calibration = Calibration.of(recording.calibration, str(args.replay))
    terrain = None if args.terrain is None else terrain_named(args.terrain, "--terrain")
    objects = objects_named(args.objects, "--objects", options=("mass_kg",))
    follower = Follower(
        args.agent, args.sensors, assist_n=args.assist or 0.0, terrain=terrain, objects=objects
    )
    if args.assist is None and follower.physics:
        follower.assist_n = ASSIST_N
    with ExitStack() as stack:
        on_frame, count = _recorder(stack, out or args.record)
        make = _session_maker(args, follower, calibration, on_frame)
        asyncio.run(_serve(args, make, recording, follower.scene))
        if count is not None:
            print(f"{count()} frames in {out or args.record}", file=sys.stderr)


def _check(args: LiveArgs) -> None:
    """Refuse options that cannot be used, before an agent is loaded or anything is served."""
    from agents.headset.tls import server_context

    at_least(0, assist=args.assist)
    checked_bound(args.assist or 0.0)
    if args.height is not None and not MIN_HEIGHT_M <= args.height <= MAX_HEIGHT_M:
        limits = f"{MIN_HEIGHT_M} to {MAX_HEIGHT_M} m"
        raise InputError(f"is {args.height:g} m, not within {limits}", "--height")
    if args.vmc_in is not None and not 0 <= args.vmc_in <= MAX_PORT:
        raise InputError(f"{args.vmc_in} is not 0 to {MAX_PORT}", "--vmc-in")
    if args.cert is not None or args.key is not None:
        server_context(args.cert, args.key, [])
    if args.pose not in POSES:
        raise InputError(f"is {args.pose!r}, not one of {', '.join(POSES)}", "--pose")
    if args.calibration is not None:
        _refuse_calibrating(args)
    if args.replay is not None and args.vmc_in is not None:
        raise InputError("does not go with --replay", "--vmc-in", "give one of them")
    if args.vmc_roles and args.vmc_in is None:
        raise InputError("does nothing without --vmc-in", "--vmc-roles", "leave it out")
    roles_of(args.vmc_roles)
    check_address(args.host, args.port)


def roles_of(words: Sequence[str]) -> dict[str, str]:
    """Devices by the serials of another program, from ``SERIAL=DEVICE``.

    Raises:
        InputError: not of this form, or no such device.
    """
    roles = {}
    for word in words:
        serial, _, device = word.rpartition("=")
        if not serial or device not in DEVICES or DEVICES[device].kind == "imu":
            known = ", ".join(name for name, each in DEVICES.items() if each.kind != "imu")
            raise InputError(f"{word!r} is not SERIAL=DEVICE", "--vmc-roles", f"devices: {known}")
        roles[serial] = device
    return roles


def _refuse_calibrating(args: LiveArgs) -> None:
    """Refuse the options of a calibration, since the user's is known."""
    plain = LiveArgs()
    for option in ("height", "pose", "palms"):
        if getattr(args, option) != getattr(plain, option):
            raise InputError(
                "does nothing: the user's calibration is given", f"--{option}", "leave it out"
            )


def _recorder(
    stack: ExitStack, path: Path | None
) -> tuple[Callable[[DeviceFrame], None] | None, Callable[[], int] | None]:
    """The frame writer, and the number of frames it has written."""
    if path is None:
        return None, None
    writer = stack.enter_context(RecordingWriter(path, "openxr"))
    last = -1.0

    def write(frame: DeviceFrame) -> None:
        nonlocal last
        if frame.time_s > last:  # only files guarantee increasing times
            last = frame.time_s
            writer.write(frame)

    return write, lambda: writer.count


def _session_maker(
    args: LiveArgs,
    follower: Follower,
    calibration: Calibration | None,
    on_frame: Callable[[DeviceFrame], None] | None,
) -> Callable[..., LiveSession]:
    from questsim.osc.senders import (
        VMC_PORT,
        VRCHAT_PORT,
        Destination,
        VmcPerformer,
        VrchatTrackers,
    )

    senders: list[VmcPerformer | VrchatTrackers] = []
    if args.vmc is not None:
        senders.append(VmcPerformer(Destination.of(args.vmc, VMC_PORT, "--vmc")))
    if args.vrchat is not None:
        senders.append(VrchatTrackers(Destination.of(args.vrchat, VRCHAT_PORT, "--vrchat")))

    def on_pose(pose: AvatarPose) -> None:
        for sender in senders:
            sender.send(pose)

    return lambda publish: LiveSession(
        follower,
        publish,
        height_m=args.height,
        pose=args.pose,
        palms=args.palms,
        calibration=calibration,
        on_frame=on_frame,
        on_pose=on_pose if senders else None,
    )


async def _serve(
    args: LiveArgs,
    make: Callable[..., LiveSession],
    recording: DeviceRecording | None,
    scene: Scene,
) -> None:
    from agents.headset.server import LiveServer
    from agents.headset.tls import LOOPBACK_NAMES, own_addresses, server_context

    local = is_loopback(args.host)
    names = own_addresses() if args.host in ("0.0.0.0", "::") else [args.host]
    secure = not local or args.cert is not None or args.key is not None
    context = None
    if secure:
        context = server_context(args.cert, args.key, list({*LOOPBACK_NAMES, *names}))
    token = "" if local else secrets.token_urlsafe(16)
    pages = recording is None and args.vmc_in is None
    server = LiveServer(args.host, token, context, page_drives=pages, scene=scene)
    with make(server.publish) as session:
        server.session = session
        await server.start(args.port)
        query = f"/?token={token}" if token else "/"
        for name in names or [args.host]:
            shown = f"[{name}]" if ":" in name else name
            scheme = "https" if secure else "http"
            print(f"open {scheme}://{shown}:{server.port}{query} ; Ctrl-C ends", flush=True)
        ended = asyncio.create_task(server.failed.wait())
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, ended.cancel)
        feeding = None
        with _osc_driver(args.vmc_in, roles_of(args.vmc_roles), session):
            if recording is not None:
                feeding = asyncio.create_task(feed(session, recording))
            with contextlib.suppress(asyncio.CancelledError):
                await ended
        if feeding is not None:
            feeding.cancel()
        await server.stop()
    if session.failure is not None:
        raise session.failure


@contextlib.contextmanager
def _osc_driver(
    port: int | None, roles: dict[str, str], session: LiveSession
) -> Iterator[int | None]:
    """Frames of a VMC program, if one drives the avatar; gives the port that listens."""
    if port is None:
        yield None
        return
    from questsim.osc.receiver import VmcReceiver

    with VmcReceiver(session.push, port=port, roles=roles) as receiver:
        print(f"listening for VMC at {LOOPBACK}:{receiver.port}", flush=True)
        session.begin()
        yield receiver.port


async def feed(session: LiveSession, recording: DeviceRecording) -> None:
    """Send a recording's frames at their times, in an endless loop."""
    while True:
        session.begin()
        began, first = time.monotonic(), recording.frames[0].time_s
        for frame in recording.frames:
            wait = began + frame.time_s - first - time.monotonic()
            if wait > 0.0:
                await asyncio.sleep(wait)
            session.push(frame)
