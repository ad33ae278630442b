"""Shared parts of HMD-Poser and LGSIK-Poser: streaming with LSTM states, bodies, losses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from agents.kinematic.data import MotionBank, Windows
from agents.kinematic.interface import DeviceSignals, KinematicSystem, Poses, UserBody
from agents.kinematic.learning import Learning, Task
from agents.kinematic.recurrent.assembly import assembled
from agents.kinematic.recurrent.faults import Faults, drawn
from agents.kinematic.recurrent.features import DEVICES, HEAD, SENSOR_JOINTS, features
from agents.kinematic.recurrent.hmdposer import HmdPoserNet, HmdPoserSpec
from agents.kinematic.recurrent.lgsik import SHAPE_INPUTS, LgsikNet, LgsikSpec
from agents.kinematic.small_batch import linear
from agents.precision import products
from questsim import differentiable as diff
from questsim import rotations as rot
from questsim.errors import InputError
from questsim.joint_sensors import SENSOR_FPS, SensorSequence, mount
from questsim.proportions import NUM_BONES, bone_lengths, bone_of_joint, measurements
from questsim.skeleton import JOINTS, NUM_JOINTS

SHAPE_UNIT = 0.1
"""Unit of shape values, which are logarithms of bone lengths relative to the template's."""
HISTORY = 2
"""Number of frames before a window that accelerations need."""
WINDOWS_AT_ONCE = 64
"""Windows per batch in the online protocol; more use more memory without saving time."""
VISIBLE = ((False, False, False), (True, True, False), (True, True, True))
"""Presence of the three IMUs: HMD, HMD+2IMU, HMD+3IMU; training draws them equally often."""

HMDPOSER_WEIGHTS = {
    "root": 1.0, "local": 5.0, "global": 1.0, "joints": 1.0, "acceleration": 0.5, "shape": 0.1,
}  # fmt: skip
"""Published weights of the terms of HMD-Poser's loss, see ``losses``."""

_BONE_OF_JOINT = torch.as_tensor(bone_of_joint())

