"""A live session: calibrate the user, then follow them, in a separate thread."""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from agents.follower.calibration import Calibration
from agents.follower.follower import Follower
from agents.headset.messages import rounded
from questsim.avatar_pose import AvatarPose
from questsim.devices import DeviceFrame, from_ours
from questsim.errors import InputError
from questsim.sensors import device_poses

CALIBRATION_S = 3.0
WAITING_FRAMES = 32
"""Largest number of frames waiting for the simulation; beyond it the oldest are dropped."""
WAITING, CALIBRATING, FOLLOWING = "waiting", "calibrating", "following"
STAND = "stand upright, look straight ahead, let your arms hang"
TURN = "let your arms hang and turn both palms to the front and to the back"
_KEPT_S = 1.0


class LiveSession:
    """Takes frames from one driver and publishes a state after each frame.

    Args:
        follower: moves the avatar.
        publish: called in the session's thread with a JSON-compatible state.
        height_m: the user's stature, if known.
        pose: the user's pose during the calibration.
        palms: whether the user then turns the palms, which locates the controllers better.
        calibration: of the user; None to calibrate for three seconds.
        heed_frame, heed_pose: called with every received frame, e.g. to record it, and with every
            pose, e.g. to forward it.

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
        heed_frame: Callable[[DeviceFrame], None] | None = None,
        heed_pose: Callable[[AvatarPose], None] | None = None,
    ) -> None:
        self._follower, self._publish = follower, publish
        self._height_m, self._pose, self._given = height_m, pose, calibration
        self._heed_frame, self._heed_pose = heed_frame, heed_pose
        self._palms = palms
        self._jobs: queue.Queue[Callable[[], None] | None] = queue.Queue(WAITING_FRAMES)
        self._assist_n = follower.assist_n
        self._seen: deque[DeviceFrame] = deque()
        self._still: list[DeviceFrame] = []
        self._said = ""
        self.state, self.taken, self.dropped = WAITING, 0, 0
        self.failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="live", daemon=True)

    def __enter__(self) -> LiveSession:
        self._thread.start()
        return self

    def __exit__(self, *_: Any) -> None:
        self._put(None)
        self._thread.join()

    @property
    def height_m(self) -> float | None:
        """Stature of the avatar; None before it is known."""
        known = self._follower.calibration
        return None if known is None else round(known.height_m, 4)

    def push(self, frame: DeviceFrame) -> None:
        """Queue one frame of the driver; returns immediately."""
        came = time.monotonic()
        if self._heed_frame is not None:
            self._heed_frame(frame)
        self._put(lambda: self._take(frame, came))

    def begin(self) -> None:
        """A driver has connected or requests a new calibration."""
        self._put(self._begin)

    def end(self) -> None:
        """The driver has disconnected."""
        self._put(self._end)

    def assist(self, on: bool) -> None:
        """Switch the assisting force on, up to the follower's limit, or off."""
        self._put(lambda: setattr(self._follower, "assist_n", self._assist_n if on else 0.0))

    def _put(self, job: Callable[[], None] | None) -> None:
        while True:
            try:
                self._jobs.put_nowait(job)
                return
            except queue.Full:
                try:
                    self._jobs.get_nowait()
                    self.dropped += 1
                except queue.Empty:
                    pass

    def _run(self) -> None:
        try:
            while (job := self._jobs.get()) is not None:
                job()
        except BaseException as error:  # the server reports it and stops
            self.failure = error
            self._publish({"type": "failure"})

    def _begin(self) -> None:
        self._still.clear()
        self._seen.clear()
        if self._given is not None:
            self._follower.use(self._given)
            self._follow("")
            return
        self.state = CALIBRATING
        self._tell(STAND)

    def _end(self) -> None:
        self.state = WAITING
        self._tell("no headset is connected")

    def _take(self, frame: DeviceFrame, came_s: float) -> None:
        if self.state == CALIBRATING:
            self._measure(frame)
        elif self.state == FOLLOWING:
            pose = self._follower.step(frame)
            if self._heed_pose is not None:
                self._heed_pose(pose)
            self._publish(self._described(frame, pose, came_s))
        self.taken += 1

    def _measure(self, frame: DeviceFrame) -> None:
        if self._still and frame.time_s <= self._still[-1].time_s:
            self._still.clear()
        self._still.append(frame)
        passed = frame.time_s - self._still[0].time_s
        whole = 2.0 * CALIBRATION_S if self._palms else CALIBRATION_S
        if passed < whole:
            still = passed < CALIBRATION_S
            left = int(np.ceil((CALIBRATION_S if still else whole) - passed))
            self._tell(f"{STAND if still else TURN}: {left} s")
            return
        frames, self._still = self._still, []
        end = frames[0].time_s + CALIBRATION_S
        still_frames = [f for f in frames if f.time_s <= end] if self._palms else frames
        palms = [f for f in frames if f.time_s > end] if self._palms else []
        try:
            known = self._follower.calibrate(
                still_frames, height_m=self._height_m, pose=self._pose, palms=palms
            )
        except InputError as error:
            self._tell(f"{error.what}; again" + (f": {error.fix}" if error.fix else ""))
            return
        self._follow(f"stature {known.height_m:.2f} m")

    def _follow(self, text: str) -> None:
        self.state = FOLLOWING
        self._tell(text)

    def _tell(self, text: str) -> None:
        if text == self._said and text:
            return
        self._said = text
        self._publish(self.status())

    def status(self) -> dict[str, Any]:
        """State, stature and instruction for a page that connects."""
        return {
            "type": "state",
            "state": self.state,
            "height_m": self.height_m,
            "latency_s": round(self._follower.latency_s, 4),
            "assist_n": self._assist_n,
            "text": self._said,
        }

    def _described(self, frame: DeviceFrame, pose: AvatarPose, came_s: float) -> dict[str, Any]:
        """A pose for pages: links in WebXR's axes, and the displayed figures."""
        position, quat = from_ours(pose.link_position, pose.link_quat, "openxr")
        force, _ = from_ours(pose.contact_force, np.tile([1.0, 0, 0, 0], (2, 1)), "openxr")
        things, turns = from_ours(pose.object_position, pose.object_quat, "openxr")
        assist, _ = from_ours(pose.assist_force, np.array([1.0, 0, 0, 0]), "openxr")
        return {
            "type": "pose",
            "t": round(pose.time_s, 4),
            "seen": round(frame.time_s, 4),
            "p": rounded(position),
            "q": rounded(quat),
            "force": rounded(force, 1),
            "assist": rounded(assist, 1),
            "objects": rounded(np.concatenate([things, turns], axis=-1)),
            "error_cm": self._error_cm(frame, pose),
            "step_ms": round(1000.0 * (time.monotonic() - came_s), 1),
            "dropped": self.dropped,
            "events": list(pose.events),
        }

    def _error_cm(self, frame: DeviceFrame, pose: AvatarPose) -> float | None:
        """Mean distance between the avatar's devices and the user's at the time of the pose."""
        known = self._follower.calibration
        assert known is not None
        if self._seen and frame.time_s <= self._seen[-1].time_s:
            self._seen.clear()
        self._seen.append(frame)
        while self._seen[0].time_s < frame.time_s - _KEPT_S:
            self._seen.popleft()
        then = min(self._seen, key=lambda f: abs(f.time_s - pose.time_s))
        names = [name for name in self._follower.names if name in then.poses]
        if not names:
            return None
        there = known.apply(then)
        user = np.array([there.poses[name].position for name in names])
        height = pose.height_m
        own, _ = device_poses(pose.link_position, pose.link_quat, names, height)
        own = own - np.array([0.0, 0.0, known.floor_m])
        return round(100.0 * float(np.linalg.norm(own - user, axis=-1).mean()), 2)
