"""Quaternions and attitude errors against SciPy's and MuJoCo's own functions.

`geometry` is shared by theory and simulation, so it is never tested against either.
"""

import mujoco
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from rounding import EPS
from scipy.spatial.transform import Rotation

from simval.errors import InputError
from simval.geometry import (
    attitude_error,
    attitude_matrix,
    compose,
    conjugate,
    cross_matrix,
    normalize,
    random_quaternions,
)


def quaternions(count, seed=0):
    return random_quaternions(count, np.random.default_rng(seed))


def scalar_first(q):
    return np.concatenate([q[..., 3:], q[..., :3]], axis=-1)


def test_matrix_is_the_transpose_of_scipys_and_mujocos():
    q = quaternions(200)
    found = attitude_matrix(q)
    # a dozen products of numbers below 1
    np.testing.assert_allclose(
        found, Rotation.from_quat(q).as_matrix().swapaxes(1, 2), rtol=0, atol=12 * EPS
    )
    for each, own in zip(q, found, strict=True):
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, scalar_first(each))
        np.testing.assert_allclose(own, matrix.reshape(3, 3).T, rtol=0, atol=12 * EPS)


def test_attitude_takes_reference_to_body():
    # a body turned by +90 degrees about z sees the world's x axis along its -y axis
    q = np.array([0, 0, np.sin(np.pi / 4), np.cos(np.pi / 4)])
    np.testing.assert_allclose(
        attitude_matrix(q) @ [1, 0, 0], [0, -1, 0], rtol=0, atol=4 * EPS
    )
    # MuJoCo: the site's orientation rotates body vectors into the world
    world = np.zeros(3)
    mujoco.mju_rotVecQuat(world, np.array([0.0, -1.0, 0.0]), scalar_first(q))
    np.testing.assert_allclose(world, [1, 0, 0], rtol=0, atol=4 * EPS)


def test_composition_and_conjugate_against_mujoco_and_scipy():
    first, second = quaternions(50, 2), quaternions(50, 3)
    found = compose(first, second)
    for q1, q2, q in zip(first, second, found, strict=True):
        product, negative = np.zeros((2, 4))
        mujoco.mju_mulQuat(product, scalar_first(q1), scalar_first(q2))
        np.testing.assert_allclose(scalar_first(q), product, rtol=0, atol=6 * EPS)
        mujoco.mju_negQuat(negative, scalar_first(q1))
        np.testing.assert_array_equal(scalar_first(conjugate(q1)), negative)
    matrix = attitude_matrix(found)
    scipys = (Rotation.from_quat(first) * Rotation.from_quat(second)).as_matrix()
    np.testing.assert_allclose(matrix, scipys.swapaxes(1, 2), rtol=0, atol=30 * EPS)
    # (G2): first q1, then q2
    product = attitude_matrix(second) @ attitude_matrix(first)
    np.testing.assert_allclose(matrix, product, rtol=0, atol=30 * EPS)


angles = st.sampled_from(
    [0.0, 1e-300, 1e-12, 1e-8, 1e-3, 1.0, 2.5, np.pi - 1e-8, np.pi]
)


@given(angle=angles, seed=st.integers(0, 1000), sign=st.sampled_from([1.0, -1.0]))
@example(angle=np.pi, seed=0, sign=-1.0)
def test_attitude_error_at_every_size(angle, seed, sign):
    rng = np.random.default_rng(seed)
    q = random_quaternions(1, rng)[0]
    axis = normalize(rng.standard_normal(3))
    turn = np.append(np.sin(angle / 2) * axis, np.cos(angle / 2))
    other = sign * compose(q, turn)
    # rounding of the two quaternions: some eps, absolute, and the sine of a half turn
    # has a flat top, so 1e-8 there is eps
    assert attitude_error(q, other) == pytest.approx(angle, abs=20 * EPS)
    assert attitude_error(q, other) == pytest.approx(
        attitude_error(other, q), abs=1e-15
    )


def test_attitude_error_against_scipys_magnitude():
    a, b = quaternions(200, 5), quaternions(200, 6)
    expected = (Rotation.from_quat(a).inv() * Rotation.from_quat(b)).magnitude()
    np.testing.assert_allclose(attitude_error(a, b), expected, rtol=0, atol=20 * EPS)
    np.testing.assert_array_equal(attitude_error(a, -a), attitude_error(a, a))


def test_cross_matrix():
    rng = np.random.default_rng(7)
    v, w = rng.standard_normal((2, 5, 4, 3))
    found = np.einsum("...ij,...j->...i", cross_matrix(v), w)
    np.testing.assert_allclose(found, np.cross(v, w), rtol=0, atol=8 * EPS)
    np.testing.assert_array_equal(cross_matrix(v), -cross_matrix(v).swapaxes(-1, -2))


@given(
    v=st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
    power=st.integers(-150, 150),
)
@example(v=[5e-324, 0.0, 0.0], power=0)
@example(v=[1.0, 1.0, 1.0], power=150)
def test_normalize(v, power):
    scaled = np.array(v) * 10.0**power
    if np.all(scaled == 0.0):
        with pytest.raises(InputError, match="no direction"):
            normalize(scaled)
        return
    unit = normalize(scaled)
    assert np.linalg.norm(unit) == pytest.approx(1.0, abs=4 * EPS)
    largest = np.argmax(np.abs(scaled))
    np.testing.assert_allclose(
        unit * (scaled[largest] / unit[largest]),
        scaled,
        rtol=8 * EPS,
        atol=5e-324 + 4 * EPS * abs(scaled[largest]),
    )


def test_normalize_names_the_bad_row():
    rows = np.ones((2, 3, 3))
    rows[1, 2] = 0.0
    with pytest.raises(InputError, match=r"index \(1, 2\)"):
        normalize(rows)
    with pytest.raises(InputError, match="not finite"):
        normalize(np.array([1.0, np.nan, 0.0]))


def test_random_quaternions_are_uniform():
    # uniform on the sphere in four dimensions: each component has variance 1/4 and
    # fourth moment 1/8; the angle's density is (1 - cos a)/pi, mean (pi^2 + 4)/(2 pi)
    count = 100_000
    q = random_quaternions(count, np.random.default_rng(8))
    limit = 5.0  # 6e-7 two-sided, nine comparisons
    for power, mean, square in ((2, 1 / 4, 1 / 8), (4, 1 / 8, 35 / 384)):
        error = np.sqrt((square - mean**2) / count)
        assert np.all(np.abs((q**power).mean(axis=0) - mean) < limit * error)
    angle = attitude_error(q, np.array([0.0, 0.0, 0.0, 1.0]))
    expected = (np.pi**2 + 4.0) / (2.0 * np.pi)
    assert abs(angle.mean() - expected) < limit * angle.std() / np.sqrt(count)


def test_batches_broadcast():
    q = quaternions(6, 9).reshape(2, 3, 4)
    assert attitude_matrix(q).shape == (2, 3, 3, 3)
    assert attitude_error(q, q[0, 0]).shape == (2, 3)
    assert compose(q, q[:, :1]).shape == (2, 3, 4)
