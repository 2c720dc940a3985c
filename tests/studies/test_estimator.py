"""Study estimator: what a covariance that an estimator states may leave out."""

import numpy as np
import pytest

from simval.moments import Moments
from simval.studies.estimator import claim_rows

MOMENTS = Moments(
    bias=np.array([0, 0, 0, 3.1]), covariance=np.eye(4), samples=100,
    bias_error=np.array([0, 0, 0, 0.1]), covariance_error=np.eye(4),
)  # fmt: skip


@pytest.mark.parametrize("order", [2, 4])
def test_a_claim_falls_with_the_noise_as_its_order_says(order):
    off, covariance = 1e-3, np.diag([1e-4, 4e-4, 2e-4])
    rows = claim_rows(order, MOMENTS, off, off / 8.0, 1e-9, covariance)
    nees, half, full = rows
    assert (nees.value, nees.standard_error, nees.prediction) == (3.1, 0.1, 3.0)
    # twice the error that cubature finds in it, of a mean of 3
    assert nees.remainder == pytest.approx(2.0 * 3.0 * off, rel=1e-12)
    assert (half.value, full.value) == (off / 8.0, off)
    assert half.prediction == pytest.approx(off / 2.0 ** (order - 0.5), rel=1e-12)
    following = (4.0 * 4e-4) ** (order / 2 + 1)
    expected = 2.0 ** (order + 0.5) * off / 8.0 + following
    assert full.prediction == pytest.approx(expected, rel=1e-12)
    # below a millionth an order cannot be told
    least = claim_rows(order, MOMENTS, 1e-9, 1e-9, 1e-9, 1e-9 * np.eye(3))
    assert [row.prediction for row in least[1:]] == [1e-6, 1e-6]


def test_an_exact_claim_may_be_off_by_twice_what_cubature_is():
    nees, off = claim_rows("exact", MOMENTS, -1e-4, 0.0, 3e-5, np.eye(3))
    assert nees.remainder == 0.0
    assert (off.value, off.prediction) == (1e-4, pytest.approx(6e-5, rel=1e-12))
