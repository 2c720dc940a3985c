"""Errors over a recording: few rows, error bars by blocks, when a filter settles."""

import numpy as np
import pytest
from rounding import EPS
from scipy import stats

from simval.recorded.errors import (
    Errors,
    Measured,
    block_of,
    convergence,
    mean_with_error,
    rms,
    table,
)

OFF = 1e-6  # of a limit


def errors_of(total, rate=10.0, rest=None):
    n = len(total)
    still = np.zeros(n, bool) if rest is None else rest
    return Errors(
        time=5.0 + np.arange(n) / rate, body=np.zeros((n, 3)), total=total,
        heading=2.0 * total, inclination=3.0 * total, rest=still,
    )  # fmt: skip


def test_an_rms_is_given_of_thirty_rows():
    values = 1.0 + np.random.default_rng(1).random(30)
    found = rms(values)
    assert found.rows == 30
    assert found.value == pytest.approx(np.sqrt(np.mean(values**2)), rel=8 * EPS)
    few = rms(values[:29])
    assert few.rows == 29
    assert np.isnan([few.value, few.sd]).all()


@pytest.mark.parametrize(("rows", "blocks"), [(240, 24), (30, 24), (7, 7)])
def test_the_error_of_a_mean_leaves_out_one_block_of_24_at_a_time(rows, blocks):
    values = np.cumsum(np.random.default_rng(2).standard_normal((rows, 2)), axis=0)
    mean, covariance, dof = mean_with_error(values)
    number, count = block_of(np.ones(rows))
    if rows < 24:
        number, count = np.arange(rows), rows
    assert (count, dof) == (blocks, blocks - 1)
    sizes = np.bincount(number)
    assert np.all(np.diff(number) >= 0)
    assert sizes.max() - sizes.min() <= 1
    # the mean without each block, by leaving it out
    others = np.array([values[number != b].mean(axis=0) for b in range(count)])
    off = others - others.mean(axis=0)
    expected = (count - 1) / count * off.T @ off
    np.testing.assert_allclose(mean, values.mean(axis=0), rtol=1e-12)
    # differences of means: rounding by the size of a value over that of a difference
    np.testing.assert_allclose(covariance, expected, rtol=1e-9)


def test_the_error_of_an_rms_is_half_the_relative_one_of_its_square():
    values = 1.0 + np.cumsum(np.random.default_rng(3).standard_normal(240)) / 10
    _, covariance, _ = mean_with_error(values[:, None] ** 2)
    found = rms(values)
    root = np.sqrt(np.mean(values**2))
    assert found.sd == pytest.approx(np.sqrt(covariance[0, 0]) / (2 * root), rel=1e-12)
    assert rms(np.zeros(40)).sd == 0.0


def test_an_interval_is_students_of_95_per_cent():
    found = Measured(value=1.0, sd=0.5, dof=23)
    assert found.half == pytest.approx(0.5 * stats.t(23).ppf(0.975), rel=1e-9)
    # 4 % wider than the normal
    assert found.half / (0.5 * stats.norm.ppf(0.975)) == pytest.approx(1.055, abs=0.01)


def test_rows_are_told_at_rest_and_moving():
    total = np.linspace(1.0, 2.0, 100)
    rest = np.arange(100) % 3 == 0
    found = table(errors_of(total, rest=rest))
    for part, rows in (("all", slice(None)), ("rest", rest), ("moving", ~rest)):
        root = np.sqrt(np.mean(total[rows] ** 2))
        for name, times in (("total", 1.0), ("heading", 2.0), ("inclination", 3.0)):
            assert found[part][name].value == pytest.approx(times * root, rel=1e-12)
        assert found[part]["total"].rows == len(total[rows])


@pytest.mark.parametrize(
    ("start", "seconds"), [(2.0 * (1 - OFF), 0.0), (2.0 * (1 + OFF), 1.0)]
)
def test_a_filter_has_converged_below_twice_its_last_half(start, seconds):
    """By the RMS over the ten seconds that follow."""
    total = np.ones(1000)  # 100 s
    total[:100] = start  # the first ten seconds
    assert convergence(errors_of(total)) == seconds


def test_converged_is_by_ten_seconds_and_never_by_none():
    # a great error is seen for as long as it is in the window
    total = np.ones(1000)
    total[:160] = 100.0  # to 16 s
    total[250:260] = 100.0  # at 25 s, which each window from 16 s to 25 s has in it
    assert convergence(errors_of(total)) == 26.0
    total[250:260] = 1.0
    assert convergence(errors_of(total)) == 16.0
    rising = np.linspace(10.0, 1.0, 1000) ** 4
    limit = 4.0 * np.mean(rising[500:] ** 2)
    windows = [np.mean(rising[10 * k : 10 * k + 100] ** 2) for k in range(90)]
    first = int(np.argmax(np.array(windows) <= limit))
    assert 0 < first < 90
    assert convergence(errors_of(rising)) == first
    assert np.isnan(convergence(errors_of(np.linspace(10.0, 1e-3, 100), rate=100.0)))
