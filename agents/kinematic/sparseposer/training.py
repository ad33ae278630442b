"""Training of SparsePoser: first the generator, then the limbs' IK with the generator frozen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn

from agents.kinematic.data import MotionBank, Windows
from agents.kinematic.learning import Learning, Task
from agents.kinematic.sparseposer.networks import ENDS, LIMBS, TURNED, SparsePoserModule, root_space
from agents.kinematic.training_faults import Faults, drawn
from agents.precision import products
from questsim import differentiable as diff
from questsim.skeleton import NUM_JOINTS

ROOT_WEIGHT, ROTATION_WEIGHT = 10.0, 10.0
"""Weights of the root against other joints, and of ends' rotations against positions (released
code)."""
KEEP = "keep"
WEIGHTS = {KEEP: 0.1}
"""lambda of learned IK's regularisation L_Reg (the paper): it keeps the generator's pose where no
tracker measures it."""
REGULARISED = [joint for joint in range(NUM_JOINTS) if joint not in ENDS]
"""Joints of L_Reg: all but the end effectors."""
NORMALISED_BY = 256
"""Number of windows from which normalisers are computed."""


_Batch = tuple[Windows, Faults | None]


def _signals(windows: Windows, faults: Faults | None = None) -> tuple[Tensor, Tensor, Tensor]:
    """Measured positions and orientations of the tracked joints; true orientations of all joints.

    Everything is in the world.
    """
    turned = diff.matrix_to_quat(windows.world)
    position = windows.position[:, :, list(ENDS)]
    if faults is None:
        return position, turned[:, :, list(TURNED)], turned
    position, rotation = faults.apply(position, windows.world[:, :, list(TURNED)])
    return position, diff.matrix_to_quat(rotation), turned


def measure_normalisers(module: SparsePoserModule, windows: Windows) -> None:
    """Set means and deviations from windows; a constant channel gets a deviation of 1e-3.

    The ends' channels are normalised by those of the corresponding joints.
    """
    _, _, turned = _signals(windows)
    dual = root_space(windows.position, turned).flatten(0, 1)
    module.mean.copy_(dual.mean(dim=0))
    module.std.copy_(dual.std(dim=0).clamp_min(1e-3))
    bones = windows.offsets[:, 1:].flatten(0, 1)
    module.offset_mean.copy_(bones.mean(dim=0))
    module.offset_std.copy_(bones.std(dim=0).clamp_min(1e-3))
    path = windows.position[:, :, 0]
    module.step_std.copy_((path[:, 1:] - path[:, :-1]).std().clamp_min(1e-4))


def ends_of(dual: Tensor, offsets: Tensor) -> tuple[Tensor, Tensor]:
    """Positions and orientations ``(B, T, 6, ...)`` of the limbs' ends in root space."""
    position, matrix = joints_of(dual, offsets)
    return position[:, :, list(ENDS)], matrix[:, :, list(TURNED)]


def joints_of(dual: Tensor, offsets: Tensor) -> tuple[Tensor, Tensor]:
    """Forward kinematics in root space: ``(B, T, 22, 3)`` and ``(B, T, 22, 3, 3)``."""
    matrix = diff.quat_to_matrix(dual[..., :4])
    unturned = torch.eye(3).expand(*matrix.shape[:2], 1, 3, 3)
    matrix = torch.cat([unturned, matrix[:, :, 1:]], dim=2)
    return diff.positions_from_root(matrix, offsets[:, None]), matrix


def _regularisation(solved: Tensor, generated: Tensor, offsets: Tensor) -> Tensor:
    """L_Reg: MSE of positions and rotations of ``REGULARISED`` between learned IK and generator."""
    (place, turn), (place_before, turn_before) = (
        joints_of(dual, offsets) for dual in (solved, generated)
    )
    apart = (place - place_before)[:, :, REGULARISED].square().mean()
    return apart + (turn - turn_before)[:, :, REGULARISED].square().mean()