RecurrentSpec = HmdPoserSpec | LgsikSpec
_Batch = tuple[Windows, Tensor, Faults | None]


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
            # Start training from a straight standing pose.
            layer.bias.data.copy_(torch.tensor([1.0, 0, 0, 0, 1, 0]).repeat(len(layer.bias) // 6))
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
        """Poses ``T`` on the mean estimated body so far, with the head at its measured position."""
        offsets = self.module.bones(shape)
        root, quat = assembled(six.numpy(), heading.numpy(), head.numpy(), offsets.numpy())
        return Poses(root, quat, offsets.double().numpy())

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


# -- training ----------------------------------------------------------------------------------


def training_inputs(
    windows: Windows, seen: Tensor, faults: Faults | None = None
) -> tuple[Tensor, Tensor, Windows]:
    """Features ``(B, T, 135)``, headings and targets, from windows ``HISTORY`` frames longer.

    Accelerations of IMUs have no errors of their own, as in the comparison.
    """
    at = list(SENSOR_JOINTS)
    rotation = windows.world[:, :, at]
    place = windows.position[:, :, at]
    arms = np.array([[mount(n, o).offset for n in DEVICES[3:]] for o in windows.offsets.numpy()])
    arms_there = torch.as_tensor(arms, dtype=torch.float32)[:, None, :, :, None]
    imu = place[:, :, 3:] + (rotation[:, :, 3:] @ arms_there).squeeze(-1)
    acceleration = torch.zeros_like(imu)
    acceleration[:, 2:] = (imu[:, 2:] - 2 * imu[:, 1:-1] + imu[:, :-2]) * SENSOR_FPS**2
    if faults is not None:
        place, rotation = faults.apply(place, rotation)
    inputs, heading = features(place[:, :, :3], rotation, acceleration, seen)
    cut = slice(HISTORY, None)
    target = Windows(
        windows.local[:, cut], windows.world[:, cut], windows.position[:, cut], windows.offsets
    )
    return inputs[:, cut], heading[:, cut], target


def _l1(a: Tensor, b: Tensor) -> Tensor:
    return (a - b).abs().mean()


def _mse(a: Tensor, b: Tensor) -> Tensor:
    return (a - b).square().mean()


def losses(
    module: RecurrentModule,
    six: Tensor,
    shape: Tensor,
    heading: Tensor,
    target: Windows,
    weights: dict[str, float] = HMDPOSER_WEIGHTS,
) -> tuple[Tensor, dict[str, float]]:
    """The published loss of either system, in the frame of the head's heading.

    HMD-Poser, L1: root 1, local 5, global 1, joints 1, acceleration 0.5 (of 100 m/s^2), shape
    consistency 0.1 (``weights``). LGSIK-Poser, MSE: root 10, local 50, global 10, joints 1000,
    sparse joints (root, hands) 1000, shape 10, velocity 5 over lags of 1, 3 and 5 frames. In both
    papers the shape term is consistency in the window alone: bones follow from the loss of the
    joints. Other values of ``LgsikSpec.loss`` supervise bone lengths too, or use HMD-Poser's loss.
    """
    local = diff.six_d_to_matrix(six)
    offsets = module.bones(shape)
    world = diff.world_matrices(local)
    from_root = diff.positions_from_root(world, offsets)
    joints = from_root - from_root[:, :, HEAD : HEAD + 1]
    back = heading.transpose(-1, -2)[:, :, None]
    want_world = back @ target.world
    from_head = target.position - target.position[:, :, HEAD : HEAD + 1]
    want = (back @ from_head[..., None]).squeeze(-1)
    want_six = diff.matrix_to_six_d(target.local[:, :, 1:])
    want_root = diff.matrix_to_six_d(want_world[:, :, 0])
    got_six = diff.matrix_to_six_d(local)
    turned = (heading[:, :, None] @ joints[..., None]).squeeze(-1)
    # Joint paths in the world, without the head's path, which is given.
    moved, want_moved = turned, from_head
    if isinstance(module.net, HmdPoserNet) or module.net.spec.loss == "hmdposer":

        def bend(x: Tensor) -> Tensor:
            return (x[:, 2:] - 2 * x[:, 1:-1] + x[:, :-2]) * (SENSOR_FPS**2 / 100.0)

        terms = {
            "root": _l1(got_six[:, :, 0], want_root),
            "local": _l1(got_six[:, :, 1:], want_six),
            "global": _l1(diff.matrix_to_six_d(world), diff.matrix_to_six_d(want_world)),
            "joints": _l1(joints, want),
            "acceleration": _l1(bend(moved), bend(want_moved)),
            "shape": (shape - shape.mean(dim=1, keepdim=True)).abs().mean(),
        }
        terms = {name: weights[name] * term for name, term in terms.items()}
    else:
        sparse = [JOINTS.index(name) for name in ("root", "left_wrist", "right_wrist")]
        lags = [k for k in (1, 3, 5) if k < moved.shape[1]]
        velocity = [
            _mse(moved[:, k:] - moved[:, :-k], want_moved[:, k:] - want_moved[:, :-k]) for k in lags
        ]
        terms = {
            "root": 10.0 * _mse(got_six[:, :, 0], want_root),
            "local": 50.0 * _mse(got_six[:, :, 1:], want_six),
            "global": 10.0 * _mse(diff.matrix_to_six_d(world), diff.matrix_to_six_d(want_world)),
            "joints": 1000.0 * _mse(joints, want),
            "sparse": 1000.0 * _mse(joints[:, :, sparse], want[:, :, sparse]),
            "shape": 10.0 * _shape_error(module, shape, target),
            "velocity": 5.0 * torch.stack(velocity).sum(),
        }
    total = torch.stack(list(terms.values())).sum()
    figures = {name: float(term.detach()) for name, term in terms.items()}
    figures["error_cm"] = float(100.0 * (joints - want).detach().norm(dim=-1).mean())
    return total, figures


def _shape_error(module: RecurrentModule, shape: Tensor, target: Windows) -> Tensor:
    """LGSIK-Poser's shape term: variance within each window, and in the variant also the error."""
    wander = shape - shape.mean(dim=1, keepdim=True)
    if isinstance(module.net, LgsikNet) and module.net.spec.loss == "lgsik":
        return wander.square().mean()
    lengths = bone_lengths(target.offsets.numpy()) / bone_lengths(module.template.numpy())
    known = torch.as_tensor(np.log(lengths), dtype=torch.float32)[:, None]
    return _mse(SHAPE_UNIT * shape, known) + SHAPE_UNIT * wander.abs().mean()


def make_task(
    module: nn.Module, stage: str, learning: Learning, bank: MotionBank, validation: int
) -> Task:
    """Create the task of ``network``, the only stage of HMD-Poser and LGSIK-Poser."""
    assert isinstance(module, RecurrentModule) and stage == "network"
    if not module.template.any():
        module.template.copy_(torch.as_tensor(bank.template))
    fixed = bank.validation.fixed(validation)
    fixed_seen = torch.tensor(VISIBLE)[torch.arange(validation) % len(VISIBLE)]

    def with_faults(windows: Windows, seen: Tensor, rng: np.random.Generator) -> _Batch:
        shape = (len(windows), windows.frames, len(DEVICES))
        return windows, seen, drawn(learning.noise, shape, rng)

    def draw(rng: np.random.Generator) -> _Batch:
        windows = bank.draw(learning.batch, rng)
        seen = torch.tensor(VISIBLE)[rng.integers(len(VISIBLE), size=learning.batch)]
        return with_faults(windows, seen, rng)

    def loss(batch: _Batch) -> tuple[Tensor, dict[str, float]]:
        windows, seen, faults = batch
        inputs, heading, target = training_inputs(windows, seen, faults)
        body = module.body_inputs(target.offsets.numpy())
        with products(learning.bfloat16 and module.training):
            six, shape, _ = module.net(inputs, body)
        weights = HMDPOSER_WEIGHTS | learning.weights
        return losses(module, six.float(), shape.float(), heading, target, weights)

    compared = with_faults(fixed, fixed_seen, np.random.default_rng(20_260))

    def validate() -> dict[str, float]:
        return loss(compared)[1]

    return Task(list(module.net.parameters()), draw, loss, validate)
