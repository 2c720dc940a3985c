"""What a calibration leaves in readings, against readings that are corrected wrong."""

from dataclasses import replace

import numpy as np
import pytest
from filter_paths import model, wobble

from simval.errors import InputError
from simval.imu.sensor import forms
from simval.theory import calibration_error, filter_bound

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
        (("gyroscope", M, -np.eye(9)), "not a covariance"),
    ],
)
def test_refusals(arguments, words):
    of, matrix, covariance, *form = arguments
    with pytest.raises(InputError, match=words):
        calibration_error(of, matrix, covariance, form=form[0] if form else None)


@pytest.mark.parametrize("seed", range(20))
def test_a_covariance_may_be_singular_in_any_direction(seed):
    """However it was computed: a difference of greater ones is rounded like these.

    Of numbers of two units. One with as much below zero as a millionth of its greatest
    variance, in either unit, is none.
    """
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-14.0, 0.0)
    near = 10.0 ** rng.uniform(-12.0, 0.0)  # to an axis
    up = np.array([near, near * rng.uniform(), 1.0])
    up = np.linalg.qr(np.column_stack([up, np.eye(3)[:, :2]]))[0][:, 0]
    flat = np.eye(3) - np.outer(up, up)
    P = np.zeros((6, 6))
    P[:3, :3], P[3:, 3:] = flat, size * np.diag([1.0, 1.0, 0.0])
    path = wobble(30)
    free = filter_bound(path, replace(model(), start=P)).covariance
    # by two axes that need no difference it is the same: what is clipped is rounding
    level = np.linalg.svd(up[:, None])[0][:, 1:]
    P[:3, :3] = level @ level.T
    np.testing.assert_allclose(
        filter_bound(path, replace(model(), start=P)).covariance, free,
        rtol=0, atol=1e-9 * free.max(),
    )  # fmt: skip
    for axis, greatest in ((up, 1.0), (np.eye(3)[2], size)):
        wrong = P.copy()
        part = slice(0, 3) if greatest == 1.0 else slice(3, 6)
        wrong[part, part] -= 1e-6 * greatest * np.outer(axis, axis)
        with pytest.raises(InputError, match="not a covariance"):
            replace(model(), start=wrong)
    with pytest.raises(InputError, match="not a covariance"):
        replace(model(), start=P + np.triu(1e-6 * np.ones((6, 6)), 1))
