"""What a calibration leaves in readings, against readings that are corrected wrong."""

import numpy as np
import pytest

from simval.errors import InputError
from simval.imu.sensor import forms
from simval.theory import calibration_error

RNG = np.random.default_rng(0)
M = np.eye(3) + 0.1 * RNG.standard_normal((3, 3))
X = RNG.standard_normal((20, 3))


def of_rank_one(column):
    return np.outer(column, column)


def seen(error):
    """Column of a covariance of rank one, up to its sign."""
    values, vectors = np.linalg.eigh(error.covariance)
    return vectors[:, -1] * np.sqrt(values[-1])


def off(change, corrected):
    """How far readings of X are off when they are corrected with a changed calibration.

    Central differences of the exact correction, linear in each parameter of M and B.
    """
    step = 1e-6
    return (corrected(step * change) - corrected(-step * change)) / (2.0 * step)


def same_up_to_sign(found, wanted):
    # differences: step^2 of a product, and 1e-16/step
    sign = np.sign(np.vdot(found, wanted))
    np.testing.assert_allclose(sign * found, wanted, rtol=0, atol=1e-8)


def test_matrix_and_offset():
    B = RNG.standard_normal(3)
    y = np.linalg.solve(M, X.T).T + B
    change = RNG.standard_normal(12)

    def corrected(c):
        return (y - B - c[9:]) @ (M + c[:9].reshape(3, 3)).T

    c = seen(calibration_error("magnetometer", M, of_rank_one(change)))
    same_up_to_sign(X @ c[:9].reshape(3, 3).T + c[9:], off(change, corrected))
    gyroscope = calibration_error("gyroscope", M, of_rank_one(change))
    c = seen(gyroscope)
    change[9:] = 0.0  # the bias is the filter's
    same_up_to_sign(X @ c.reshape(3, 3).T, off(change, corrected))
    alone = calibration_error("gyroscope", M, of_rank_one(change[:9]))
    np.testing.assert_array_equal(alone.covariance, gyroscope.covariance)


@pytest.mark.parametrize("form", forms.MODELS)
def test_nine_parameters_of_a_form(form):
    theta = forms.from_gram(form, M.T @ M, RNG.standard_normal(3))
    own = forms.matrix(form, theta)
    y = np.linalg.solve(own, X.T).T + theta[6:]
    change = RNG.standard_normal(9)

    def corrected(c):
        return (y - theta[6:] - c[6:]) @ forms.matrix(form, theta + c).T

    error = calibration_error("accelerometer", own, of_rank_one(change), form=form)
    c = seen(error)
    same_up_to_sign(X @ c[:9].reshape(3, 3).T + c[9:], off(change, corrected))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("gyroscope", np.zeros((3, 3)), np.eye(9)), "full rank"),
        (("gyroscope", M, np.eye(10)), r"give \(9, 9\) or \(12, 12\)"),
        (("magnetometer", M, np.eye(9)), r"give \(12, 12\)"),
        (("accelerometer", M, np.eye(9), "triangular"), "no triangular one"),
        (("accelerometer", M, np.eye(9), "round"), "`form`"),
        (("g-sensitivity", M, np.eye(9)), "of its own"),
        (("gyroscope", M, -np.eye(9)), "no covariance"),
    ],
)
def test_refusals(arguments, words):
    of, matrix, covariance, *form = arguments
    with pytest.raises(InputError, match=words):
        calibration_error(of, matrix, covariance, form=form[0] if form else None)
