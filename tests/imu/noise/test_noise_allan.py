"""The overlapping Allan variance, and its covariance (V4), by independent routes."""

import allantools
import numpy as np
import pytest
from rounding import EPS

from simval.imu.noise import (
    allan_covariance,
    allan_law,
    allan_variance,
    averaging_counts,
    covariance_forms,
)
from simval.streams import cell_key, stream

KEY = cell_key("test noise allan")


@pytest.mark.parametrize("rate", [1.0, 100.0, 285.7])
def test_equal_to_allantools(rate):
    rng = stream(1, KEY, 0)
    signal = rng.standard_normal(20_000) + 0.01 * np.cumsum(rng.standard_normal(20_000))
    counts = averaging_counts(len(signal))
    taus, deviation, _, pairs = allantools.oadev(
        signal, rate=rate, data_type="freq", taus=counts / rate
    )
    np.testing.assert_array_equal(np.round(taus * rate), counts)
    np.testing.assert_array_equal(pairs, len(signal) - 2 * counts + 1)
    # sums of 2e4 numbers of size 1 up to 250, theirs with the mean still in them: 2e4
    # of them round as sqrt(n) eps, and differences of sums of 1e3 lose three digits
    np.testing.assert_allclose(
        allan_variance(signal, counts), deviation**2, rtol=1e3 * np.sqrt(2e4) * EPS
    )


COUNTS = (1, 2, 7, 20, 50, 119)
ROWS = 240
SETS = {
    "white": (1.0, 0.0, 0.0, 0.0),
    "flicker": (0.0, 1.0, 0.0, 0.0),
    "walk": (0.0, 0.0, 1.0, 0.0),
    "rounding": (0.0, 0.0, 0.0, 1.0),
    "all": (3.0, 0.5, 0.02, 1.0),
}


def generalised(t, squares):
    """R(t), eq. (V1), as it stands there."""
    t = np.abs(t)
    logs = t * t * np.log(np.where(t > 0.0, t, 1.0)) / (2.0 * np.pi)
    n, b, k, q = squares
    return -n * t / 2.0 + b * logs + k * t**3 / 12.0 + q * (t == 0.0)


def brute_force(counts, rows, squares):
    """Sum over all pairs of second differences, from the matrix of R: (V4)."""
    points = np.arange(rows + 1)
    matrix = generalised(np.subtract.outer(points, points).astype(float), squares)
    differences = []
    for m in counts:
        rows_of = np.zeros((rows - 2 * m + 1, rows + 1))
        places = np.arange(len(rows_of))
        for shift, weight in ((0, 1.0), (m, -2.0), (2 * m, 1.0)):
            rows_of[places, places + shift] = weight
        differences.append(rows_of / (np.sqrt(2.0 * len(rows_of)) * m))
    return np.array(
        [
            [2.0 * np.sum((a @ matrix @ b.T) ** 2) for b in differences]
            for a in differences
        ]
    )


@pytest.fixture(scope="module")
def forms():
    return covariance_forms(COUNTS, ROWS)


@pytest.mark.parametrize("name", SETS)
def test_quadratic_forms(forms, name):
    squares = np.array(SETS[name])
    expected = brute_force(COUNTS, ROWS, squares)
    found = allan_covariance(forms, squares)
    size = np.sqrt(np.outer(np.diagonal(expected), np.diagonal(expected)))
    # an integral for a sum beyond the edges of the kinks: (f'(b) - f'(a))/12 of a sum
    # over 36 or more, 1/(12 36) of the 30 % or less that c changes there
    limit = 0.3 / (12 * 36)
    assert np.max(np.abs(found - expected) / size) < limit
    # power: pairs, weights or a kink lost would be seen
    other = brute_force(COUNTS, ROWS - 1, squares)
    assert np.max(np.abs(other - expected) / size) > limit


def test_law_is_the_middle_of_the_covariance():
    counts = np.array([1.0, 5.0, 400.0])
    law = allan_law(counts)
    for kind in range(4):
        squares = np.eye(4)[kind]
        for m, value in zip(counts, law[:, kind], strict=True):
            lags = np.subtract.outer([-m, 0.0, m], [-m, 0.0, m])
            weights = np.array([1.0, -2.0, 1.0])
            middle = weights @ generalised(lags, squares) @ weights
            # squares of 800 times their logarithm, 7
            limit = 800.0**3 * EPS
            assert abs(middle / (2.0 * m * m) - value) <= limit / m**2


def test_long_lags_keep_their_digits():
    counts = averaging_counts(10_000_000)
    for name in ("flicker", "all"):
        matrix = allan_covariance(
            covariance_forms(counts[::8], 10_000_000), np.array(SETS[name])
        )
        size = np.sqrt(np.diagonal(matrix))
        assert np.all(np.isfinite(matrix))
        assert np.linalg.eigvalsh(matrix / np.outer(size, size)).min() > 0.0
