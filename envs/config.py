"""Options of an environment in one dataclass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from envs.checks import Form, check_forms, is_number, is_whole
from envs.objects import WorldObject
from envs.pushes import Pushes
from envs.randomisation import MAX_UNSCALED_M, Randomisation
from envs.starts import Starts
from envs.terrain import Terrain
from questsim.bodies import OwnBody
from questsim.body import MAX_HEIGHT_M, MIN_HEIGHT_M, PRESETS
from questsim.errors import InputError
from questsim.reward import RewardConfig
from questsim.sensors import DEVICES, SENSOR_SETS, SensorNoise

MAX_FUTURE_FRAMES = 6
MAX_ERROR_M = 1e6
MAX_SPREAD = 0.15
SAMPLING = ("uniform", "failure", "kind")

_SETTINGS = "a mapping of its fields"


def _or_none(kind: type, other: str = _SETTINGS) -> Form:
    """None or an instance of a class; ``gym.make`` takes ``other`` instead of the instance."""
    return Form(f"None or {kind.__name__}", lambda v: v is None or isinstance(v, kind), other)


def _two_numbers(value: Any) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and all(map(is_number, value))


def _devices(value: Any) -> bool:
    if not (isinstance(value, tuple) and len(value) == 2):
        return False
    return isinstance(value[0], str) and is_whole(value[1])


_FLAG = Form("True or False", lambda v: isinstance(v, bool | np.bool_))
_METRES = Form("metres", is_number)
_FORMS = {
    "sensors": Form("the name of a sensor set", lambda v: isinstance(v, str)),
    "future_frames": Form("a whole number", is_whole),
    "heights": Form(
        "the least and the greatest stature in metres", lambda v: v is None or _two_numbers(v)
    ),
    "body_preset": Form(f"one of {', '.join(sorted(PRESETS))}", lambda v: v in [*PRESETS]),
    "reward": Form("a RewardConfig", lambda v: isinstance(v, RewardConfig), _SETTINGS),
    "privileged": _FLAG,
    "privileged_frames": Form(
        "whole numbers from 0 on",
        lambda v: isinstance(v, tuple) and all(is_whole(k) and k >= 0 for k in v),
    ),
    "fixed_start": _FLAG,
    "max_error_m": _METRES,
    "self_collision": _FLAG,
    "sampling": Form(f"one of {', '.join(SAMPLING)}", lambda v: v in [*SAMPLING]),
    "noise": _or_none(SensorNoise),
    "terrain": _or_none(Terrain, f"its name with options, such as 'rough:seed=3', or {_SETTINGS}"),
    "height_scan": _FLAG,
    "pushes": _or_none(Pushes, f"the least and the greatest force in newtons, or {_SETTINGS}"),
    "objects": Form(
        "a tuple of WorldObject",
        lambda v: isinstance(v, tuple) and all(isinstance(each, WorldObject) for each in v),
        "names, such as 'ball', or mappings of their fields",
    ),
    "randomisation": _or_none(Randomisation),
    "starts": _or_none(Starts),
    "unscaled_m": _METRES,
    "body": _or_none(OwnBody, "a TOML file, or the name of an included body"),
    "proportions": Form("a number", is_number),
    "observe_proportions": _FLAG,
    "teacher_devices": Form(
        "the name of a sensor set and a number of future frames",
        lambda v: v is None or _devices(v),
    ),
}
"""The accepted values of each field of ``EnvConfig``."""


@dataclass(frozen=True)
class EnvConfig:
    """An environment's options; the defaults are QuestSim's H+2C task.

    Attributes:
        sensors: name of the sensor set whose poses the policy observes; it must have no IMU.
        future_frames: number of future frames in o_user; 0 means the present frame only (no
            latency).
        heights: least and greatest stature in metres, spread evenly over the environments; None
            takes the statures of the clips. A clip is scaled to its environment's body.
        body_preset: ``"default"`` or ``"paper"``, see ``questsim.body``.
        reward: weights and kernels.
        privileged: append the future full-body reference to the observation, for teachers.
        privileged_frames: frames ahead that the privileged part contains.
        fixed_start: for evaluation: environment i plays clip i from its first frame.
        max_error_m: mean distance of the 16 links from the reference at which an episode ends;
            above 0, at most 1e6.
        self_collision: whether the avatar's links collide with each other.
        sampling: how episodes are drawn: ``"uniform"`` over frames; ``"failure"``: clips and
            moments that led to falls more often; ``"kind"``: as ``"failure"``, and rare kinds of
            motion more often.
        noise: sensor noise of the devices, drawn once for each clip.
        terrain: the ground; None for a plane. Each episode draws a place for its clip; with
            ``fixed_start`` a clip always has the same place.
        height_scan: append the heights of the ground around the avatar to the observation.
        pushes: forces on the avatar at random times; None for no pushes.
        objects: objects in the avatar's way.
        randomisation: random differences between the simulations; None for no differences.
        starts: initial states of episodes; None for the state of the reference.
        unscaled_m: stature of the avatar minus that of its user. Device signals and reference are
            those of the user, not scaled to the avatar; errors are measured from the user's links.
        body: a body of the user's own, see ``questsim.bodies``; None for our avatar. Clips are
            retargeted to it, and its users are of its size: no ``unscaled_m``, ``body_preset`` or
            ``proportions``.
        proportions: spread of proportions that are drawn for the avatars, the standard deviation
            of the logarithm of each part, 0 to 0.15; 0 for those of the clips. Each clip is moved
            to one of at most eight bodies, and a simulation plays the clips of its own body.
        observe_proportions: append the avatar's proportions to ``o_scale``.
        teacher_devices: sensor set and number of future frames of a teacher that observes more of
            the user than its student: appends ``o_teacher``, what ``o_user`` would be with them and
            without device errors. None for no such teacher.
    """

    sensors: str = "H+2C"
    future_frames: int = 6
    heights: tuple[float, float] | None = None
    body_preset: str = "default"
    reward: RewardConfig = field(default_factory=RewardConfig)
    privileged: bool = False
    privileged_frames: tuple[int, ...] = (1, 5)
    fixed_start: bool = False
    max_error_m: float = 0.5
    self_collision: bool = False
    sampling: str = "uniform"
    noise: SensorNoise | None = None
    terrain: Terrain | None = None
    height_scan: bool = False
    pushes: Pushes | None = None
    objects: tuple[WorldObject, ...] = ()
    randomisation: Randomisation | None = None
    starts: Starts | None = None
    unscaled_m: float = 0.0
    body: OwnBody | None = None
    proportions: float = 0.0
    observe_proportions: bool = False
    teacher_devices: tuple[str, int] | None = None

    def __post_init__(self) -> None:
        check_forms(self, _FORMS)
        _check_devices(self.sensors, self.future_frames)
        if self.teacher_devices is not None:
            _check_devices(*self.teacher_devices)
        if not abs(self.unscaled_m) <= MAX_UNSCALED_M:
            raise InputError(
                f"unscaled_m is {self.unscaled_m:g}, not within {MAX_UNSCALED_M} m", "EnvConfig"
            )
        if self.heights is not None:
            low, high = self.heights
            if low > high:
                what = f"the least stature, {low:g} m, is above the greatest, {high:g} m"
                raise InputError(what, "heights", "give the least first")
            if not MIN_HEIGHT_M <= low <= high <= MAX_HEIGHT_M:
                given = f"{low:g} m" if low == high else f"{low:g} to {high:g} m"
                within = f"within {MIN_HEIGHT_M} to {MAX_HEIGHT_M} m"
                raise InputError(f"a stature of {given} is not {within}", "heights")
        # With an infinite limit a fallen avatar would lie on the ground until the clip ends.
        if not 0.0 < self.max_error_m <= MAX_ERROR_M:
            raise InputError(
                f"max_error_m is {self.max_error_m:g}, not above 0 and up to {MAX_ERROR_M:g} m",
                "EnvConfig",
            )

        if not 0.0 <= self.proportions <= MAX_SPREAD:
            raise InputError(
                f"proportions is {self.proportions:g}, not 0 to {MAX_SPREAD:g}", "EnvConfig"
            )
        if self.proportions and self.terrain is not None:
            raise InputError("does not go with a terrain", "proportions", "leave one out")
        if self.proportions and self.starts is not None and self.starts.estimate > 0.0:
            raise InputError("does not go with starts.estimate", "proportions", "leave one out")
        if self.body is not None:
            _check_own_body(self)

    @property
    def frame_offsets(self) -> tuple[int, ...]:
        """Frames ahead of the present that o_user contains."""
        return offsets_of(self.future_frames)


def offsets_of(future_frames: int) -> tuple[int, ...]:
    """Frames ahead of the present that are observed: the future ones, or only the present one."""
    return tuple(range(1, future_frames + 1)) or (0,)


def _check_devices(sensors: str, future_frames: int) -> None:
    """Reject sensors that a policy cannot observe, and too many future frames."""
    imus = {name: _imus(devices) for name, devices in SENSOR_SETS.items()}
    fix = f"choose from {', '.join(name for name in imus if not imus[name])}"
    if sensors not in imus:
        raise InputError(f"unknown sensor set {sensors!r}", "sensors", fix)
    if imus[sensors]:
        # An IMU does not measure its position, so the policy must not observe it.
        what = f"sensor set {sensors!r} has {imus[sensors][0]}, which reports no pose"
        raise InputError(what, "sensors", fix)
    if not 0 <= future_frames <= MAX_FUTURE_FRAMES:
        raise InputError(
            f"future_frames is {future_frames}, not 0 to {MAX_FUTURE_FRAMES}", "EnvConfig"
        )


def _imus(devices: Sequence[str]) -> list[str]:
    return [name for name in devices if DEVICES[name].kind == "imu"]


_ONE_SIZE = "users have the size and proportions of the body"
_NOT_OWN = {
    "unscaled_m": _ONE_SIZE,
    "proportions": _ONE_SIZE,
    "observe_proportions": _ONE_SIZE,
    "body_preset": "masses, limits and damping are those of its MJCF",
}
"""Options of our avatar alone, each with the reason."""


def _check_own_body(config: EnvConfig) -> None:
    """Reject what only our avatar can do."""
    plain = EnvConfig()
    for name, reason in _NOT_OWN.items():
        if getattr(config, name) != getattr(plain, name):
            raise InputError(
                f"{name} does not go with a body of your own: {reason}",
                "EnvConfig",
                f"leave {name} out",
            )
    if config.randomisation is not None and any(config.randomisation.unscaled_m):
        raise InputError(
            f"randomisation.unscaled_m does not go with a body of your own: {_ONE_SIZE}",
            "EnvConfig",
            "leave it out",
        )
    if config.starts is not None and config.starts.estimate > 0.0:
        raise InputError(
            "starts.estimate does not go with a body of your own",
            "EnvConfig",
            "kinematic systems estimate our avatar",
        )
