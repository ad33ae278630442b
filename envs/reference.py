"""All reference clips as rows of flat arrays for the compiled kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from envs.avatar import Avatar, avatar_of
from envs.config import EnvConfig
from envs.footsteps import Footsteps, footsteps_of
from envs.kernel_arguments import ReferencePoses, ReferenceRows
from questsim.errors import InputError, value_text
from questsim.motion.clip import Clip
from questsim.sensors import device_poses, sensor_set

if TYPE_CHECKING:
    from envs.own_legs import OwnFeet

_SAME_HEIGHT_M = 0.002


@dataclass(frozen=True)
class Reference:
    """``F`` frames of all clips, one clip after the other, on the avatar of 1.75 m.

    With a body of the user's own on that body, with its links and hinges.

    Attributes:
        names, kinds: name and kind of each clip.
        weights: ``(C,)`` of each clip.
        heights: ``(C,)`` stature in metres of each clip's own body.
        start, end: ``(C,)`` first row of each clip, and one past its last.
        qpos, qvel: ``(F, 40)``, ``(F, 39)``.
        position, quat, velocity, angular_velocity: ``(F, 16, ...)``.
        torque: ``(F, 33)`` inverse-dynamics torques as shares of the joints' limits; ``(0, 33)``
            unless the config is privileged.
        steps: stance phases of the feet; empty on a plane, which does not need them.
        dev_position, dev_quat: ``(F, D, ...)`` poses of the devices that the policy observes.
        teacher_position, teacher_quat: the same of ``teacher_devices``; ``(F, 0, ...)`` without.
        own: legs of a body of the user's own, and the avatar's links on it; None for the avatar
            and on a plane.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    weights: np.ndarray
    heights: np.ndarray
    start: np.ndarray
    end: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    position: np.ndarray
    quat: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray
    torque: np.ndarray
    steps: Footsteps
    dev_position: np.ndarray
    dev_quat: np.ndarray
    teacher_position: np.ndarray
    teacher_quat: np.ndarray
    own: OwnFeet | None = None

    @property
    def poses(self) -> ReferencePoses:
        """What ``footing.fill`` reads."""
        return ReferencePoses(self.qpos, self.position, self.quat, self.steps)

    @property
    def rows(self) -> ReferenceRows:
        """Velocities and torques, for the kernels of observation and reward."""
        return ReferenceRows(self.qvel, self.velocity, self.angular_velocity, self.torque)

    @staticmethod
    def of(clips: Sequence[Clip], config: EnvConfig, seed: int) -> Reference:
        """Pack clips and the device poses, with the config's sensor noise.

        Raises:
            InputError: there are no clips, or one is shorter than the future window.
        """
        if not clips:
            raise InputError("there are no clips", "motions")
        needed = max(config.future_frames, 1) + 1
        for clip in clips:
            if len(clip) < needed:
                raise InputError(
                    f"clip has {len(clip)} frames at 36 Hz, fewer than the {needed} that "
                    f"{config.future_frames} future frames need",
                    clip.name,
                    "leave it out or lower future_frames",
                )
        ends = np.cumsum([len(clip) for clip in clips])
        avatar = avatar_of(config.body)
        common = avatar.clips(clips, config.body)
        devices = [_devices(clip, config, seed, i) for i, clip in enumerate(common)]
        of_teacher = [_teacher_devices(clip, config) for clip in common]

        def rows(arrays: Sequence[np.ndarray]) -> np.ndarray:
            # One memory layout, so that the loops are compiled only once.
            return np.ascontiguousarray(np.concatenate(arrays), np.float32)

        return Reference(
            names=tuple(clip.name for clip in clips),
            kinds=tuple(clip.kind for clip in clips),
            weights=np.array([clip.weight for clip in clips]),
            heights=np.array([clip.height_m for clip in (common if avatar.own else clips)]),
            start=ends - [len(clip) for clip in clips],
            end=ends,
            qpos=rows([clip.qpos for clip in common]),
            qvel=rows([clip.qvel for clip in common]),
            position=rows([clip.link_position for clip in common]),
            quat=rows([clip.link_quat for clip in common]),
            velocity=rows([clip.link_velocity for clip in common]),
            angular_velocity=rows([clip.link_angular_velocity for clip in common]),
            torque=_torques(avatar, common, config),
            steps=footsteps_of(common if config.terrain is not None and avatar.own is None else ()),
            dev_position=rows([position for position, _ in devices]),
            dev_quat=rows([quat for _, quat in devices]),
            teacher_position=rows([position for position, _ in of_teacher]),
            teacher_quat=rows([quat for _, quat in of_teacher]),
            own=_own_feet(config, common),
        )


