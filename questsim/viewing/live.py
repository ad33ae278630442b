"""What a running simulation shows to those who watch it, and what they may ask of it.

Viewers know a simulation only by this: what is behind it, agents and environments, is in
``agents/live``.
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
"""Of force arrows: a foot that carries 70 kg has one of 46 cm."""
PUSH_SCALE = 5.0
"""Pushes are drawn this much longer: one of 100 N has an arrow of 33 cm."""

_ASIDE_M = 0.14

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0)
"""How fast time may go, as multiples of real time."""

ROUGHNESS = (0.0, 2.0)
"""Least and greatest multiple of a terrain's own relief."""


@dataclass(frozen=True)
class Scenery:
    """What a picture needs that seldom changes.

    Attributes:
        number: grows with every change.
        height_m: the avatar's stature.
        ground: the floor near the clip's path; None for a flat one at z = 0.
        parts: of the object that is there; empty without one.
        user_height_m: the stature of the person that it follows; None for the avatar's.
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
        scenery: what it stands on.
        step: steps since the session began; every snapshot of a moment has one of its own.
        time_s: seconds since the clip's first frame.
        duration_s: of the clip.
        position, quat: ``(16, 3)`` metres and ``(16, 4)`` wxyz, the avatar's links.
        reference_position, reference_quat: the same of the person that it follows, in that
            person's own size.
        device_position, device_quat: ``(D, 3)``, ``(D, 4)`` of the user's devices, as they are
            scaled to the avatar.
        contact_force: ``(2, 3)`` newtons that the floor gives to the left and the right foot.
        qpos, reference_qpos: ``(40,)`` both poses, as pictures take them.
        error_m: mean distance of the links from the reference.
        push_n: ``(3,)`` the force of a push on the chest now, or zeros.
        object_pose: ``(3,)`` where the object is and ``(4,)`` its orientation, or None.
        outcome: ``""``, ``"fell"`` or ``"completed"``.
        paused: whether time stands still.
        note: about the agent, such as the age of its checkpoint.
        physics: whether torques move the avatar; without, it takes poses as they are, there are
            no contact forces, and nothing can push it.
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
    """Where arrows of the forces on both feet and of a push begin and end ``(3, 2, 3)``, metres.

    Those of feet stand beside the leg, which would hide them; a push ends at the chest. No force,
    no length.
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
        clip, agent, sensors, terrain, object: names out of ``Choices``.
        roughness: multiplies what the terrain has of its own, such as ±4 cm of rough ground or
            steps of 8 cm; within ``ROUGHNESS``.
        height_m: the user's stature.
        speed: how fast time goes; 1 is real time.
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
    """The values that a viewer can choose from; ``sensors`` are those the present agent can use."""

    clips: tuple[str, ...]
    agents: tuple[str, ...]
    sensors: tuple[str, ...]
    terrains: tuple[str, ...] = ("flat",)
    objects: tuple[str, ...] = ("none",)


@dataclass
class Trace:
    """The last seconds of a session as curves.

    Attributes:
        seconds: how much is kept.
        rows: time since the first row (s), error (cm), force on the left and right foot (N).
    """

    seconds: float = 10.0
    rows: list[tuple[float, float, float, float]] = field(default_factory=list)

    def add(self, snapshot: Snapshot, fps: float) -> None:
        """Take in a moment; moments that were taken in already are left out."""
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
    """A simulation that can be watched and controlled; every method from any thread."""

    @property
    def settings(self) -> Settings:
        """The present settings."""
        ...

    @property
    def choices(self) -> Choices:
        """What can be chosen now."""
        ...

    def snapshot(self) -> Snapshot:
        """The present moment."""
        ...

    def change(self, **settings: Any) -> Settings:
        """Change some settings; all of them or, after an ``InputError``, none."""
        ...

    def pause(self, paused: bool) -> None:
        """Let time stand still or go on."""
        ...

    def step_once(self) -> None:
        """Pause, and go on by one step."""
        ...

    def restart(self) -> None:
        """Begin the clip again."""
        ...

    def push(self, force_n: float, direction_deg: float) -> None:
        """Push the avatar's chest for a moment: 0 degrees pushes it forwards, 90 to its left."""
        ...
