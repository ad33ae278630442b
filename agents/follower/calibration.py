"""Calibration: estimate a standing user's stature, floor and device mounts.

The user stands upright for three seconds, looks straight ahead and lets the arms hang (or holds
them apart in an A-pose). The body is assumed to have the avatar's proportions:

- stature: the headset's height over the floor, divided by ``EYE_RATIO``, as QuestSim (section 3.6)
  scales by the headset's height;
- heading: perpendicular to the line between the controllers, or the headset's direction;
- mount of each controller: the transform from its reported pose to the avatar's controller in the
  same pose. One pose gives only the sum of arm and grip; palms that turn to and fro separate the
  two, see ``palms``.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from agents.follower.palms import ForearmAxis, forearm_axis
from questsim import rotations as rot
from questsim.body import MAX_HEIGHT_M, MIN_HEIGHT_M
from questsim.devices import UNIT_TOLERANCE, DeviceFrame, DevicePose
from questsim.errors import InputError
from questsim.files import whole_file
from questsim.motion.kinematics import standing_clip, standing_devices
from questsim.sensors import DEVICES, device_poses
from questsim.skeleton import LINKS

EYE_RATIO = 0.936
"""Height of the eyes over stature, standing.

Source: Drillis & Contini, "Body Segment Parameters" (1966), as in Winter, "Biomechanics and Motor
Control of Human Movement", fig. 4.1. The avatar carries its headset at 0.9357.
"""
LEAST_S, LEAST_FRAMES = 1.0, 20
"""Shortest calibration, and fewest frames."""
STILL_M, STILL_DEG = 0.06, 12.0
"""Largest distance and angle of a still device from its median position and mean orientation."""
FLOOR_OFF_M = 0.15
"""With a given stature: a headset further than this from its height means a floor not at z = 0."""
POSES: dict[str, float] = {"hanging": 8.0, "a-pose": 30.0}
"""Angle in degrees between arms and body, by the name of the pose."""
ARM_STD_DEG: dict[str, float] = {"hanging": 2.0, "a-pose": 4.0}
GRIP_STD_M, SEEN_STD_M = 0.012, 0.005
"""Standard deviations: how users hold arm and controller, and tracking noise."""
AXIS_STD_RAD, AXIS_STD_M = np.radians(2.0), 0.003
"""Standard deviations of the axis of the forearm: direction, distance from the controller."""


AGAIN = "calibrate again"


@dataclass(frozen=True)
class DeviceMount:
    """The transform from a device's reported pose to the pose of the avatar's device.

    Attributes:
        offset: ``(3,)`` metres, in the axes of the reported pose.
        turn: ``(4,)`` orientation of the avatar's device relative to the reported one.
    """

    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    def apply(self, pose: DevicePose) -> DevicePose:
        """The pose of the avatar's device."""
        return DevicePose(
            pose.position + rot.quat_rotate(pose.quat, np.array(self.offset)),
            rot.quat_multiply(pose.quat, np.array(self.turn)),
        )


@dataclass(frozen=True)
class Calibration:
    """The calibration of a user and their devices.

    Attributes:
        height_m: stature.
        floor_m: height of the floor in the devices' space.
        heading_rad: the user's heading about the vertical, from the x axis.
        mounts: by device; a device without an entry has the avatar's own mount.
    """

    height_m: float
    floor_m: float = 0.0
    heading_rad: float = 0.0
    mounts: Mapping[str, DeviceMount] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not MIN_HEIGHT_M <= self.height_m <= MAX_HEIGHT_M:
            raise InputError(
                f"stature {self.height_m:.2f} m is not within {MIN_HEIGHT_M}-{MAX_HEIGHT_M} m",
                "calibration",
                "stand upright, check the headset's floor, or give --height",
            )

    def apply(self, frame: DeviceFrame) -> DeviceFrame:
        """The frame with the floor at z = 0 and every device at the avatar's mount."""
        floor = np.array([0.0, 0.0, self.floor_m])
        poses = {}
        for name, pose in frame.poses.items():
            mount = self.mounts.get(name)
            pose = pose if mount is None else mount.apply(pose)
            poses[name] = DevicePose(pose.position - floor, pose.quat)
        return DeviceFrame(frame.time_s, poses)

    def save(self, path: Path) -> None:
        """Write it as JSON."""
        text = json.dumps({"format": "questsim-calibration", **asdict(self)}, indent=1)
        with whole_file(path) as fresh:
            fresh.write_text(text)

    @staticmethod
    def load(path: Path) -> Calibration:
        """Read a file written by ``save``.

        Raises:
            InputError: it is not such a file.
        """
        try:
            values = json.loads(path.read_text())
        except (ValueError, RecursionError):
            raise InputError("is not a calibration: not JSON", path, AGAIN) from None
        return Calibration.of(values, path)

    @staticmethod
    def of(values: Any, where: str | Path = "calibration") -> Calibration:
        """The calibration of a JSON object.

        Args:
            values: the object, as ``save`` writes it.
            where: its source, for messages.

        Raises:
            InputError: a field is missing or wrong.
        """
        if not isinstance(values, dict) or not isinstance(values.get("mounts"), dict):
            raise InputError("is not a calibration: it has no mounts", where, AGAIN)
        height_m, floor_m, heading_rad = (
            _numbers(values, key, 1, where)[0] for key in ("height_m", "floor_m", "heading_rad")
        )
        mounts = {}
        for name, mount in values["mounts"].items():
            if name not in DEVICES or not isinstance(mount, dict):
                raise InputError(f"has a mount of {name!r}, which is not a device", where, AGAIN)
            offset, turn = (
                _numbers(mount, key, count, where) for key, count in (("offset", 3), ("turn", 4))
            )
            if abs(np.linalg.norm(turn) - 1.0) > UNIT_TOLERANCE:
                raise InputError(f"turn of {name} is not a unit quaternion", where, AGAIN)
            mounts[name] = _mount(offset, turn)
        return Calibration(float(height_m), float(floor_m), float(heading_rad), mounts)


