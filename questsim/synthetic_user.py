"""Device streams of synthetic users: clips of the avatar, seen by devices with noise.

A stream begins with calibration: the user stands still, arms hanging. Then clips follow. Each
starts where the previous one ended, after one second in which the device poses are interpolated.
Each begins and ends in slow motion. Used by tests, benchmarks and the shipped recording.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from questsim import rotations as rot
from questsim.devices import DeviceFrame, DevicePose
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import clip_from_qpos, standing_clip
from questsim.motion.varying.chain import EASED_FRAMES, eased_frames, placed
from questsim.sensors import SENSOR_SETS, device_poses
from questsim.skeleton import LINKS

STILL_S, GLIDE_S = 4.0, 1.2
PALMS_S, PALMS_HZ = 3.0, 0.7
"""Duration of the calibration's second part, and how often the palms turn in it."""
EXAMPLE_CLIPS = (
    "walk-0.8-start-stop", "wave-1", "walk-1.2-start-stop", "turn-left-0-1", "raise-both-hands-1",
    "squat-1", "stand-1", "turn-right-0-1", "boxing-1", "whiteboard-1",
    "walk-1.2-start-stop", "raise-right-hand-1",
)  # fmt: skip
"""Clips of the shipped recording, after standing still."""
SWAY_M = 0.006
"""Amplitude of the slow sway while standing still."""


@dataclass(frozen=True)
class SyntheticUser:
    """A synthetic user, the mounting of the devices, and their noise.

    Attributes:
        height_m: stature.
        devices: name of a sensor set without IMUs.
        eyes_m: height of the eyes above those of the avatar of this stature.
        arms_deg: angle of the hanging arms from the body, left and right.
        arms_ahead_deg: angle of the hanging arms to the front.
        mounts: by device, its reported pose relative to its pose on the avatar: offset ``(3,)`` in
            metres and rotation vector ``(3,)``.
        palms_deg: how far the user then turns the palms to each side, for ``PALMS_S``; 0 for not.
        noise_m, noise_rad: standard deviation of white noise on every coordinate.
        seed: of noise, sway, jitter and losses.
    """

    height_m: float = 1.75
    devices: str = "H+2C"
    eyes_m: float = 0.0
    arms_deg: tuple[float, float] = (8.0, 8.0)
    arms_ahead_deg: tuple[float, float] = (0.0, 0.0)
    mounts: Mapping[str, tuple[Sequence[float], Sequence[float]]] = field(default_factory=dict)
    palms_deg: float = 0.0
    noise_m: float = 0.001
    noise_rad: float = 0.003
    seed: int = 0


@dataclass(frozen=True)
class Span:
    """A clip in a stream.

    Attributes:
        clip: the part at full speed, for the user's stature, moved to its place.
        start_s: time of its first frame.
    """

    clip: Clip
    start_s: float

    @property
    def end_s(self) -> float:
        """Time of its last frame."""
        return self.start_s + self.clip.duration


def stream(
    user: SyntheticUser,
    clips: Sequence[Clip],
    rate_hz: float = 72.0,
    jitter_s: float = 0.0,
    loss: float = 0.0,
) -> tuple[list[DeviceFrame], list[Span]]:
    """Frames of a user who stands still for ``STILL_S`` and then performs clips.

    Args:
        user: the user.
        clips: clips to perform in this order; they are scaled to the user's stature.
        rate_hz: frames a second.
        jitter_s: greatest deviation of a timestamp from regular ones; timestamps stay in order, and
            poses are those at the timestamps.
        loss: share of frames that are missing.

    Returns:
        The frames in our convention, and the clips with their times.
    """
    names = SENSOR_SETS[user.devices]
    position, quat = _calibration(user, names)
    spans = []
    heading, spot = 0.0, np.zeros(2)
    for clip in clips:
        clip = placed(clip.scaled(user.height_m), heading, spot)
        at, turned = device_poses(clip.link_position, clip.link_quat, names, user.height_m)
        at, turned = _eased(at, turned)
        glide = _glide((position[-1], quat[-1]), (at[0], turned[0]), round(GLIDE_S * FPS))
        begun = len(position) + len(glide[0]) + 2 * EASED_FRAMES
        spans.append(Span(_middle(clip), begun / FPS))
        position = np.concatenate([position, glide[0], at])
        quat = np.concatenate([quat, glide[1], turned])
        heading = float(rot.heading(clip.qpos[-1, 3:7]))
        spot = clip.qpos[-1, :2]
    return _seen(user, names, position, quat, rate_hz, jitter_s, loss), spans


def example_frames() -> list[DeviceFrame]:
    """The two minutes of the shipped recording, ``recordings.example_path``.

    A user of 1.68 m with controllers held a little askew, at 45 Hz with jitter and losses, as
    OpenXR reports them: ``write_recording(path, example_frames(), "openxr", decimals=4)``.
    """
    from questsim.motion.synthesis.synthetic import synthetic_clips

    clips = {clip.name.removeprefix("synthetic-"): clip for clip in synthetic_clips()}
    user = SyntheticUser(
        height_m=1.68,
        mounts={
            "left_controller": ((0.01, 0.0, -0.015), (0.2, 0.3, -0.1)),
            "right_controller": ((0.01, 0.005, -0.01), (-0.2, 0.35, 0.1)),
        },
        noise_m=0.0,
        noise_rad=0.0,
    )
    clips_done = [clips[name] for name in EXAMPLE_CLIPS]
    return stream(user, clips_done, 45.0, jitter_s=0.005, loss=0.01)[0]


