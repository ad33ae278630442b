"""A live simulation of one avatar that viewers can watch and control."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from agents.live.drivers import Driver
from agents.live.options import GROUNDS, NOTHING
from agents.live.surroundings import (
    in_own_size,
    needed_object,
    object_pose,
    session_config,
)
from envs.core import BatchSim
from envs.objects import OBJECTS, shapes_of
from questsim import rotations as rot
from questsim.body import MAX_HEIGHT_M, MIN_HEIGHT_M
from questsim.errors import InputError, did_you_mean
from questsim.motion.clip import FPS, Clip
from questsim.sensors import device_poses, sensor_set
from questsim.skeleton import NUM_DOFS
from questsim.viewing.live import ROUGHNESS, SPEEDS, Choices, Scenery, Settings, Snapshot

AFTER_FALL_S, AFTER_END_S = 2.0, 0.7
"""Time in s between the end of an episode and the restart of the clip."""

SEEN_M = 14.0
"""Distance in m around the clip's path within which the ground is shown."""

PUSH_S = 0.2
MAX_PUSH_N = 1000.0
_AVATAR = 7 + NUM_DOFS


class DemoSession:
    """One avatar that follows clips; any number of threads may change its settings.

    Settings change at once, between two steps. An impossible change raises ``InputError`` and
    leaves the session unchanged.

    Args:
        clips: the available clips; names are unique.
        drivers: by name, functions that create a driver; each is called once.
        settings: initial settings; empty sensors mean the agent's own.

    Attributes:
        notes: text to show beside an agent's name, by name.
    """

    def __init__(
        self,
        clips: Sequence[Clip],
        drivers: Mapping[str, Callable[[], Driver]],
        settings: Settings,
    ) -> None:
        if not clips:
            raise InputError("there are no clips", "--motions")
        self._clips = {clip.name: clip for clip in clips}
        self._make_driver = dict(drivers)
        self._drivers: dict[str, Driver] = {}
        self._lock = threading.RLock()
        if not settings.sensors:
            settings = replace(settings, sensors=self._driver(settings.agent).needs.sensors)
        self._settings = settings
        self._scenery = Scenery(0)
        self._step, self._begun = 0, 0
        self._outcome, self._hold = "", 0
        self._paused, self._one_step = False, False
        self.notes: dict[str, str] = {}
        self._sim: BatchSim = self._build(settings)

    # -- read by viewers -------------------------------------------------------------------

    @property
    def settings(self) -> Settings:
        """The present settings."""
        return self._settings

    @property
    def choices(self) -> Choices:
        """The choices available now."""
        return Choices(
            clips=tuple(self._clips),
            agents=tuple(self._make_driver),
            sensors=self._driver(self._settings.agent).sensor_sets(),
            terrains=GROUNDS,
            objects=(NOTHING, *OBJECTS),
        )

    def playlist(self) -> list[str]:
        """Names of the present clip, then of one clip of each other kind of motion, then the rest.

        The middle clip of each kind is used, since libraries often begin and end with extremes.
        """
        present = self._clips[self._settings.clip]
        kinds: dict[str, list[str]] = {present.kind: []}
        for clip in self._clips.values():
            kinds.setdefault(clip.kind, []).append(clip.name)
        firsts = [present.name]
        firsts += [names[len(names) // 2] for kind, names in kinds.items() if kind != present.kind]
        return list(dict.fromkeys([*firsts, *self._clips]))

    def snapshot(self) -> Snapshot:
        """The present moment; its arrays are copies."""
        with self._lock:
            sim = self._sim
            clip = self._placed
            now = int(sim.frame[0] - sim.reference.start[0])
            devices = device_poses(
                clip.link_position[now],
                clip.link_quat[now],
                sensor_set(self._settings.sensors),
                clip.height_m,
            )
            return Snapshot(
                scenery=self._scenery,
                step=self._step,
                time_s=now / FPS,
                duration_s=clip.duration,
                position=sim.link_positions[0].copy(),
                quat=sim.link_quats[0].copy(),
                reference_position=self._user_position[now],
                reference_quat=clip.link_quat[now],
                device_position=devices[0],
                device_quat=devices[1],
                contact_force=sim.contact_force[0].copy(),
                qpos=sim.qpos[0, :_AVATAR].copy(),
                reference_qpos=self._user_qpos[now],
                error_m=float(sim.error[0]) if now else 0.0,
                push_n=sim.pusher.force[0].copy(),
                object_pose=object_pose(sim) if self._scenery.parts else None,
                outcome=self._outcome,
                paused=self._paused,
                note=self.notes.get(self._settings.agent, ""),
                physics=self._present.physics,
            )

    # -- called by viewers -------------------------------------------------------------------

    def change(self, **settings: Any) -> Settings:
        """Change settings and restart the clip, unless only the speed changes.

        Sensors that a new agent cannot use are replaced by its own. If the object is the one that
        the clip needs (a chair or none), it changes to what the next clip needs. An avatar with
        its user's height keeps the user's height.

        Raises:
            InputError: no such setting, or its value cannot be used.
        """
        with self._lock:
            unknown = set(settings) - {field.name for field in fields(Settings)}
            if unknown:
                raise InputError("there is no such setting", ", ".join(sorted(unknown)))
            wanted = replace(self._settings, **settings)
            if wanted.avatar_height_m == wanted.height_m:
                wanted = replace(wanted, avatar_height_m=None)
            if wanted == self._settings:
                return wanted
            if "object" not in settings and self._settings.object == self._needed(self._settings):
                wanted = replace(wanted, object=self._needed(wanted))
            if wanted != replace(self._settings, speed=wanted.speed):
                driver = self._driver(wanted.agent)
                if "sensors" not in settings and wanted.sensors not in driver.sensor_sets():
                    wanted = replace(wanted, sensors=driver.needs.sensors)
            self._check(wanted)
            if wanted != replace(self._settings, speed=wanted.speed):
                self._sim = self._build(wanted)
            self._settings = wanted
            return wanted

    def pause(self, paused: bool) -> None:
        """Pause or continue."""
        with self._lock:
            self._paused, self._one_step = bool(paused), False

    def step_once(self) -> None:
        """Pause; the next ``advance`` makes one step."""
        with self._lock:
            self._paused, self._one_step = True, True

    def restart(self) -> None:
        """Restart the clip."""
        with self._lock:
            self._begin(self._sim)

    def push(self, force_n: float, direction_deg: float) -> None:
        """Push the chest for 0.2 s: 0 degrees pushes the avatar forwards, 90 to its left.

        Raises:
            InputError: the force is not between 0 and 1000 N, the direction is not a number, or
                the agent has no physics.
        """
        force_n, direction_deg = _number(force_n, "push"), _number(direction_deg, "direction")
        if not 0.0 <= force_n <= MAX_PUSH_N:
            raise InputError(f"a push of {force_n:g} N is not within 0 and {MAX_PUSH_N:g} N")
        with self._lock:
            if not self._present.physics:
                agent = self._settings.agent
                raise InputError(f"{agent} has no physics and cannot be pushed")
            yaw = float(rot.heading(self._sim.link_quats[:1, 0])[0]) + np.radians(direction_deg)
            force = force_n * np.array([np.cos(yaw), np.sin(yaw), 0.0])
            self._sim.pusher.push(0, force, PUSH_S)

    def replace_driver(self, name: str, driver: Driver, note: str = "") -> None:
        """Replace the driver of the same name, at once if it is the current one.

        Raises:
            InputError: it does not fit; the previous one stays.
        """
        with self._lock:
            before = self._drivers.get(name)
            self._drivers[name] = driver
            try:
                if self._settings.agent == name:
                    self._take_up(driver)
            except InputError:
                if before is not None:
                    self._drivers[name] = before
                raise
            self.notes[name] = note

    def _take_up(self, driver: Driver) -> None:
        """Use a driver from now on; restart the clip if it needs another environment."""
        settings = self._settings
        if settings.sensors not in driver.sensor_sets():
            settings = replace(settings, sensors=driver.needs.sensors)
        if session_config(driver, settings) == self._sim.config:
            driver.bind(self._sim, settings.sensors)
            driver.reset()
            self._settings = settings
            return
        self._sim = self._build(settings)
        self._settings = settings

    # -- the simulation ------------------------------------------------------------------------

    def advance(self) -> bool:
        """Advance by 1/36 s unless paused; returns whether time advanced."""
        with self._lock:
            if self._paused and not self._one_step:
                return False
            self._one_step = False
            sim = self._sim
            if self._outcome:
                self._hold -= 1
                if self._hold < 0:
                    self._begin(sim)
                    self._step += 1
                    return True
            self._present.advance(sim)
            self._step += 1
            self._judge(sim)
            return True

    def _judge(self, sim: BatchSim) -> None:
        if self._outcome:
            return
        # Inaccurate poses are not a fall: the estimate may recover.
        physics = self._present.physics
        if physics and sim.fell[0]:
            self._outcome, self._hold = "fell", round(AFTER_FALL_S * FPS)
        elif sim.ended[0] or (not physics and sim.frame[0] >= sim.reference.end[0] - 1):
            self._outcome, self._hold = "completed", round(AFTER_END_S * FPS)

    def _begin(self, sim: BatchSim) -> None:
        """The clip's first frame."""
        sim.reset()
        self._placed = sim.placed_clip(0, self._clips[self._settings.clip])
        self._user_position, self._user_qpos = in_own_size(
            self._placed, sim.placement.field, float(self._settings.height_m)
        )
        self._present.reset()
        self._outcome, self._hold = "", 0

    @property
    def _present(self) -> Driver:
        """The current driver."""
        return self._drivers[self._settings.agent]

    def _driver(self, name: str) -> Driver:
        if name not in self._make_driver:
            known = ", ".join(self._make_driver)
            raise InputError(f"there is no agent {name!r}", fix=f"choose from {known}")
        if name not in self._drivers:
            self._drivers[name] = self._make_driver[name]()
        return self._drivers[name]

    def _needed(self, settings: Settings) -> str:
        """The object that the settings' clip needs."""
        clip = self._clips.get(settings.clip)
        return NOTHING if clip is None else needed_object(clip)

    def _check(self, settings: Settings) -> None:
        """Refuse settings that cannot be simulated.

        Raises:
            InputError: names the setting.
        """
        check_clip(settings.clip, self._clips)
        usable = self._driver(settings.agent).sensor_sets()
        if settings.sensors not in usable:
            raise InputError(
                f"{settings.agent} cannot use sensors {settings.sensors!r}",
                fix=f"choose from {', '.join(usable)}",
            )
        check_choices(settings)
        if settings.speed not in SPEEDS:
            raise InputError(f"speed {settings.speed!r} is not one of {SPEEDS}")

    def _build(self, settings: Settings) -> BatchSim:
        """A simulation of the settings, at the clip's first frame."""
        self._check(settings)
        driver = self._driver(settings.agent)
        config = session_config(driver, settings)
        clip = self._clips[settings.clip]
        shown = driver.shown(clip, settings.sensors)
        sim = BatchSim([clip], config, 1, num_threads=1, shown=shown)
        driver.bind(sim, settings.sensors)
        self._settings = settings
        self._begin(sim)
        field = sim.placement.field
        ground = None if field is None else field.around(self._placed.qpos[:, :2], SEEN_M)
        self._scenery = Scenery(
            self._scenery.number + 1,
            float(settings.avatar_m),
            ground,
            shapes_of(config.objects[0], float(sim.heights[0])) if config.objects else (),
            float(settings.height_m),
        )
        return sim


def check_clip(name: str, clips: Iterable[str]) -> None:
    """Refuse a clip that is not among these names.

    Raises:
        InputError: with the nearest name.
    """
    clips = list(clips)
    if name not in clips:
        fix = f"{did_you_mean(name, clips)}questsim motions list names the clips"
        raise InputError(f"there is no clip {name!r}", fix=fix)


def check_choices(settings: Settings) -> None:
    """Refuse heights, grounds, objects and roughness that no session has.

    Raises:
        InputError: names the setting.
    """
    for what, value in (("height", settings.height_m), ("avatar height", settings.avatar_m)):
        height = _number(value, what)
        if not MIN_HEIGHT_M <= height <= MAX_HEIGHT_M:
            limits = f"{MIN_HEIGHT_M}-{MAX_HEIGHT_M} m"
            raise InputError(f"{what} {height:g} m is not within {limits}")
    if settings.terrain not in GROUNDS:
        known = ", ".join(GROUNDS)
        raise InputError(f"there is no terrain {settings.terrain!r}", fix=f"choose from {known}")
    if settings.object not in (NOTHING, *OBJECTS):
        known = ", ".join(OBJECTS)
        raise InputError(f"there is no object {settings.object!r}", fix=f"choose from {known}")
    roughness = _number(settings.roughness, "roughness")
    if not ROUGHNESS[0] <= roughness <= ROUGHNESS[1]:
        raise InputError(
            f"roughness {roughness:g} is not within {ROUGHNESS[0]:g} and {ROUGHNESS[1]:g}"
        )


def _number(value: Any, what: str) -> float:
    """A finite number.

    Raises:
        InputError: it is not a finite number.
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = np.nan
    if not np.isfinite(number):
        raise InputError(f"{what} {value!r} is not a number")
    return number
