"""Training of HMD-Poser and LGSIK-Poser: inputs with device errors, losses, the task."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from agents.kinematic.data import MotionBank, Windows
from agents.kinematic.learning import Learning, Task
from agents.kinematic.recurrent.features import DEVICES, HEAD, SENSOR_JOINTS, features
from agents.kinematic.recurrent.hmdposer import HmdPoserNet
from agents.kinematic.recurrent.lgsik import LgsikNet
from agents.kinematic.recurrent.poser import SHAPE_UNIT, VISIBLE, RecurrentModule
from agents.kinematic.training_faults import Faults, drawn
from agents.precision import products
from questsim import differentiable as diff
from questsim.joint_sensors import SENSOR_FPS, mount
from questsim.proportions import bone_lengths
from questsim.skeleton import JOINTS

HISTORY = 2
"""Number of frames before a window that accelerations need."""
HMDPOSER_WEIGHTS = {
    "root": 1.0, "local": 5.0, "global": 1.0, "joints": 1.0, "acceleration": 0.5, "shape": 0.1,
}  # fmt: skip
"""Published weights of the terms of HMD-Poser's loss, see ``losses``."""

_Batch = tuple[Windows, Tensor, Faults | None]


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


class _Compared(NamedTuple):
    """Estimates and targets of ``B`` windows of ``T`` frames, as the losses compare them.

    Attributes:
        local, true_local: ``(B, T, 21, 6)`` rotations of the joints below the root.
        root, true_root: ``(B, T, 6)`` orientation of the root, from the heading.
        world, true_world: ``(B, T, 22, 6)`` orientations, from the heading.
        joints, true_joints: ``(B, T, 22, 3)`` from the head, in axes of the heading.
        path, true_path: ``(B, T, 22, 3)`` from the head, in axes of the world.
        shape: ``(B, T, 16)`` shape values.
    """

    local: Tensor
    true_local: Tensor
    root: Tensor
    true_root: Tensor
    world: Tensor
    true_world: Tensor
    joints: Tensor
    true_joints: Tensor
    path: Tensor
    true_path: Tensor
    shape: Tensor


def losses(
    module: RecurrentModule,
    six: Tensor,
    shape: Tensor,
    heading: Tensor,
    target: Windows,
    weights: dict[str, float] = HMDPOSER_WEIGHTS,
) -> tuple[Tensor, dict[str, float]]:
    """The published loss of either system, in the frame of the head's heading.

    HMD-Poser uses L1 with ``weights``; LGSIK-Poser uses MSE. In both papers the shape term is
    consistency in the window alone: bones follow from the loss of the joints. Other values of
    ``LgsikSpec.loss`` supervise bone lengths too, or use HMD-Poser's loss.

    Args:
        module: the network and its mean body.
        six: ``(B, T, 22, 6)`` estimated rotations, the root's from the heading.
        shape: ``(B, T, 16)`` shape values.
        heading: ``(B, T, 3, 3)`` heading of the head.
        target: the true motion.
        weights: of HMD-Poser's terms.

    Returns:
        The loss, and its weighted terms and the mean joint error in cm by name.
    """
    found = _compared(module, six, shape, heading, target)
    if isinstance(module.net, HmdPoserNet) or module.net.spec.loss == "hmdposer":
        terms = {name: weights[name] * term for name, term in _hmdposer_terms(found).items()}
    else:
        terms = _lgsik_terms(found, _shape_error(module, shape, target))
    total = torch.stack(list(terms.values())).sum()
    figures = {name: float(term.detach()) for name, term in terms.items()}
    apart = (found.joints - found.true_joints).detach()
    figures["error_cm"] = float(100.0 * apart.norm(dim=-1).mean())
    return total, figures


def _compared(
    module: RecurrentModule, six: Tensor, shape: Tensor, heading: Tensor, target: Windows
) -> _Compared:
    """Poses of the estimated rotations and bones, next to the true ones."""
    local = diff.six_d_to_matrix(six)
    world = diff.world_matrices(local)
    from_root = diff.positions_from_root(world, module.bones(shape))
    joints = from_root - from_root[:, :, HEAD : HEAD + 1]
    back = heading.transpose(-1, -2)[:, :, None]
    true_world = back @ target.world
    from_head = target.position - target.position[:, :, HEAD : HEAD + 1]
    turned = diff.matrix_to_six_d(local)
    return _Compared(
        local=turned[:, :, 1:],
        true_local=diff.matrix_to_six_d(target.local[:, :, 1:]),
        root=turned[:, :, 0],
        true_root=diff.matrix_to_six_d(true_world[:, :, 0]),
        world=diff.matrix_to_six_d(world),
        true_world=diff.matrix_to_six_d(true_world),
        joints=joints,
        true_joints=(back @ from_head[..., None]).squeeze(-1),
        # Paths do not contain the head's own path, which is measured.
        path=(heading[:, :, None] @ joints[..., None]).squeeze(-1),
        true_path=from_head,
        shape=shape,
    )


def _hmdposer_terms(found: _Compared) -> dict[str, Tensor]:
    """HMD-Poser's terms without weights: L1, accelerations in units of 100 m/s^2."""

    def acceleration(path: Tensor) -> Tensor:
        return (path[:, 2:] - 2 * path[:, 1:-1] + path[:, :-2]) * (SENSOR_FPS**2 / 100.0)

    return {
        "root": _l1(found.root, found.true_root),
        "local": _l1(found.local, found.true_local),
        "global": _l1(found.world, found.true_world),
        "joints": _l1(found.joints, found.true_joints),
        "acceleration": _l1(acceleration(found.path), acceleration(found.true_path)),
        "shape": (found.shape - found.shape.mean(dim=1, keepdim=True)).abs().mean(),
    }


def _lgsik_terms(found: _Compared, shape_error: Tensor) -> dict[str, Tensor]:
    """LGSIK-Poser's weighted terms: MSE, velocities over 1, 3 and 5 frames."""
    sparse = [JOINTS.index(name) for name in ("root", "left_wrist", "right_wrist")]
    path, true_path = found.path, found.true_path
    velocity = [
        _mse(path[:, lag:] - path[:, :-lag], true_path[:, lag:] - true_path[:, :-lag])
        for lag in (1, 3, 5)
        if lag < path.shape[1]
    ]
    return {
        "root": 10.0 * _mse(found.root, found.true_root),
        "local": 50.0 * _mse(found.local, found.true_local),
        "global": 10.0 * _mse(found.world, found.true_world),
        "joints": 1000.0 * _mse(found.joints, found.true_joints),
        "sparse": 1000.0 * _mse(found.joints[:, :, sparse], found.true_joints[:, :, sparse]),
        "shape": 10.0 * shape_error,
        "velocity": 5.0 * torch.stack(velocity).sum(),
    }


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