def _calibration(user: SyntheticUser, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Device poses ``(T, D, 3)``, ``(T, D, 4)`` of the user standing still, then turning palms."""
    at, turned = _standing_devices(user, names, np.zeros(1))
    time = np.arange(round(STILL_S * FPS)) / FPS
    at, turned = (np.tile(x, (len(time), 1, 1)) for x in (at, turned))
    if user.palms_deg:
        after = np.arange(round(PALMS_S * FPS)) / FPS
        swing = np.radians(user.palms_deg) * np.sin(2.0 * np.pi * PALMS_HZ * after)
        palms = _standing_devices(user, names, swing)
        at, turned = np.concatenate([at, palms[0]]), np.concatenate([turned, palms[1]])
        time = np.arange(len(at)) / FPS
    rng = np.random.default_rng([user.seed, 1])
    sway = np.zeros((len(time), 2))
    for hertz in (0.23, 0.41):
        phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        sway += SWAY_M / 2.0 * np.sin(2.0 * np.pi * hertz * time[:, None] + phase)
    # The whole body leans about the ankles: lower devices move less.
    at[..., :2] += sway[:, None] * (at[..., 2:] / user.height_m)
    return at, turned


def _standing_devices(
    user: SyntheticUser, names: Sequence[str], palms_rad: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Device poses ``(T, D, 3)``, ``(T, D, 4)`` of a user with palms turned by ``(T,)`` angles."""
    clip = standing_clip(user.height_m)
    links = clip.link_position[0].copy()
    twisted = np.tile(clip.link_quat[0], (len(palms_rad), 1, 1))
    for index, side in enumerate(("left", "right")):
        sign = 1.0 if side == "left" else -1.0
        angles = [sign * user.arms_deg[index], -user.arms_ahead_deg[index]]
        turn = rot.as_quat(Rotation.from_euler("xy", angles, degrees=True))
        hand, shoulder = LINKS.index(f"{side}_hand"), LINKS.index(f"{side}_upper_arm")
        links[hand] = links[shoulder] + rot.quat_rotate(turn, links[hand] - links[shoulder])
        along = (links[shoulder] - links[hand]) / np.linalg.norm(links[shoulder] - links[hand])
        twist = rot.as_quat(Rotation.from_rotvec(sign * palms_rad[:, None] * along))
        twisted[:, hand] = rot.quat_multiply(twist, turn)
    return device_poses(np.tile(links, (len(palms_rad), 1, 1)), twisted, names, user.height_m)


def _eased(position: np.ndarray, quat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Device poses ``(T, D, ...)`` played from rest to full speed, and back to rest at the end."""
    place = eased_frames(len(position))
    before = np.minimum(place.astype(int), len(position) - 2)
    share = (place - before)[:, None, None]
    a, b = quat[before], quat[before + 1]
    turned = (1.0 - share) * a + share * np.where((a * b).sum(-1, keepdims=True) < 0.0, -b, b)
    at = (1.0 - share) * position[before] + share * position[before + 1]
    return at, turned / np.linalg.norm(turned, axis=-1, keepdims=True)


def _middle(clip: Clip) -> Clip:
    """The frames of a clip at full speed."""
    qpos = clip.qpos[EASED_FRAMES : len(clip) - EASED_FRAMES]
    about = {"kind": clip.kind, "style": clip.style, "source": clip.source}
    return replace(
        clip_from_qpos(clip.name, qpos, clip.height_m, clip.proportions, **about),
        licence=clip.licence,
    )


def _glide(
    a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray], frames: int
) -> tuple[np.ndarray, np.ndarray]:
    """Interpolated poses between two poses, without the two."""
    share = (np.arange(1, frames + 1) / (frames + 1))[:, None, None]
    share = share * share * (3.0 - 2.0 * share)
    sign = np.where((a[1] * b[1]).sum(-1, keepdims=True) < 0.0, -1.0, 1.0)
    quat = (1.0 - share) * a[1] + share * sign * b[1]
    return (1.0 - share) * a[0] + share * b[0], quat / np.linalg.norm(quat, axis=-1, keepdims=True)


def _seen(
    user: SyntheticUser,
    names: Sequence[str],
    position: np.ndarray,
    quat: np.ndarray,
    rate_hz: float,
    jitter_s: float,
    loss: float,
) -> list[DeviceFrame]:
    """Device reports, with noise, of poses at 36 Hz."""
    rng = np.random.default_rng([user.seed, 2])
    known = np.arange(len(position)) / FPS
    times = np.arange(0.0, known[-1], 1.0 / rate_hz)
    times = np.clip(times + rng.uniform(-jitter_s, jitter_s, len(times)), 0.0, known[-1])
    times = np.unique(times[rng.random(len(times)) >= loss])
    at, turned = rot.resample_poses(position, quat, known, times)
    for row, name in enumerate(names):
        offset, turn = user.mounts.get(name, ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
        at[:, row] += rot.quat_rotate(turned[:, row], np.array(offset, float))
        own = rot.as_quat(Rotation.from_rotvec(np.array(turn, float)))
        turned[:, row] = rot.quat_multiply(turned[:, row], own)
        if name == "headset":
            at[:, row, 2] += user.eyes_m
    at += rng.normal(0.0, user.noise_m, at.shape)
    shaken = Rotation.from_rotvec(rng.normal(0.0, user.noise_rad, (at.shape[0] * len(names), 3)))
    turned = rot.quat_multiply(turned, rot.as_quat(shaken, turned.shape[:2]))
    return [
        DeviceFrame(
            float(time),
            {name: DevicePose(at[t, d], turned[t, d]) for d, name in enumerate(names)},
        )
        for t, time in enumerate(times)
    ]
