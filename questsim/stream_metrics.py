"""Scores of an avatar that follows real devices, when the user's full-body pose is unknown.

These are QuestSim's columns for real users: device errors and plausibility of the motion. The
formulas are those of ``metrics_terms``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from questsim import metrics_terms as terms
from questsim import rotations as rot
from questsim.avatar_pose import AvatarPose
from questsim.devices import DeviceFrame
from questsim.errors import InputError
from questsim.metrics import CONTACT_CLEARANCE_M, CONTACT_FORCE_N, sole_spheres
from questsim.motion.clip import FPS
from questsim.motion.kinematics import sole_positions
from questsim.sensors import device_poses
from questsim.skeleton import FOOT_LINKS

HEAD_AND_HANDS = ("headset", "left_controller", "right_controller")


@dataclass(frozen=True)
class Track:
    """An avatar and its user's devices at 36 Hz, over a floor at z = 0.

    Attributes:
        time_s: ``(T,)`` on the devices' clock.
        height_m: the avatar's stature.
        names: ``D`` devices that report.
        user_position, user_quat: ``(T, D, 3)``, ``(T, D, 4)``.
        present: ``(T, D)`` bool, whether a device reports.
        position, quat: poses of the devices on the avatar, ``(T, D, 3)``, ``(T, D, 4)``.
        link_position, link_quat: ``(T, 16, 3)``, ``(T, 16, 4)``.
        qpos: ``(T, 40)``.
        contact_force: ``(T, 2)`` vertical, N.
        assist_force: ``(T,)`` N.
        events: texts of events, with times in seconds.
    """

    time_s: np.ndarray
    height_m: float
    names: tuple[str, ...]
    user_position: np.ndarray
    user_quat: np.ndarray
    present: np.ndarray
    position: np.ndarray
    quat: np.ndarray
    link_position: np.ndarray
    link_quat: np.ndarray
    qpos: np.ndarray
    contact_force: np.ndarray
    assist_force: np.ndarray
    events: tuple[tuple[float, str], ...]


def track_of(
    frames: Sequence[DeviceFrame], poses: Sequence[AvatarPose], floor_m: float = 0.0
) -> Track:
    """Combine the poses of a replay with the device frames at the same times.

    Args:
        frames: calibrated frames: device poses as on the avatar, above a floor at z = 0.
        poses: one per frame, in the devices' space.
        floor_m: height of the floor in that space.

    Raises:
        InputError: fewer than a second of poses.
    """
    times = np.array([pose.time_s for pose in poses])
    wanted = np.arange(times[0], times[-1], 1.0 / FPS) if len(times) else times
    if len(wanted) < FPS:
        raise InputError("fewer than a second of poses", "recording", "record longer")
    # Take the last pose at or before each time: interpolation would smooth the scored motion.
    chosen = [poses[i] for i in np.searchsorted(times, wanted + 1e-9, side="right") - 1]
    height = poses[0].height_m
    names = tuple(n for n in HEAD_AND_HANDS if any(n in f.poses for f in frames))
    user_position, user_quat, present = _devices_at(frames, wanted, names)
    down = np.array([0.0, 0.0, floor_m])
    links = np.array([pose.link_position for pose in chosen]) - down
    turned = np.array([pose.link_quat for pose in chosen])
    position, quat = device_poses(links, turned, names, height)
    qpos = np.array([pose.qpos for pose in chosen])
    qpos[:, :3] -= down
    return Track(
        time_s=wanted,
        height_m=height,
        names=names,
        user_position=user_position,
        user_quat=user_quat,
        present=present,
        position=position,
        quat=quat,
        link_position=links,
        link_quat=turned,
        qpos=qpos,
        contact_force=np.array([pose.contact_force[:, 2] for pose in chosen]),
        assist_force=np.array([np.linalg.norm(pose.assist_force) for pose in chosen]),
        events=tuple((pose.time_s, event) for pose in poses for event in pose.events),
    )


def _devices_at(
    frames: Sequence[DeviceFrame], times: np.ndarray, names: Sequence[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Interpolated device poses at given times; absent in gaps of 0.1 s or more."""
    position, quat = np.zeros((len(times), len(names), 3)), np.zeros((len(times), len(names), 4))
    quat[..., 0] = 1.0
    present = np.zeros((len(times), len(names)), bool)
    for d, name in enumerate(names):
        seen = [(frame.time_s, frame.poses[name]) for frame in frames if name in frame.poses]
        known = np.array([time for time, _ in seen])
        if len(known) < 2:
            continue
        at = np.array([pose.position for _, pose in seen])
        turned = np.array([pose.quat for _, pose in seen])
        inside = np.clip(times, known[0], known[-1])
        position[:, d], quat[:, d] = rot.resample_poses(at, turned, known, inside)
        after = np.clip(np.searchsorted(known, times), 1, len(known) - 1)
        near = (known[after] - known[after - 1] < 0.1) | np.isin(times, known)
        present[:, d] = near & (times >= known[0]) & (times <= known[-1])
    return position, quat, present


def stream_scores(track: Track) -> dict[str, float | int | None]:
    """Figures of a track; None where there is nothing to average.

    ``mhpe_cm`` and ``mhre_deg``: position and rotation of the devices that report, avatar against
    user; ``jitter_km_s3``, ``foot_skate_cm_s`` and ``penetration_cm`` as in an evaluation;
    ``falls``: times the avatar was set up again after a fall; ``restarts``: for any reason;
    ``assist_percent`` of the time, and ``assist_n``, mean force while it is in use.
    """
    apart = 100.0 * np.linalg.norm(track.position - track.user_position, axis=-1)
    angle = np.degrees(rot.angle_between(track.quat, track.user_quat))
    feet = list(FOOT_LINKS)
    at, turned = track.link_position[:, feet], track.link_quat[:, feet]
    clearance = sole_positions(at, turned, track.height_m)[..., 2].min(axis=-1)
    forces = track.contact_force
    contact = forces > CONTACT_FORCE_N if forces.any() else clearance < CONTACT_CLEARANCE_M
    skate = terms.foot_skate_cm_s(at, turned, contact, sole_spheres(track.height_m), FPS)
    used = track.assist_force > 0.0
    texts = [event for _, event in track.events]
    return {
        "seconds": float(len(track.time_s) / FPS),
        "mhpe_cm": _mean(apart[track.present]),
        "mhre_deg": _mean(angle[track.present]),
        "jitter_km_s3": _mean(terms.jitter_km_s3(track.link_position, FPS)),
        "foot_skate_cm_s": _mean(skate),
        "penetration_cm": _mean(terms.penetration_cm(clearance)),
        "falls": sum("fell" in text for text in texts),
        "restarts": sum("set up again" in text for text in texts),
        "assist_percent": 100.0 * float(used.mean()),
        "assist_n": _mean(track.assist_force[used]),
    }


def _mean(values: np.ndarray) -> float | None:
    return float(values.mean()) if len(values) else None