def _numbers(values: Mapping[str, Any], key: str, count: int, where: str | Path) -> np.ndarray:
    """The field ``key`` as ``(count,)`` finite numbers."""
    try:
        numbers = np.atleast_1d(np.asarray(values[key], float))
    except (KeyError, TypeError, ValueError, OverflowError):
        numbers = np.zeros(0)
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        what = "a finite number" if count == 1 else f"{count} finite numbers"
        raise InputError(f"{key} is missing or not {what}", where, AGAIN)
    return numbers


def calibrate(
    frames: Iterable[DeviceFrame],
    *,
    height_m: float | None = None,
    floor_m: float | None = None,
    pose: str = "hanging",
    palms: Iterable[DeviceFrame] = (),
) -> Calibration:
    """Calibrate on a user who stands upright and still.

    Args:
        frames: about three seconds of frames, most of them with the headset.
        height_m: stature, if known. If the headset is then more than 15 cm off its expected
            height, the origin is assumed not to be on the floor, and the floor height is computed.
        floor_m: height of the floor in the devices' space, if it is not 0.
        pose: ``"hanging"`` arms, or ``"a-pose"``, each arm 30 degrees from the body.
        palms: more frames, in which the user turns both palms to and fro; see ``palms``.

    Raises:
        InputError: too few frames; or the user moves, looks aside or is too short or tall; or the
            palms hardly turn.
    """
    if pose not in POSES:
        raise InputError(f"unknown pose {pose!r}", "calibration", f"choose from {', '.join(POSES)}")
    frames = list(frames)
    head = _level_headset(frames)
    height, floor = _height_and_floor(float(head.position[2]), height_m, floor_m)
    looked = float(rot.heading(head.quat))
    found = Calibration(height, floor, looked)  # refuses a stature out of range
    upright = standing_devices(["headset"], height)
    mounts = {"headset": _headset_mount(head, looked, floor, upright[0, 2])}
    hands = {
        side: hand
        for side in ("left", "right")
        if (hand := _still(frames, f"{side}_controller")) is not None
    }
    heading = _heading(looked, hands)
    turn = rot.yaw_quat(np.array(heading))
    spot = head.position - rot.quat_rotate(turn, upright[0] * np.array([1.0, 1.0, 0.0]))
    spot[2] = floor
    palms = list(palms)
    for side, hand in hands.items():
        axis = forearm_axis(palms, f"{side}_controller")
        mounts[f"{side}_controller"] = _hand_mount(side, hand, height, spot, turn, pose, axis)
    return Calibration(height, found.floor_m, heading, mounts)


def _level_headset(frames: Sequence[DeviceFrame]) -> DevicePose:
    """The pose of the headset of a user who stands still and looks straight ahead.

    Raises:
        InputError: too few frames, or the headset moves or is tilted by more than 30 degrees.
    """
    head = _still(frames, "headset")
    if head is None:
        raise InputError(
            f"fewer than {LEAST_FRAMES} frames or {LEAST_S:g} s with a headset",
            "calibration",
            "stand still for three seconds",
        )
    tilt = float(rot.quat_rotate(head.quat, np.array([0.0, 0.0, 1.0]))[2])
    if tilt < np.cos(np.radians(30.0)):
        raise InputError("the headset is tilted", "calibration", "look straight ahead")
    return head


def _headset_mount(head: DevicePose, looked: float, floor: float, upright_m: float) -> DeviceMount:
    """Mount that makes the headset level and lifts it to ``upright_m`` over the floor."""
    back = rot.quat_conjugate(head.quat)
    lift = np.array([0.0, 0.0, upright_m - (float(head.position[2]) - floor)])
    return _mount(
        rot.quat_rotate(back, lift), rot.quat_multiply(back, rot.yaw_quat(np.array(looked)))
    )


