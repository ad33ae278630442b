"""HMD-Poser and LGSIK-Poser on a stream: LSTM states, the estimated body, windows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from agents.kinematic.interface import DeviceSignals, KinematicSystem, Poses, UserBody
from agents.kinematic.learning import begin_at_rest
from agents.kinematic.recurrent.assembly import assembled
from agents.kinematic.recurrent.features import DEVICES, features
from agents.kinematic.recurrent.hmdposer import HmdPoserNet, HmdPoserSpec
from agents.kinematic.recurrent.lgsik import SHAPE_INPUTS, LgsikNet, LgsikSpec
from agents.kinematic.small_batch import linear
from questsim import rotations as rot
from questsim.errors import InputError
from questsim.joint_sensors import SensorSequence
from questsim.proportions import NUM_BONES, bone_of_joint, measurements
from questsim.skeleton import NUM_JOINTS

SHAPE_UNIT = 0.1
"""Unit of shape values, which are logarithms of bone lengths relative to the template's."""
WINDOWS_AT_ONCE = 64
"""Windows per batch in the online protocol; more use more memory without saving time."""
VISIBLE = ((False, False, False), (True, True, False), (True, True, True))
"""Presence of the three IMUs: HMD, HMD+2IMU, HMD+3IMU; training draws them equally often."""

_BONE_OF_JOINT = torch.as_tensor(bone_of_joint())

RecurrentSpec = HmdPoserSpec | LgsikSpec


class RecurrentModule(nn.Module):
    """A network and the mean body that its shape values refer to.

    Args:
        spec: spec of HMD-Poser or LGSIK-Poser.
    """

    template: Tensor

    def __init__(self, spec: RecurrentSpec) -> None:
        super().__init__()
        self.net = HmdPoserNet(spec) if isinstance(spec, HmdPoserSpec) else LgsikNet(spec)
        self.register_buffer("template", torch.zeros(NUM_JOINTS, 3))
        for layer in self.net.last_layers():
            begin_at_rest(layer)
            layer.weight.data.mul_(0.1)

    def body_inputs(self, offsets: np.ndarray) -> Tensor:
        """``(B, 11)``: open gender, then lengths relative to the template's, in units of 0.1."""
        mean = measurements(self.template.numpy())
        known = (measurements(offsets) / mean - 1.0) / SHAPE_UNIT
        empty = np.zeros((len(offsets), SHAPE_INPUTS - known.shape[-1]))
        return torch.as_tensor(np.concatenate([empty, known], axis=-1), dtype=torch.float32)

    def bones(self, shape: Tensor) -> Tensor:
        """Offsets ``(..., 22, 3)`` from shape values ``(..., 16)``."""
        scales = torch.exp((SHAPE_UNIT * shape).clamp(-0.7, 0.7))
        scales = torch.cat([scales, torch.ones_like(scales[..., :1])], dim=-1)
        return self.template * scales[..., _BONE_OF_JOINT, None]


