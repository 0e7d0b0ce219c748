import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from contract.rotations import (
    R_ENU_NED,
    euler_from_matrix,
    exp_so3,
    log_of_one,
    log_so3,
    matrix_from_euler,
    matrix_from_quaternion,
    mount_rotation,
    quaternion_from_matrix,
    right_jacobian_inverse,
    skew,
)

Array = NDArray[np.float64]
vectors = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array)
angles = st.one_of(st.floats(0.0, np.pi - 1e-6), st.sampled_from([0.0, 1e-12, 1e-8, 1e-5, 1e-4, 1e-3, np.pi - 1e-5]))


@st.composite
def rotation_vectors(draw: st.DrawFn) -> Array:
    axis = draw(vectors.filter(lambda v: float(np.linalg.norm(v)) > 1e-3))
    return axis / np.linalg.norm(axis) * draw(angles)


@given(vectors, vectors)
def test_skew_is_the_cross_product(v: Array, w: Array) -> None:
    np.testing.assert_allclose(skew(v) @ w, np.cross(v, w), atol=1e-15)


@given(rotation_vectors())
def test_one_rotation_vector_is_turned_into_the_same_matrix_alone_as_among_others(v: Array) -> None:
    np.testing.assert_allclose(exp_so3(v), exp_so3(np.stack([v, -v]))[0], rtol=0.0, atol=2e-16)


@given(
    st.tuples(*[st.floats(-1e3, 1e3, allow_subnormal=False)] * 4).map(np.array).filter(lambda q: np.abs(q).max() > 1e-3)
)
def test_one_quaternion_gives_the_same_matrix_alone_as_among_others(q: Array) -> None:
    np.testing.assert_array_equal(matrix_from_quaternion(q), matrix_from_quaternion(np.stack([q, -q]))[0])


@given(rotation_vectors())
def test_one_matrix_has_the_same_rotation_vector_in_plain_numbers(v: Array) -> None:
    np.testing.assert_allclose(log_of_one(exp_so3(v).tolist()), log_so3(exp_so3(v)), rtol=1e-12, atol=1e-14)


def test_half_a_turn_has_the_same_rotation_vector_in_plain_numbers() -> None:
    for axis in (*np.eye(3), np.array([0.6, -0.8, 0.0]), np.array([-2.0, 1.0, 2.0]) / 3.0):
        for angle in (np.pi, np.pi - 1e-9, np.pi + 1e-9):
            R = exp_so3(axis * angle)
            np.testing.assert_allclose(log_of_one(R.tolist()), log_so3(R), rtol=0.0, atol=1e-12)


@given(rotation_vectors())
def test_exp_is_a_rotation_and_log_its_inverse(v: Array) -> None:
    R = exp_so3(v)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(log_so3(R), v, atol=1e-9)


@given(rotation_vectors(), vectors)
def test_exp_turns_about_its_axis_by_the_right_hand(v: Array, w: Array) -> None:
    angle = np.linalg.norm(v)
    axis = v / angle if angle > 0.0 else np.array([0.0, 0.0, 1.0])
    expected = w * np.cos(angle) + np.cross(axis, w) * np.sin(angle) + axis * (axis @ w) * (1.0 - np.cos(angle))
    np.testing.assert_allclose(exp_so3(v) @ w, expected, atol=1e-12)


@given(rotation_vectors())
def test_quaternions_and_matrices_mean_the_same(v: Array) -> None:
    R = exp_so3(v)
    q = quaternion_from_matrix(R)
    assert np.linalg.norm(q) == pytest.approx(1.0)
    np.testing.assert_allclose(matrix_from_quaternion(q), R, atol=1e-12)
    np.testing.assert_allclose(matrix_from_quaternion(-3.0 * q), R, atol=1e-12)


@given(st.floats(-3.1, 3.1), st.floats(-1.57, 1.57), st.floats(-3.1, 3.1))
def test_euler_angles_survive(roll: float, pitch: float, yaw: float) -> None:
    R = matrix_from_euler(roll, pitch, yaw)
    np.testing.assert_allclose(matrix_from_euler(*euler_from_matrix(R)), R, atol=1e-6)
    np.testing.assert_allclose(euler_from_matrix(R)[1], pitch, atol=1e-6)


@given(rotation_vectors().filter(lambda v: float(np.linalg.norm(v)) < 3.0), vectors)
def test_the_right_jacobian_is_the_derivative(v: Array, d: Array) -> None:
    step = 1e-6 * d
    moved = (log_so3(exp_so3(v) @ exp_so3(step)) - log_so3(exp_so3(v) @ exp_so3(-step))) / 2e-6
    np.testing.assert_allclose(right_jacobian_inverse(v) @ d, moved, atol=1e-5)


def test_a_mount_straight_down_has_the_pictures_top_towards_the_nose() -> None:
    R_body_cam = mount_rotation(0.0, -90.0, 0.0)
    np.testing.assert_allclose(R_body_cam @ [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], atol=1e-12)  # looks down
    np.testing.assert_allclose(R_body_cam @ [0.0, -1.0, 0.0], [1.0, 0.0, 0.0], atol=1e-12)  # up is the nose
    seed = mount_rotation(0.0, -90.0, -90.0)
    np.testing.assert_allclose(seed @ [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], atol=1e-12)  # camera x is the nose


def test_a_level_vehicle_heading_east_has_its_nose_east() -> None:
    nose_enu = R_ENU_NED @ matrix_from_euler(0.0, 0.0, np.pi / 2) @ [1.0, 0.0, 0.0]
    np.testing.assert_allclose(nose_enu, [1.0, 0.0, 0.0], atol=1e-12)


def test_many_at_once_are_each_alone() -> None:
    v = np.random.default_rng(0).normal(size=(3, 4, 3))
    np.testing.assert_allclose(exp_so3(v)[1, 2], exp_so3(v[1, 2]), atol=1e-15)
    np.testing.assert_allclose(log_so3(exp_so3(0.5 * v)), 0.5 * v, atol=1e-9)
