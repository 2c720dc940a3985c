"""The overlapping Allan variance against a peer, a plain loop and invariances."""

import time

import allantools
import numpy as np
import pytest
from rounding import EPS

from simval.noise import allan_variance, averaging_counts
from simval.streams import cell_key, stream

KEY = cell_key("test noise allan")


def plain(signal, m):
    """Half the mean square of the differences of neighbouring averages."""
    means = [np.mean(signal[k : k + m]) for k in range(len(signal) - m + 1)]
    means = np.array(means)
    return np.mean((means[m:] - means[:-m]) ** 2) / 2.0


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


@pytest.mark.parametrize("n", [3, 10, 57])
def test_equal_to_a_plain_loop(n):
    signals = stream(2, KEY, n).standard_normal((n, 2, 3))
    counts = np.arange(1, n // 2 + 1)
    found = allan_variance(signals, counts)
    assert found.shape == (n // 2, 2, 3)
    for place in np.ndindex(2, 3):
        expected = [plain(signals[(slice(None), *place)], m) for m in counts]
        # a handful of sums of up to n numbers of size 1 for a square of 1e-3 at least
        each = found[(slice(None), *place)]
        np.testing.assert_allclose(each, expected, rtol=0, atol=64 * n * EPS)


@pytest.mark.parametrize("offset", [0.0, 1.0, 32768.0, 1e9])
def test_a_constant_changes_nothing(offset):
    whole = np.round(1000.0 * stream(4, KEY, 0).standard_normal(5000))
    counts = averaging_counts(5000)
    # whole numbers: the mean is off by eps of the offset, m times that in a sum
    limit = 1e-13 + counts * EPS * offset / 1000.0 * 10.0
    found = allan_variance(whole + offset, counts) / allan_variance(whole, counts)
    assert np.all(np.abs(found - 1.0) <= limit)


@pytest.mark.slow  # a busy memory makes it ten times as slow
def test_ten_million_rows_within_two_seconds():
    signal = stream(5, KEY, 0).standard_normal(10_000_000)
    counts = np.unique(np.round(np.geomspace(1, 1e6, 58)).astype(int))
    assert len(counts) == 55
    start = time.process_time()
    allan_variance(signal, counts)
    assert time.process_time() - start < 2.0


def test_counts_are_even_on_a_log_scale():
    counts = averaging_counts(44_925)
    assert counts[0] == 1
    assert counts[-1] <= 4492
    assert np.all(np.diff(counts) > 0)
    octaves = counts[np.searchsorted(counts, 64) :: 3]
    np.testing.assert_array_equal(octaves, 64 * 2 ** np.arange(len(octaves)))