class RecurrentPoser(KinematicSystem):
    """HMD-Poser or LGSIK-Poser on a stream.

    Args:
        module: a trained module.
        name: for messages.
    """

    devices = DEVICES
    required = DEVICES[:3]

    def __init__(self, module: RecurrentModule, name: str) -> None:
        self.name, self.module = name, module
        module.eval()
        _compile()

    def usable(self, sensors: str | Sequence[str]) -> tuple[str, ...]:
        """Like ``KinematicSystem.usable``; allowed IMUs: none, both knees, or knees and pelvis."""
        names = super().usable(sensors)
        if tuple(name in names for name in DEVICES[3:]) not in VISIBLE:
            raise InputError(
                f"{self.name} takes no IMUs, both knees, or both knees and the pelvis", "sensors"
            )
        return names

    def _begin(self, body: UserBody) -> None:
        assert self._names is not None
        there = [name in self._names for name in DEVICES]
        self._worn = np.flatnonzero(there)
        self._columns = np.array([self._names.index(DEVICES[i]) for i in self._worn])
        self._seen = torch.tensor([there[3:]])
        self._measured = self.module.body_inputs(body.offsets[None])
        self._body = body
        self._states: Any = None
        self._before: tuple[Tensor, Tensor, Tensor] | None = None
        self._shape_sum, self._count = torch.zeros(NUM_BONES), 0

    def _inputs(self, signals: DeviceSignals) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Signals in the order of ``DEVICES`` with a batch of one, and the present IMUs."""
        frames, worn, at = len(signals.position), self._worn, self._columns
        rotation = np.broadcast_to(np.eye(3, dtype=np.float32), (frames, len(DEVICES), 3, 3)).copy()
        rotation[:, worn] = rot.quat_to_matrix(signals.quat[:, at])
        acceleration = np.zeros((frames, 3, 3), np.float32)
        acceleration[:, worn[3:] - 3] = signals.acceleration[:, at[3:]]
        position = signals.position[:, at[:3]].astype(np.float32)
        moved, turned, pulled = map(torch.from_numpy, (position, rotation, acceleration))
        return moved[None], turned[None], pulled[None], self._seen

    @torch.no_grad()
    def _next(self, signals: DeviceSignals) -> Poses:
        position, rotation, acceleration, seen = self._inputs(signals)
        now = (position, rotation, acceleration)
        # Prepend the previous frame for velocities; a stream's first frame is repeated.
        first = (position[:, :1], rotation[:, :1], acceleration[:, :1])
        before = self._before if self._before is not None else first
        joined = [torch.cat(pair, dim=1) for pair in zip(before, now, strict=True)]
        inputs, heading = features(joined[0], joined[1], joined[2], seen)
        self._before = (position[:, -1:], rotation[:, -1:], acceleration[:, -1:])
        six, shape, self._states = self.module.net(inputs[:, 1:], self._measured, self._states)
        total = shape[0].cumsum(0) + self._shape_sum
        count = self._count + torch.arange(1, len(total) + 1)
        self._shape_sum, self._count = total[-1], int(count[-1])
        return self._poses(six[0], total / count[:, None], heading[0, 1:], position[0, :, 0])

    def _poses(self, six: Tensor, shape: Tensor, heading: Tensor, head: Tensor) -> Poses:
        """Poses ``T`` on the mean estimated body so far, with the head at its measured position.

        If the user's stature is known, the body is scaled to agree with it.
        """
        offsets = self._body.bounded(self.module.bones(shape).numpy())
        root, quat = assembled(six.numpy(), heading.numpy(), head.numpy(), offsets)
        return Poses(root, quat, offsets.astype(float))

    @torch.no_grad()
    def predict_windows(self, sequence: SensorSequence, body: UserBody, frames: int) -> Poses:
        """Estimate each frame from its last ``frames`` frames alone, with LSTM states from zero.

        This is LGSIK-Poser's online protocol. Shape values are means over the window. The first
        windows are shorter.

        Args:
            sequence: as in ``predict``, without gaps.
            body: the user's body.
            frames: frames per window.

        Raises:
            InputError: the sequence has a gap or only one frame, or see ``step``.
        """
        signals = self._all_signals(sequence, body)
        if signals is None:
            raise InputError("a sequence has gaps or only one frame", self.name)
        first = DeviceSignals(*(array[:frames] for array in vars(signals).values()))
        # For windows that start with the sequence, the result equals that of the stream.
        parts = [self._next(first)]
        position, rotation, acceleration, seen = self._inputs(signals)
        for begin in range(1, len(sequence) - frames + 1, WINDOWS_AT_ONCE):
            end = min(begin + WINDOWS_AT_ONCE, len(sequence) - frames + 1)
            rows = torch.arange(begin, end)[:, None] + torch.arange(frames)
            inputs, heading = features(
                position[0, rows],
                rotation[0, rows],
                acceleration[0, rows],
                seen.expand(len(rows), -1),
            )
            six, shape, _ = self.module.net(inputs, self._measured.expand(len(rows), -1), None)
            head = position[0, rows[:, -1], 0]
            parts.append(self._poses(six[:, -1], shape.mean(dim=1), heading[:, -1], head))
        return Poses.joined(parts)

    def predict(self, sequence: SensorSequence, body: UserBody) -> Poses:
        """Like ``KinematicSystem.predict``; all frames at once if the stream has no gap."""
        signals = self._all_signals(sequence, body)
        if signals is None:
            return super().predict(sequence, body)
        poses = self._next(signals)
        return poses if poses.finite() else super().predict(sequence, body)


def _compile() -> None:
    """Compile the stream's functions in advance: takes seconds once, then cached on disk."""
    with torch.no_grad():
        linear(torch.zeros(1, 1), torch.zeros(1, 1), torch.zeros(1))
    place, turn = torch.zeros(1, 1, 3, 3), torch.eye(3).expand(1, 1, len(DEVICES), 3, 3)
    features(place, turn, place, torch.zeros(1, 3, dtype=torch.bool))
    pose = np.zeros((1, NUM_JOINTS, 6))
    assembled(pose, np.eye(3)[None], np.zeros((1, 3)), pose[..., :3])
