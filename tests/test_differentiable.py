"""Rotations and forward kinematics in PyTorch agree with NumPy's, and have gradients."""

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st
from pymotion.rotations import dual_quat_torch

from questsim import differentiable as diff
from questsim import rotations as rot
from questsim.motion.retarget_back import to_motion
from tests.helpers import swaying_clip, two_columns


def random_quats(seed: int, *shape: int) -> np.ndarray:
    quat = np.random.default_rng(seed).normal(size=(*shape, 4))
    return quat / np.linalg.norm(quat, axis=-1, keepdims=True)


@given(st.integers(0, 1000))
def test_matrices_and_quaternions_agree_with_scipy_both_ways(seed):
    quat = random_quats(seed, 9)
    matrix = diff.quat_to_matrix(torch.as_tensor(quat))
    assert np.allclose(matrix, rot.quat_to_matrix(quat))
    back = diff.matrix_to_quat(matrix).numpy()
    assert np.allclose(np.abs((back * quat).sum(-1)), 1.0)


def test_six_d_rotations_equal_numpys_and_convert_back():
    quat = random_quats(0, 5)
    six = torch.as_tensor(two_columns(quat))
    assert np.allclose(diff.six_d_to_matrix(3.0 * six), rot.quat_to_matrix(quat))
    assert np.allclose(diff.matrix_to_six_d(diff.six_d_to_matrix(six)), six)


def test_forward_kinematics_equals_that_of_motion():
    motion = to_motion(swaying_clip())
    position, orientation = motion.forward_kinematics()
    local = diff.quat_to_matrix(torch.as_tensor(motion.rotations))
    got, world = diff.forward_kinematics(
        local, torch.as_tensor(motion.root_position), torch.as_tensor(motion.offsets)
    )
    assert np.allclose(got, position, atol=1e-9)
    assert np.allclose(world, rot.quat_to_matrix(orientation))


def test_forward_kinematics_has_the_gradient_of_its_differences():
    quat = torch.as_tensor(random_quats(1, 22))
    offsets = torch.randn(22, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))

    def place(six: torch.Tensor) -> torch.Tensor:
        world = diff.world_matrices(diff.six_d_to_matrix(six))
        return diff.positions_from_root(world, offsets)[13]

    six = diff.matrix_to_six_d(diff.quat_to_matrix(quat)).requires_grad_()
    assert torch.autograd.gradcheck(place, (six,), atol=1e-4)


def test_a_dual_quaternion_keeps_rotation_and_translation_through_normalisation():
    quat = torch.as_tensor(random_quats(2, 7))
    place = torch.as_tensor(np.random.default_rng(2).normal(size=(7, 3)))
    dual = diff.unit_dual_quat(2.5 * diff.dual_quat(quat, place))
    turned, moved = dual_quat_torch.to_rotation_translation(dual)
    assert torch.allclose(turned, quat)
    assert torch.allclose(moved, place)


def test_signs_of_quaternions_become_continuous_in_time():
    quat = torch.as_tensor(np.stack([rot.yaw_quat(np.linspace(0, 9, 50))] * 2))
    flipped = quat * torch.where(torch.arange(50) % 3 == 0, -1.0, 1.0)[:, None]
    smooth = diff.continuous_signs(flipped, dim=1)
    assert (smooth[:, 1:] * smooth[:, :-1]).sum(-1).min() > 0.9
    assert (smooth[:, 0, 0] >= 0).all()


def test_heading_equals_numpys_and_is_defined_when_looking_straight_up():
    quat = random_quats(3, 20)
    matrix = diff.heading_matrix(diff.quat_to_matrix(torch.as_tensor(quat))).numpy()
    assert np.allclose(np.arctan2(matrix[:, 1, 0], matrix[:, 0, 0]), rot.heading(quat))
    up = torch.tensor([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])
    assert torch.allclose(diff.heading_matrix(up), torch.eye(3))