def _own_feet(config: EnvConfig, clips: Sequence[Clip]) -> OwnFeet | None:
    if config.body is None or config.terrain is None:
        return None
    from envs.own_legs import own_feet  # late: few tasks have such a body

    return own_feet(config.body, clips)


def check_are_clips(clips: Any, where: str) -> None:
    """Reject what is not a sequence of clips.

    Raises:
        InputError: with the name of the argument.
    """
    if not isinstance(clips, Sequence) or isinstance(clips, str):
        raise InputError(f"is {value_text(clips)}; it takes a list of clips", where)
    for number, clip in enumerate(clips):
        if not isinstance(clip, Clip):
            raise InputError(f"is {value_text(clip)}, not a Clip", f"{where}[{number}]")


def check_shown(clips: Sequence[Clip], shown: Sequence[Clip]) -> None:
    """Check that each clip can be observed instead of the one at its place in ``clips``.

    Raises:
        InputError: a clip of another length, stature or proportions, or another number of clips.
    """
    if len(clips) != len(shown):
        raise InputError(f"has {len(shown)} clips, motions have {len(clips)}", "shown")
    for clip, other in zip(clips, shown, strict=True):
        if clip.proportions != other.proportions:
            what = "is shown for a clip of other proportions"
            raise InputError(what, other.name, "give a clip that was made from that one")
        if len(clip) != len(other) or abs(clip.height_m - other.height_m) > _SAME_HEIGHT_M:
            raise InputError(
                f"{len(other)} frames of {other.height_m:.3f} m are shown for {len(clip)} of "
                f"{clip.height_m:.3f} m",
                clip.name,
                "give a clip that was made from this one",
            )


def _torques(avatar: Avatar, clips: Sequence[Clip], config: EnvConfig) -> np.ndarray:
    if not config.privileged:
        return np.zeros((0, len(avatar.dofs)), np.float32)
    # Imported late: only teachers need them, and they import an optimiser.
    if config.body is not None:
        from questsim.bodies.torques import own_torques

        return own_torques(config.body, clips)
    from questsim.motion.inverse_dynamics import reference_torques

    return reference_torques(clips, config.body_preset)


def _devices(clip: Clip, config: EnvConfig, seed: int, index: int) -> tuple[np.ndarray, np.ndarray]:
    position, quat = _exact_devices(clip, config, config.sensors)
    if config.noise is None:
        return position, quat
    return config.noise.apply(position, quat, np.random.default_rng([seed, index]))


def _teacher_devices(clip: Clip, config: EnvConfig) -> tuple[np.ndarray, np.ndarray]:
    if config.teacher_devices is None:
        return np.zeros((len(clip), 0, 3)), np.zeros((len(clip), 0, 4))
    return _exact_devices(clip, config, config.teacher_devices[0])


def _exact_devices(clip: Clip, config: EnvConfig, sensors: str) -> tuple[np.ndarray, np.ndarray]:
    links = avatar_of(config.body).our_links(clip.link_position, clip.link_quat, clip.height_m)
    return device_poses(*links, sensor_set(sensors), clip.height_m)