def _height_and_floor(
    eyes: float, height_m: float | None, floor_m: float | None
) -> tuple[float, float]:
    """Stature and height of the floor, for eyes at a height in the devices' space; all in m."""
    floor = floor_m or 0.0
    if height_m is None:
        return (eyes - floor) / EYE_RATIO, floor
    if floor_m is None and abs(eyes - EYE_RATIO * height_m) > FLOOR_OFF_M:
        floor = eyes - EYE_RATIO * height_m
    return height_m, floor


def _mount(offset: np.ndarray, turn: np.ndarray) -> DeviceMount:
    x, y, z = map(float, offset)
    w, a, b, c = map(float, turn)
    return DeviceMount((x, y, z), (w, a, b, c))


def _still(frames: Sequence[DeviceFrame], name: str) -> DevicePose | None:
    """Median position and mean orientation of a device; None if it reports too rarely.

    Raises:
        InputError: it moves.
    """
    seen = [(frame.time_s, frame.poses[name]) for frame in frames if name in frame.poses]
    if len(seen) < LEAST_FRAMES or seen[-1][0] - seen[0][0] < LEAST_S:
        return None
    places = np.array([pose.position for _, pose in seen])
    turns = rot.as_rotation(np.array([pose.quat for _, pose in seen]))
    middle, mean = np.median(places, axis=0), turns.mean()
    strayed = float(np.percentile(np.linalg.norm(places - middle, axis=-1), 90))
    turned = float(np.degrees(np.percentile((mean.inv() * turns).magnitude(), 90)))
    if strayed > STILL_M or turned > STILL_DEG:
        raise InputError(
            f"{name} moved by {100 * strayed:.0f} cm and turned by {turned:.0f} degrees",
            "calibration",
            "stand still for three seconds",
        )
    return DevicePose(middle, rot.as_quat(mean))


def _heading(looked: float, hands: Mapping[str, DevicePose]) -> float:
    """The user's heading: midway between the headset's and the normal of the line of the hands."""
    if len(hands) < 2:
        return looked
    across = hands["left"].position - hands["right"].position
    facing = float(np.arctan2(across[1], across[0])) - np.pi / 2.0
    apart = float(np.arctan2(np.sin(facing - looked), np.cos(facing - looked)))
    if abs(apart) > np.radians(25.0):
        raise InputError(
            f"the headset looks {abs(np.degrees(apart)):.0f} degrees away from the arms",
            "calibration",
            "look straight ahead, arms alike on both sides, each controller in its own hand",
        )
    return looked + 0.5 * apart


def _hand_mount(
    side: str,
    hand: DevicePose,
    height: float,
    spot: np.ndarray,
    turn: np.ndarray,
    pose: str,
    axis: ForearmAxis | None,
) -> DeviceMount:
    """Mount of a controller, from its pose while the arm hangs straight.

    The exact arm angle and the grip are unknown. Both are estimated together with priors around
    the usual values: the pose's arm angle within ``ARM_STD_DEG``, the controller in the fist
    within ``GRIP_STD_M``. The forearm's axis, if known, is the line from the shoulder.
    """
    standing = standing_clip(height)
    links, quats = standing.link_position[0], standing.link_quat[0]
    name = f"{side}_controller"
    carried, _ = device_poses(links, quats, [name], height)
    shoulder = links[LINKS.index(f"{side}_upper_arm")]
    reach = carried[0] - shoulder
    along = shoulder - links[LINKS.index(f"{side}_hand")]
    along /= np.linalg.norm(along)
    origin = spot + rot.quat_rotate(turn, shoulder)
    sign = 1.0 if side == "left" else -1.0
    nominal = np.radians(POSES[pose])

    def arm(angles: np.ndarray) -> np.ndarray:
        about = Rotation.from_euler("xy", [sign * angles[0], -angles[1]])
        return rot.quat_multiply(turn, rot.as_quat(about))

    def residuals(x: np.ndarray) -> np.ndarray:
        held = arm(x[:2])
        place = origin + rot.quat_rotate(held, reach + x[2:])
        rows = [
            (place - hand.position) / SEEN_STD_M,
            (x[:2] - [nominal, 0.0]) / np.radians(ARM_STD_DEG[pose]),
            x[2:] / GRIP_STD_M,
        ]
        if axis is not None:
            seen = rot.quat_multiply(rot.quat_conjugate(held), hand.quat)  # in the hand's axes
            rows.append(np.cross(along, rot.quat_rotate(seen, axis.direction)) / AXIS_STD_RAD)
            apart = reach + x[2:] - rot.quat_rotate(seen, axis.offset)
            rows.append((apart - (apart @ along) * along) / AXIS_STD_M)
        return np.concatenate(rows)

    x = least_squares(residuals, np.array([nominal, 0.0, 0.0, 0.0, 0.0])).x
    hand_quat = arm(x[:2])
    back = rot.quat_conjugate(hand.quat)
    offset = rot.quat_rotate(back, rot.quat_rotate(hand_quat, -x[2:]))
    return _mount(offset, rot.quat_multiply(back, hand_quat))
