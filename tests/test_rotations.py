"""Rotations against SciPy and by their properties."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from questsim import rotations as rot

rotation_vectors = arrays(float, (3,), elements=st.floats(-3.0, 3.0, allow_nan=False))


def quat(rotvec: np.ndarray) -> np.ndarray:
    return rot.as_quat(Rotation.from_rotvec(rotvec))


@settings(max_examples=50, deadline=None)
@given(rotation_vectors, rotation_vectors, rotation_vectors)
def test_product_and_rotation_agree_with_matrices(a, b, v) -> None:
    product = rot.quat_to_matrix(quat(a)) @ rot.quat_to_matrix(quat(b))
    np.testing.assert_allclose(
        rot.quat_to_matrix(rot.quat_multiply(quat(a), quat(b))), product, atol=1e-12
    )
    np.testing.assert_allclose(
        rot.quat_rotate(quat(a), v), rot.quat_to_matrix(quat(a)) @ v, atol=1e-12
    )


@settings(max_examples=50, deadline=None)
@given(rotation_vectors)
def test_conjugate_undoes_a_rotation(a) -> None:
    identity = rot.quat_multiply(rot.quat_conjugate(quat(a)), quat(a))
    np.testing.assert_allclose(identity, [1, 0, 0, 0], atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(-1.4, 1.4), st.floats(-1.4, 1.4))
def test_heading_is_the_yaw_of_a_yaw_pitch_roll_rotation(yaw, pitch, roll) -> None:
    q = rot.as_quat(Rotation.from_euler("ZYX", [yaw, pitch, roll]))
    assert rot.heading(q) == pytest.approx(yaw, abs=1e-9)


def test_angle_between_is_the_geodesic_angle_whatever_the_signs() -> None:
    a, b = quat(np.zeros(3)), quat(np.array([0.0, 0.0, 1.2]))
    assert rot.angle_between(a, -b) == pytest.approx(1.2)


def test_unit_vectors_have_length_one_and_a_zero_vector_stays_zero() -> None:
    vectors = np.array([[3.0, 0.0, 4.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(rot.unit(vectors), [[0.6, 0.0, 0.8], [0.0, 0.0, 0.0]])


def test_angular_velocity_of_a_steady_spin() -> None:
    spin = np.array([0.2, -0.5, 1.5])
    turns = rot.as_quat(Rotation.from_rotvec(spin * np.arange(20)[:, None] / 36.0))
    np.testing.assert_allclose(rot.angular_velocity(turns, 36.0), np.tile(spin, (20, 1)), atol=1e-9)


def test_continuous_quaternions_do_not_change_sign() -> None:
    turns = rot.as_quat(Rotation.from_rotvec(np.linspace(0, 12, 50)[:, None] * [0, 0, 1]))
    signs = np.where(np.arange(50) % 3 == 0, -1.0, 1.0)[:, None]
    smooth = rot.continuous(turns * signs)
    assert (np.sum(smooth[1:] * smooth[:-1], axis=-1) > 0.9).all()
    np.testing.assert_allclose(rot.angle_between(smooth, turns), 0.0, atol=1e-7)


def test_resampling_keeps_frames_that_fall_on_old_times() -> None:
    turns = rot.as_quat(Rotation.from_rotvec(np.linspace(0, 1, 11)[:, None] * [0, 1, 0]))
    old, new = np.arange(11) / 30.0, np.arange(13) / 36.0
    resampled = rot.resample_quat(turns, old, new)
    np.testing.assert_allclose(rot.angle_between(resampled[::6], turns[::5]), 0.0, atol=1e-7)