def make_task(
    module: nn.Module, stage: str, learning: Learning, bank: MotionBank, validation: int
) -> Task:
    """Create the task of stage ``generator`` or ``ik``."""
    assert isinstance(module, SparsePoserModule)
    if not module.std.any():
        measure_normalisers(module, bank.fixed(NORMALISED_BY))
    fixed = bank.validation.fixed(validation)
    if stage == "generator":
        trained = list(module.generator.parameters())
        loss = _generator_loss(module, learning.bfloat16)
    else:
        trained = list(module.ik.parameters())
        loss = _ik_loss(module, (WEIGHTS | learning.weights)[KEEP])

    def with_faults(windows: Windows, rng: np.random.Generator) -> _Batch:
        return windows, drawn(learning.noise, (len(windows), windows.frames, len(ENDS)), rng)

    def draw(rng: np.random.Generator) -> _Batch:
        return with_faults(bank.draw(learning.batch, rng), rng)

    compared = with_faults(fixed, np.random.default_rng(20_260))

    def validate() -> dict[str, float]:
        return loss(compared)[1]

    return Task(trained, draw, loss, validate)


_Loss = Callable[[_Batch], tuple[Tensor, dict[str, float]]]


def _prepared(module: SparsePoserModule, batch: _Batch) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Input channels, ends and normalised offsets, and the target dual quaternions."""
    windows, _ = batch
    position, turned, everything = _signals(*batch)
    sparse, ends = module.sparse(position, turned)
    target = root_space(windows.position, everything)
    return sparse, ends, module.normal_offsets(windows.offsets), target


def _error_cm(dual: Tensor, windows: Windows) -> float:
    """Mean joint distance in cm with roots aligned and the true orientation of the root."""
    turned = diff.quat_to_matrix(dual[..., :4].detach())
    root = windows.world[:, :, :1]
    world = torch.cat([root, root @ turned[:, :, 1:]], dim=2)
    got = diff.positions_from_root(world, windows.offsets[:, None])
    want = windows.position - windows.position[:, :, :1]
    return float(100.0 * (got - want).norm(dim=-1).mean())


def _generator_loss(module: SparsePoserModule, bfloat16: bool) -> _Loss:
    weight = torch.ones(NUM_JOINTS, 1)
    weight[0] = ROOT_WEIGHT

    def loss(batch: _Batch) -> tuple[Tensor, dict[str, float]]:
        windows, _ = batch
        sparse, _, offsets, target = _prepared(module, batch)
        with products(bfloat16 and module.training):
            out = module.generator(sparse, offsets.flatten(1))
        dual = module.unit(out.float())
        squared = (module.normal(dual) - module.normal(target)).square()
        total = (weight * squared).mean()
        figures = {"dual_quaternions": float(total.detach()), "error_cm": _error_cm(dual, windows)}
        return total, figures

    return loss


def _ik_loss(module: SparsePoserModule, keep_weight: float) -> _Loss:
    limbs = [limb.end for limb in LIMBS.values()]

    def loss(batch: _Batch) -> tuple[Tensor, dict[str, float]]:
        windows, _ = batch
        sparse, ends, offsets, target = _prepared(module, batch)
        with torch.no_grad():
            generated = module.generate(sparse, offsets)
        solved = module.solve(generated, ends, offsets)
        position, turned = ends_of(solved, windows.offsets)
        want_position, want_turned = ends_of(target, windows.offsets)
        keep = _regularisation(solved, generated, windows.offsets)
        apart = (position - want_position)[:, :, limbs].square().mean()
        turn = (turned - want_turned)[:, :, limbs].square().mean()
        total = apart + ROTATION_WEIGHT * turn + keep_weight * keep
        end_cm = 100.0 * (position - want_position)[:, :, limbs].detach().norm(dim=-1).mean()
        return total, {
            "end_position": float(apart.detach()),
            "end_rotation": float(turn.detach()),
            "keep": float(keep.detach()),
            "end_cm": float(end_cm),
            "error_cm": _error_cm(solved, windows),
        }

    return loss
