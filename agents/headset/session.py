"""A live session: calibrate the user, then follow them, in a separate thread."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from agents.follower.calibration import Calibration
from agents.follower.follower import Follower
from agents.headset.messages import rounded
from questsim.avatar_pose import AvatarPose
from questsim.devices import DeviceFrame, from_ours
from questsim.errors import InputError
from questsim.sensors import device_poses

CALIBRATION_S = 3.0
MOST_WAITING = 32
"""Most frames that wait for the simulation, and most requests; beyond it the oldest is dropped.
Frames never displace requests: a lost request would leave the session in a wrong state."""
WAITING, CALIBRATING, FOLLOWING = "waiting", "calibrating", "following"
STAND = "stand upright, look straight ahead, let your arms hang"
TURN = "let your arms hang and turn both palms to the front and to the back"
RECENT_S = 1.0
"""Frames of the last second are kept, to find the one of a pose's time."""


class _Call(NamedTuple):
    """A call for the session's thread; None ends it."""

    call: Callable[[], None] | None
    is_frame: bool = False


class LiveSession:
    """Takes frames from one driver and publishes a state after each frame.

    Args:
        follower: moves the avatar.
        publish: called in the session's thread with a JSON-compatible state.
        height_m: the user's stature, if known.
        pose: the user's pose during the calibration.
        palms: whether the user then turns the palms, which locates the controllers better.
        calibration: of the user; None to calibrate for three seconds.
        on_frame, on_pose: called with each received frame, e.g. to record it, and with each pose,
            e.g. to forward it.

    Attributes:
        taken: number of frames that the simulation has taken.
        dropped: number of frames dropped because they waited too long.
        failure: the exception that ended the thread, if any.
    """

    def __init__(
        self,
        follower: Follower,
        publish: Callable[[dict[str, Any]], None],
        *,
        height_m: float | None = None,
        pose: str = "hanging",
        palms: bool = False,
        calibration: Calibration | None = None,
        on_frame: Callable[[DeviceFrame], None] | None = None,
        on_pose: Callable[[AvatarPose], None] | None = None,
    ) -> None:
        self._follower, self._publish = follower, publish
        self._height_m, self._pose, self._calibration = height_m, pose, calibration
        self._on_frame, self._on_pose = on_frame, on_pose
        self._palms = palms
        self._calls: deque[_Call] = deque()
        self._news = threading.Condition()
        self._assist_n = follower.assist_n
        self._recent: deque[DeviceFrame] = deque()
        self._calibrating: list[DeviceFrame] = []
        self._text, self._interrupted = "", WAITING
        self.state, self.taken, self.dropped = WAITING, 0, 0
        self.failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="live", daemon=True)

    def __enter__(self) -> LiveSession:
        self._thread.start()
        return self

    def __exit__(self, *_: Any) -> None:
        self._put(_Call(None))
        self._thread.join()

    @property
    def height_m(self) -> float | None:
        """Stature of the avatar; None before it is known."""
        known = self._follower.calibration
        return None if known is None else round(known.height_m, 4)

    def push(self, frame: DeviceFrame) -> None:
        """Queue one frame of the driver; returns immediately."""
        received_s = time.monotonic()
        if self._on_frame is not None:
            self._on_frame(frame)
        self._put(_Call(lambda: self._process(frame, received_s), is_frame=True))

    def begin(self) -> None:
        """A driver has connected or requests a new calibration."""
        self._put(_Call(self._begin))

    def resume(self) -> None:
        """The same driver is back after a lost connection: go on, if a calibration is known."""
        self._put(_Call(self._resume))

    def end(self) -> None:
        """The driver has disconnected."""
        self._put(_Call(self._end))

    def assist(self, on: bool) -> None:
        """Switch the assisting force on, up to the follower's limit, or off."""
        self._put(_Call(lambda: self._switch_assist(on)))

    def _put(self, call: _Call) -> None:
        """Queue a call. If too many frames wait, the oldest is dropped; so of requests."""
        with self._news:
            alike = [i for i, other in enumerate(self._calls) if other.is_frame == call.is_frame]
            if len(alike) >= MOST_WAITING:
                del self._calls[alike[0]]
                self.dropped += call.is_frame
            self._calls.append(call)
            self._news.notify()

    def _next_call(self) -> Callable[[], None] | None:
        with self._news:
            self._news.wait_for(lambda: self._calls)
            return self._calls.popleft().call

    def _run(self) -> None:
        try:
            while (call := self._next_call()) is not None:
                call()
        except BaseException as error:  # the server reports it and stops
            self.failure = error
            self._publish({"type": "failure"})

    def _switch_assist(self, on: bool) -> None:
        self._follower.assist_n = self._assist_n if on else 0.0
        self._publish(self.status())

    def _begin(self) -> None:
        self._calibrating.clear()
        self._recent.clear()
        if self._calibration is not None:
            self._follower.use(self._calibration)
            self._follow("")
            return
        self.state = CALIBRATING
        self._announce(STAND)

    def _resume(self) -> None:
        if FOLLOWING in (self.state, self._interrupted):
            self._follow("")
        else:
            self._begin()

    def _end(self) -> None:
        self._interrupted, self.state = self.state, WAITING
        self._announce("no headset is connected")

    def _process(self, frame: DeviceFrame, received_s: float) -> None:
        if self.state == CALIBRATING:
            self._measure(frame)
        if self.state == FOLLOWING:  # also the frame after the calibration, as in a replay
            pose = self._follower.step(frame)
            if self._on_pose is not None:
                self._on_pose(pose)
            self._publish(self._described(frame, pose, received_s))
        self.taken += 1

    def _measure(self, frame: DeviceFrame) -> None:
        if self._calibrating and frame.time_s <= self._calibrating[-1].time_s:
            self._calibrating.clear()
        first = self._calibrating[0] if self._calibrating else frame
        passed = frame.time_s - first.time_s
        whole = 2.0 * CALIBRATION_S if self._palms else CALIBRATION_S
        if passed < whole:
            self._calibrating.append(frame)
            still = passed < CALIBRATION_S
            left = int(np.ceil((CALIBRATION_S if still else whole) - passed))
            self._announce(f"{STAND if still else TURN}: {left} s")
            return
        frames, self._calibrating = self._calibrating, []
        end = frames[0].time_s + CALIBRATION_S
        still_frames = [f for f in frames if f.time_s < end]
        palms = [f for f in frames if f.time_s >= end]
        try:
            known = self._follower.calibrate(
                still_frames, height_m=self._height_m, pose=self._pose, palms=palms
            )
        except InputError as error:
            self._announce(f"{error.what}; again" + (f": {error.fix}" if error.fix else ""))
            return
        self._follow(f"your height: {known.height_m:.2f} m")

    def _follow(self, text: str) -> None:
        self.state = FOLLOWING
        self._announce(text)

    def _announce(self, text: str) -> None:
        if text == self._text and text:
            return
        self._text = text
        self._publish(self.status())

    def status(self) -> dict[str, Any]:
        """State, stature, assist and instruction for a page."""
        return {
            "type": "state",
            "state": self.state,
            "height_m": self.height_m,
            "latency_s": round(self._follower.latency_s, 4),
            "assist_n": self._assist_n,
            "assist_on": self._follower.assist_n > 0.0,
            "text": self._text,
        }

    def _described(self, frame: DeviceFrame, pose: AvatarPose, received_s: float) -> dict[str, Any]:
        """A pose for pages: links in WebXR's axes, and the displayed figures."""
        position, quat = from_ours(pose.link_position, pose.link_quat, "openxr")
        force, _ = from_ours(pose.contact_force, np.tile([1.0, 0, 0, 0], (2, 1)), "openxr")
        objects = from_ours(pose.object_position, pose.object_quat, "openxr")
        assist, _ = from_ours(pose.assist_force, np.array([1.0, 0, 0, 0]), "openxr")
        return {
            "type": "pose",
            "t": round(pose.time_s, 4),
            "seen": round(frame.time_s, 4),
            "p": rounded(position),
            "q": rounded(quat),
            "force": rounded(force, 1),
            "assist": rounded(assist, 1),
            "objects": rounded(np.concatenate(objects, axis=-1)),
            "error_cm": self._error_cm(frame, pose),
            "silent": [name for name in self._follower.names if name not in frame.poses],
            "step_ms": round(1000.0 * (time.monotonic() - received_s), 1),
            "dropped": self.dropped,
            "events": list(pose.events),
        }

    def _error_cm(self, frame: DeviceFrame, pose: AvatarPose) -> float | None:
        """Mean distance between the avatar's devices and the user's at the time of the pose."""
        known = self._follower.calibration
        assert known is not None
        if self._recent and frame.time_s <= self._recent[-1].time_s:
            self._recent.clear()
        self._recent.append(frame)
        while self._recent[0].time_s < frame.time_s - RECENT_S:
            self._recent.popleft()
        then = min(self._recent, key=lambda f: abs(f.time_s - pose.time_s))
        names = [name for name in self._follower.names if name in then.poses]
        if not names:
            return None
        there = known.apply(then)
        user = np.array([there.poses[name].position for name in names])
        height = pose.height_m
        own, _ = device_poses(pose.link_position, pose.link_quat, names, height)
        own = own - np.array([0.0, 0.0, known.floor_m])
        return round(100.0 * float(np.linalg.norm(own - user, axis=-1).mean()), 2)
