"""The gyroscope's model, its forms and their covariances."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simval.errors import InputError
from simval.imu.sensor import GyroscopeModel, gyroscope_factors
from simval.imu.sensor.forms import FACTORS

M = 2.1e-4 * (
    np.eye(3)
    + np.array([[0.01, 0.02, -0.03], [0.04, -0.02, 0.01], [0.03, 0.02, 0.005]])
)
B = np.array([32771.0, 32458.0, 32513.0])
G = np.array([[1.0, 2.0, -0.5], [0.2, -0.7, 0.1], [0.3, 0.4, 0.9]])
SEED = np.random.default_rng(0)


def sensor(**more):
    return GyroscopeModel(**{"M": M, "B": B, **more})


def test_correct_inverts_distort():
    rate, force = SEED.normal(size=(2, 50, 3))
    model = sensor(G=G)
    raw = model.distort(rate, SEED, specific_force=force)
    back = model.correct(raw, specific_force=force)
    # a solve and a product of 3 x 3, on numbers of 32768
    atol = 16 * np.finfo(float).eps * np.linalg.cond(M) * 4e4 * 2.1e-4
    np.testing.assert_allclose(back, rate, rtol=0, atol=atol)
    np.testing.assert_allclose(
        raw - sensor().distort(rate, SEED), force @ G.T, atol=1e-9
    )


def test_noise_of_a_sample_is_the_walk_over_the_root_of_the_step():
    raw = sensor(angle_random_walk=0.2).distort(
        np.zeros((100_000, 3)), np.random.default_rng(1), timestep=0.01
    )
    # sd of a variance of 3e5 numbers: sqrt(2 / 3e5) = 0.26 %; one false alarm in 1e4
    assert abs((raw - B).var() / (0.04 / 0.01) - 1.0) < 3.9 * np.sqrt(2 / 3e5)


def rebuilt(form, found):
    if form == "kalibr":
        return np.linalg.inv(found.shape @ found.rest)
    return found.shape @ found.rest if form != "polar" else found.rest @ found.shape


@pytest.mark.parametrize("form", FACTORS)
def test_factors_give_the_matrix_back(form):
    found = gyroscope_factors(M, form=form)
    np.testing.assert_allclose(rebuilt(form, found), M, rtol=1e-12, atol=1e-18)
    if form != "misalignment-scale":
        np.testing.assert_allclose(found.rest @ found.rest.T, np.eye(3), atol=1e-14)


@pytest.mark.parametrize("form", FACTORS)
def test_covariance_is_that_of_the_values(form):
    """Against central differences of the factors themselves; angles by SciPy's log."""
    step = 1e-6 * M[0, 0]
    base = gyroscope_factors(M, form=form)
    slopes = []
    for k in range(9):
        two = []
        for sign in (1.0, -1.0):
            moved = M.copy()
            moved.flat[k] += sign * step
            got = gyroscope_factors(moved, form=form)
            values = got.values.copy()
            if form != "misalignment-scale":
                values[6:] = Rotation.from_matrix(got.rest @ base.rest.T).as_rotvec()
            two.append(values)
        slopes.append((two[0] - two[1]) / (2 * step))
    J = np.array(slopes).T
    root = np.random.default_rng(3).normal(size=(9, 9)) * 1e-8
    cov = root @ root.T
    expected = J @ cov @ J.T
    got = gyroscope_factors(M, cov, form=form).covariance
    # differences: h^2 of 1e-12, rounding 1e-16/1e-6 of the values
    scale = np.sqrt(np.outer(np.diagonal(expected), np.diagonal(expected)))
    np.testing.assert_allclose(got / scale, expected / scale, atol=1e-7)


def test_kalibr_is_lower_triangular_and_a_rotation():
    found = gyroscope_factors(M, form="kalibr")
    assert np.array_equal(found.shape, np.tril(found.shape))
    assert np.all(np.diagonal(found.shape) > 0)
    assert np.linalg.det(found.rest) > 0


def test_what_is_no_gyroscope_is_refused():
    for bad, words in (
        ({"M": np.zeros((3, 3))}, "singular"),
        ({"M": np.arange(9.0).reshape(3, 3)}, "singular"),  # but for rounding
        ({"M": np.eye(2)}, "shape"),
        ({"B": [1.0, np.nan, 0.0]}, "finite"),
        ({"angle_random_walk": -1.0}, "0 raw units"),
        ({"G": np.ones(3)}, "shape"),
    ):
        with pytest.raises(InputError, match=words):
            sensor(**bad)
    with pytest.raises(InputError, match="timestep"):
        sensor(angle_random_walk=1.0).distort(np.zeros((2, 3)), SEED)
    with pytest.raises(InputError, match="specific_force"):
        sensor(G=G).correct(np.zeros((2, 3)))
    with pytest.raises(InputError, match="right-handed"):
        gyroscope_factors(M[[1, 0, 2]], form="kalibr")
