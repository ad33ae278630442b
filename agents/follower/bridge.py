"""Convert arriving frames to moments at a fixed rate, without gaps, jumps or missing devices.

- Moments are interpolated by timestamp, so frame rate, jitter and lost frames do not matter. A
  frame older than the last one is dropped.
- Gaps of up to ``BRIDGE_S`` are interpolated.
- A controller that does not report moves rigidly with the head and sinks to the side of the body
  after ``HOLD_S``. When it reports again, it is blended in.
- While the headset does not report, everything stands still.
- After more than ``BRIDGE_S`` without frames or headset, a user still within ``NEAR_M`` and
  ``NEAR_RAD`` of the last pose is blended in; otherwise the avatar is set up again.
- A headset that jumps faster than a person can move was recentred or teleported. The user's space
  is moved with it, so that the avatar continues (or is set up again if it is on a terrain).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from questsim import rotations as rot
from questsim.devices import DeviceFrame
from questsim.motion.kinematics import standing_devices

BRIDGE_S = 0.5
NEAR_M, NEAR_RAD = 0.5, np.radians(60.0)
HOLD_S, SINK_S, EASE_S = 0.5, 0.8, 0.5
JUMP_M, JUMP_M_S = 0.3, 5.0
"""A headset jumps if it moves by more than the first and this speed together ..."""
JUMP_RAD, JUMP_RAD_S = np.radians(40.0), np.radians(1000.0)
"""... or turns so."""
CLOCK_BACK_S = 1.0
"""If timestamps go back by more than this, the clock restarted; by less, the frame was late."""
MAX_SPEED_M_S = 3.0
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


class DeviceMoment(NamedTuple):
    """The devices in one moment.

    Attributes:
        time_s: on the clock of the frames.
        position, quat: ``(D, 3)``, ``(D, 4)``.
        present: ``(D,)`` bool, devices that report; the poses of others are estimated.
        fresh: whether a new stream starts here: the avatar is set up again.
    """

    time_s: float
    position: np.ndarray
    quat: np.ndarray
    present: np.ndarray
    fresh: bool


class Alignment(NamedTuple):
    """A rotation about the vertical and a shift, from the user's space to the avatar's.

    Attributes:
        yaw: radians.
        shift: ``(3,)`` metres, after the rotation.
    """

    yaw: float
    shift: np.ndarray

    def apply(self, position: np.ndarray, quat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Poses ``(..., 3)``, ``(..., 4)`` in the avatar's space."""
        turn = rot.yaw_quat(np.array(self.yaw))
        return rot.quat_rotate(turn, position) + self.shift, rot.quat_multiply(turn, quat)

    def undo(self, position: np.ndarray, quat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The inverse of ``apply``."""
        turn = rot.yaw_quat(np.array(-self.yaw))
        return rot.quat_rotate(turn, position - self.shift), rot.quat_multiply(turn, quat)


class Bridge:
    """Turns frames of one user into moments.

    Args:
        names: ``D`` devices, the headset first.
        rate_hz: moments per second.
        height_m: the user's stature, which gives the place of hanging hands.
        carry: whether the user's space is moved when the headset jumps; otherwise the avatar is
            set up again.

    Attributes:
        alignment: from the user's space to the avatar's.
        events: messages about events; the caller clears the list.
        late: number of frames dropped because they were older than the last one.
    """

    def __init__(
        self, names: Sequence[str], rate_hz: float, height_m: float, carry: bool = True
    ) -> None:
        self._names, self._rate, self._carry = tuple(names), rate_hz, carry
        self._silent = SilentDevices(names, height_m)
        self.alignment = Alignment(0.0, np.zeros(3))
        self.events: list[str] = []
        self.late = 0
        self._last: DeviceMoment | None = None
        self._begin_clock(0.0)
        self._path: deque[tuple[float, np.ndarray]] = deque(maxlen=16)
        self._away_s = 0.0
        self._slip, self._slip_yaw, self._slip_share = np.zeros(3), 0.0, 0.0

    @property
    def velocity(self) -> np.ndarray:
        """Horizontal velocity of the headset ``(3,)`` over the last frames, m/s."""
        if len(self._path) < 2 or self._path[-1][0] - self._path[0][0] < 0.02:
            return np.zeros(3)
        (begin, first), (end, last) = self._path[0], self._path[-1]
        speed = (last - first) / (end - begin)
        speed[2] = 0.0
        return speed * min(1.0, MAX_SPEED_M_S / max(float(np.linalg.norm(speed)), 1e-9))

    def push(self, frame: DeviceFrame) -> list[DeviceMoment]:
        """The moments due after ``frame`` arrives, for at most ``BRIDGE_S``."""
        last = self._last
        if last is not None and frame.time_s <= last.time_s:
            if last.time_s - frame.time_s <= CLOCK_BACK_S:
                self.late += 1
                return []
            self.events.append("the clock of the devices went back: set up again")
            last = None
        if last is None:
            return self._first(frame)
        step = frame.time_s - last.time_s
        if "headset" not in frame.poses:
            self._away_s += step
            held = last._replace(time_s=frame.time_s, present=np.zeros(len(self._names), bool))
            return self._go_on(last, held, step)
        position, quat, present = self._arrays(frame)
        away, self._away_s = self._away_s + step, 0.0
        moved = float(np.linalg.norm(position[0] - last.position[0]))
        turned = abs(_yaw_between(last.quat[0], quat[0]))
        if away > BRIDGE_S:
            far = moved > NEAR_M or turned > NEAR_RAD
            again = ": set up again" if far else ""
            self.events.append(f"tracking is back after {away:.1f} s{again}")
            if far:
                return self._first(frame)
            self._ease_from(last, position, quat)
        elif moved > JUMP_M + JUMP_M_S * away or turned > JUMP_RAD + JUMP_RAD_S * away:
            if not self._carry:
                self.events.append("the headset jumped: set up again")
                return self._first(frame)
            self._realign(last, frame)
            position, quat, present = self._arrays(frame)
        elif away > step:  # it did not report for a moment
            self._ease_from(last, position, quat)
        position, quat = self._slipped(position, quat, step)
        position, quat = self._silent.filled(position, quat, present, step)
        now = DeviceMoment(frame.time_s, position, quat, present, False)
        self._path.append((now.time_s, position[0].copy()))
        return self._go_on(last, now, step)

    def _first(self, frame: DeviceFrame) -> list[DeviceMoment]:
        """Restart as soon as the headset reports."""
        if "headset" not in frame.poses:
            self._last = None
            return []
        self._slip_share, self._away_s = 0.0, 0.0
        self._path.clear()
        position, quat, present = self._arrays(frame)
        position, quat = self._silent.begin(position, quat, present)
        now = DeviceMoment(frame.time_s, position, quat, present, True)
        self._begin_clock(now.time_s)
        self._path.append((now.time_s, position[0].copy()))
        self._last = now._replace(fresh=False)
        return [now]

    def _begin_clock(self, time_s: float) -> None:
        """Start the fixed-rate moments after this time."""
        self._origin_s, self._count = time_s, 1

    def _go_on(self, last: DeviceMoment, now: DeviceMoment, step: float) -> list[DeviceMoment]:
        """Moments after ``last`` up to ``now``; none for a gap too long to bridge."""
        self._last = now
        if step > BRIDGE_S:
            self._begin_clock(now.time_s)
            return []
        out = []
        while (due := self._origin_s + self._count / self._rate) <= now.time_s + 1e-9:
            self._count += 1
            share = min((due - last.time_s) / step, 1.0)
            out.append(_between(last, now, share, due))
        return out

    def _arrays(self, frame: DeviceFrame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Poses in the avatar's space, and which devices report."""
        count = len(self._names)
        position, quat = np.zeros((count, 3)), np.zeros((count, 4))
        quat[:, 0] = 1.0
        present = np.zeros(count, bool)
        for row, name in enumerate(self._names):
            pose = frame.poses.get(name)
            if pose is not None:
                position[row], quat[row], present[row] = pose.position, pose.quat, True
        return *self.alignment.apply(position, quat), present

    def _realign(self, last: DeviceMoment, frame: DeviceFrame) -> None:
        """Choose the alignment that keeps the headset at its last pose."""
        pose = frame.poses["headset"]
        yaw = _yaw_between(pose.quat, last.quat[0])
        shift = last.position[0] - rot.quat_rotate(rot.yaw_quat(np.array(yaw)), pose.position)
        if abs(shift[2] - self.alignment.shift[2]) < JUMP_M:
            shift[2] = self.alignment.shift[2]  # the floor does not move
        self.alignment = Alignment(yaw, shift)
        self.events.append("the headset jumped: the avatar is carried along")

    def _ease_from(self, last: DeviceMoment, position: np.ndarray, quat: np.ndarray) -> None:
        """Blend from the user's last pose to the present one."""
        self._slip = last.position[0] - position[0]
        self._slip_yaw = _yaw_between(quat[0], last.quat[0])
        self._slip_share = 1.0

    def _slipped(
        self, position: np.ndarray, quat: np.ndarray, step: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Poses moved and rotated about the headset by the rest of the blend."""
        if self._slip_share == 0.0:
            return position, quat
        share = _smooth(self._slip_share)
        self._slip_share = max(self._slip_share - step / EASE_S, 0.0)
        turn = rot.yaw_quat(np.array(share * self._slip_yaw))
        head = position[0]
        return (
            head + share * self._slip + rot.quat_rotate(turn, position - head),
            rot.quat_multiply(turn, quat),
        )


class SilentDevices:
    """Estimates the poses of devices that do not report, relative to the headset.

    Args:
        names: ``D`` devices, the headset first.
        height_m: the user's stature.
    """

    def __init__(self, names: Sequence[str], height_m: float) -> None:
        at = standing_devices(names, height_m)
        self._rest = at - at[0]
        count = len(names)
        self._held, self._held_quat = self._rest.copy(), np.tile(IDENTITY, (count, 1))
        self._silent_s, self._eased = np.full(count, np.inf), np.ones(count)

    def begin(
        self, position: np.ndarray, quat: np.ndarray, present: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Poses of the first moment; controllers that do not report hang at the side."""
        self._silent_s[:], self._eased[:] = np.inf, 1.0
        return self.filled(position, quat, present, 0.0)

    def filled(
        self, position: np.ndarray, quat: np.ndarray, present: np.ndarray, step: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Poses ``(D, 3)``, ``(D, 4)`` of all devices; inputs of absent ones are not read.

        Args:
            position, quat: as reported.
            present: ``(D,)`` bool; True for the headset.
            step: seconds since the moment before.
        """
        head, turn = position[0], rot.yaw_quat(rot.heading(quat[0]))
        sunk = _smooth(np.clip((self._silent_s - HOLD_S) / SINK_S, 0.0, 1.0))[:, None]
        made = head + rot.quat_rotate(turn, (1.0 - sunk) * self._held + sunk * self._rest)
        made_quat = rot.quat_multiply(turn, _blend(self._held_quat, IDENTITY, sunk))
        # A returning device is blended in from its estimated pose.
        self._silent_s += np.where(present, 0.0, step)
        self._eased = np.where(present, np.minimum(self._eased + step / EASE_S, 1.0), 0.0)
        share = _smooth(self._eased)[:, None]
        out = share * position + (1.0 - share) * made
        out_quat = _blend(made_quat, quat, share)
        back = rot.quat_conjugate(turn)
        # The estimate's state is kept until the device is fully blended in.
        whole = self._eased >= 1.0
        self._held[whole] = rot.quat_rotate(back, out - head)[whole]
        self._held_quat[whole] = rot.quat_multiply(back, out_quat)[whole]
        self._silent_s[whole] = 0.0
        return out, out_quat


def _between(a: DeviceMoment, b: DeviceMoment, share: float, time_s: float) -> DeviceMoment:
    position = (1.0 - share) * a.position + share * b.position
    return DeviceMoment(
        time_s, position, _blend(a.quat, b.quat, share), a.present & b.present, False
    )


def _blend(a: np.ndarray, b: np.ndarray, share: float | np.ndarray) -> np.ndarray:
    """Quaternions ``(..., 4)`` between two, by normalised interpolation the shorter way."""
    sign = np.where((a * b).sum(-1, keepdims=True) < 0.0, -1.0, 1.0)
    out = (1.0 - share) * a + share * sign * b
    return out / np.linalg.norm(out, axis=-1, keepdims=True)


def _yaw_between(a: np.ndarray, b: np.ndarray) -> float:
    """Rotation about the vertical from one orientation to another, -pi to pi."""
    turn = float(rot.heading(b) - rot.heading(a))
    return float(np.arctan2(np.sin(turn), np.cos(turn)))


def _smooth(share: np.ndarray | float) -> np.ndarray:
    """A smooth step from 0 to 1 with zero slope at the ends."""
    share = np.asarray(share, float)
    return share * share * (3.0 - 2.0 * share)
