"""The interface between a running simulation and its viewers.

Viewers use a simulation only through this interface; ``agents/live`` implements it with agents
and environments.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from questsim import rotations as rot
from questsim.body import DEFAULT_HEIGHT_M
from questsim.heightfield import HeightField
from questsim.objects import ObjectShape
from questsim.skeleton import FOOT_LINKS, LINKS

NEWTONS_PER_METRE = 1500.0
"""Scale of force arrows: a foot that carries 70 kg has an arrow of 46 cm."""
PUSH_SCALE = 5.0
"""Arrows of pushes are this many times longer: a push of 100 N has an arrow of 33 cm."""

_ASIDE_M = 0.14

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0)
"""Selectable playback speeds as multiples of real time."""

ROUGHNESS = (0.0, 2.0)
"""Minimum and maximum factor on a terrain's own relief."""


@dataclass(frozen=True)
class Scenery:
    """The parts of a picture that rarely change.

    Attributes:
        number: increases with every change.
        height_m: the avatar's stature.
        ground: the floor near the clip's path; None for a flat one at z = 0.
        parts: parts of the object in the scene; empty without one.
        user_height_m: the user's stature; None for the avatar's.
    """

    number: int
    height_m: float = DEFAULT_HEIGHT_M
    ground: HeightField | None = None
    parts: tuple[ObjectShape, ...] = ()
    user_height_m: float | None = None

    @property
    def user_m(self) -> float:
        """The user's stature in metres."""
        return self.height_m if self.user_height_m is None else self.user_height_m


@dataclass(frozen=True)
class Snapshot:
    """One moment of a simulation.

    Attributes:
        scenery: the scenery of this moment.
        step: steps since the session began; unique for each moment.
        time_s: seconds since the clip's first frame.
        duration_s: of the clip.
        position, quat: ``(16, 3)`` metres and ``(16, 4)`` wxyz, the avatar's links.
        reference_position, reference_quat: the same for the user, in the user's own size.
        device_position, device_quat: ``(D, 3)``, ``(D, 4)`` of the user's devices, scaled to the
            avatar.
        contact_force: ``(2, 3)`` force of the floor on the left and the right foot in newtons.
        qpos, reference_qpos: ``(40,)`` poses of the avatar and the reference, for rendering.
        error_m: mean distance of the links from the reference.
        push_n: ``(3,)`` current push on the chest in newtons, or zeros.
        object_pose: position ``(3,)`` and orientation ``(4,)`` of the object, or None.
        outcome: ``""``, ``"fell"`` or ``"completed"``.
        paused: whether the simulation is paused.
        note: about the agent, such as the age of its checkpoint.
        physics: whether torques move the avatar. If not, it is set to the agent's poses, without
            contact forces, and cannot be pushed.
    """

    scenery: Scenery
    step: int
    time_s: float
    duration_s: float
    position: np.ndarray
    quat: np.ndarray
    reference_position: np.ndarray
    reference_quat: np.ndarray
    device_position: np.ndarray
    device_quat: np.ndarray
    contact_force: np.ndarray
    qpos: np.ndarray
    reference_qpos: np.ndarray
    error_m: float
    push_n: np.ndarray
    object_pose: tuple[np.ndarray, np.ndarray] | None = None
    outcome: str = ""
    paused: bool = False
    note: str = ""
    physics: bool = True


def force_arrows(snapshot: Snapshot) -> np.ndarray:
    """Start and end points ``(3, 2, 3)`` in metres of the force arrows of both feet and of a push.

    Foot arrows are drawn beside the leg, which would hide them. A push arrow ends at the chest.
    Without a force, an arrow has zero length.
    """
    feet = list(FOOT_LINKS)
    outward = rot.quat_rotate(snapshot.quat[feet], np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]))
    outward[:, 2] = -0.3  # about the height of the sole
    start = snapshot.position[feet] + _ASIDE_M * outward
    push = snapshot.push_n / NEWTONS_PER_METRE * PUSH_SCALE
    strength = max(float(np.linalg.norm(push)), 1e-9)
    chest = snapshot.position[LINKS.index("chest")] + [0.0, 0.0, 0.1] - _ASIDE_M * push / strength
    begin, end = (
        [*start, chest - push],
        [*(start + snapshot.contact_force / NEWTONS_PER_METRE), chest],
    )
    return np.stack([begin, end], axis=1)


@dataclass(frozen=True)
class Settings:
    """What a viewer can choose.

    Attributes:
        clip, agent, sensors, terrain, object: names from ``Choices``.
        roughness: factor on the terrain's own relief, such as ±4 cm of rough ground or steps of
            8 cm; within ``ROUGHNESS``.
        height_m: the user's stature.
        speed: playback speed; 1 is real time.
        object: the object, or ``"none"``.
        avatar_height_m: the avatar's stature; None for the user's.
    """

    clip: str
    agent: str
    sensors: str = "H+2C"
    terrain: str = "flat"
    roughness: float = 1.0
    height_m: float = DEFAULT_HEIGHT_M
    speed: float = 1.0
    object: str = "none"
    avatar_height_m: float | None = None

    @property
    def avatar_m(self) -> float:
        """The avatar's stature in metres."""
        return self.height_m if self.avatar_height_m is None else self.avatar_height_m


@dataclass(frozen=True)
class Choices:
    """The values that a viewer can choose from; ``sensors`` are those the agent can use."""

    clips: tuple[str, ...]
    agents: tuple[str, ...]
    sensors: tuple[str, ...]
    terrains: tuple[str, ...] = ("flat",)
    objects: tuple[str, ...] = ("none",)


@dataclass
class Trace:
    """The last seconds of a session as curves.

    Attributes:
        seconds: length of the history.
        rows: time since the first row (s), error (cm), force on the left and right foot (N).
    """

    seconds: float = 10.0
    rows: list[tuple[float, float, float, float]] = field(default_factory=list)

    def add(self, snapshot: Snapshot, fps: float) -> None:
        """Append a moment; moments that were already appended are ignored."""
        time = snapshot.step / fps
        if self.rows and time <= self.rows[-1][0]:
            return
        left, right = np.linalg.norm(snapshot.contact_force, axis=-1)
        self.rows.append((time, 100.0 * snapshot.error_m, float(left), float(right)))
        while self.rows[0][0] < time - self.seconds:
            self.rows.pop(0)

    def columns(self) -> tuple[np.ndarray, ...]:
        """Times, errors and both forces, ``(n,)`` each."""
        return tuple(np.array(column) for column in zip(*self.rows, strict=True))


class Session(Protocol):
    """A simulation that can be watched and controlled. Any thread may call its methods."""

    @property
    def settings(self) -> Settings:
        """The current settings."""
        ...

    @property
    def choices(self) -> Choices:
        """The values that can currently be chosen."""
        ...

    def snapshot(self) -> Snapshot:
        """The current moment."""
        ...

    def change(self, **settings: Any) -> Settings:
        """Change some settings. If one raises an ``InputError``, none of them is changed."""
        ...

    def pause(self, paused: bool) -> None:
        """Pause or resume the simulation."""
        ...

    def step_once(self) -> None:
        """Pause, then advance by one step."""
        ...

    def restart(self) -> None:
        """Restart the clip."""
        ...

    def push(self, force_n: float, direction_deg: float) -> None:
        """Push the avatar's chest briefly: 0 degrees pushes it forwards, 90 to its left."""
        ...
