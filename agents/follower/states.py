"""States of the avatar on a stream, and interpolation between them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from questsim.motion.motion import Motion

NO_OBJECTS = np.zeros((0, 7))


@dataclass(frozen=True)
class AvatarState:
    """The avatar's state at one moment.

    Attributes:
        time_s: on the clock of the devices.
        qpos: ``(40,)``.
        contact_force: ``(2, 3)`` N.
        assist_force, assist_torque: ``(3,)`` N, N m.
        objects: ``(K, 7)`` positions and quaternions of the objects.
        headset_error_m: distance of the avatar's headset from the user's, just before.
    """

    time_s: float
    qpos: np.ndarray
    contact_force: np.ndarray
    assist_force: np.ndarray
    assist_torque: np.ndarray
    headset_error_m: float
    objects: np.ndarray


def between_poses(a: Motion, b: Motion, share: float) -> Motion:
    """Interpolate two poses (one frame each) of the same person."""
    sign = np.where((a.rotations * b.rotations).sum(-1, keepdims=True) < 0.0, -1.0, 1.0)
    turn = (1.0 - share) * a.rotations + share * sign * b.rotations
    turn /= np.linalg.norm(turn, axis=-1, keepdims=True)
    root = (1.0 - share) * a.root_position + share * b.root_position
    return replace(b, root_position=root, rotations=turn)


def resting_state(time_s: float, qpos: np.ndarray, objects: np.ndarray = NO_OBJECTS) -> AvatarState:
    """A pose ``(40,)`` without forces."""
    return AvatarState(time_s, qpos, np.zeros((2, 3)), np.zeros(3), np.zeros(3), 0.0, objects)


def between_states(a: AvatarState, b: AvatarState, time_s: float) -> AvatarState:
    """Interpolate two states at a time between them."""
    share = (time_s - a.time_s) / (b.time_s - a.time_s)

    def mix(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (1.0 - share) * x + share * y

    return AvatarState(
        time_s=time_s,
        qpos=between_qpos(a.qpos, b.qpos, share),
        contact_force=mix(a.contact_force, b.contact_force),
        assist_force=mix(a.assist_force, b.assist_force),
        assist_torque=mix(a.assist_torque, b.assist_torque),
        headset_error_m=b.headset_error_m,
        objects=_between_objects(a.objects, b.objects, share),
    )


def between_qpos(a: np.ndarray, b: np.ndarray, share: float) -> np.ndarray:
    """Interpolate two poses ``(40,)``: positions and angles linearly, the root's rotation too."""
    out = (1.0 - share) * a + share * b
    sign = -1.0 if a[3:7] @ b[3:7] < 0.0 else 1.0
    out[3:7] = (1.0 - share) * a[3:7] + share * sign * b[3:7]
    out[3:7] /= np.linalg.norm(out[3:7])
    return out


def _between_objects(a: np.ndarray, b: np.ndarray, share: float) -> np.ndarray:
    """Interpolate poses ``(K, 7)`` of objects."""
    out = (1.0 - share) * a + share * b
    sign = np.where((a[:, 3:] * b[:, 3:]).sum(-1, keepdims=True) < 0.0, -1.0, 1.0)
    out[:, 3:] = (1.0 - share) * a[:, 3:] + share * sign * b[:, 3:]
    out[:, 3:] /= np.linalg.norm(out[:, 3:], axis=-1, keepdims=True)
    return out
