"""Static detector: against a plain loop, IMU-TK's own intervals, and known rests."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simval.errors import RefusedError
from simval.imu.statics import (
    initial_rest,
    interval_counts,
    interval_means,
    intervals_below,
    variance_magnitude,
)


def static_intervals(samples, threshold, **lengths):
    return intervals_below(variance_magnitude(samples), threshold, **lengths)


def plain_variance(samples, window):
    """Eq. (D1) as it reads: one call of numpy's two-pass variance per window."""
    half = window // 2
    result = np.full(len(samples), np.inf)
    for k in range(half, len(samples) - half):
        part = samples[k - half : k + half + 1]
        result[k] = np.linalg.norm(part.var(axis=0, ddof=1))
    return result


@given(
    n=st.integers(5, 60),
    half=st.integers(1, 12),
    offset=st.sampled_from([0.0, 1.0, 3e4, -1e9]),
    seed=st.integers(0, 2**32 - 1),
)
def test_windowed_variance_is_the_plain_one(n, half, offset, seed):
    window = min(2 * half + 1, n - 1 + n % 2)
    samples = np.random.default_rng(seed).standard_normal((n, 3)) + offset
    # the samples carry offset * eps of rounding; centred sums of up to 60 terms of
    # size one then add 60 eps each, and the two-pass oracle as much
    tolerance = 8 * np.finfo(float).eps * (abs(offset) + 2 * 60) * np.sqrt(3)
    np.testing.assert_allclose(
        variance_magnitude(samples, float(window)),  # 1e2 is a whole number
        plain_variance(samples, window),
        rtol=tolerance,
        atol=tolerance,
    )


def test_windows_of_a_long_log_do_not_depend_on_where_it_is_cut():
    samples = np.random.default_rng(1).standard_normal((40_000, 3))
    whole, later = (variance_magnitude(x, 101) for x in (samples, samples[150:]))
    tolerance = 8 * np.finfo(float).eps * 2 * 101 * np.sqrt(3)  # as above
    np.testing.assert_allclose(whole[200:-50], later[50:-50], rtol=tolerance)


def tumble(rng, poses=6, rest=300, move=100, noise=0.02, scale=1.0, offset=0.0):
    """Rests of `rest` samples between moves, its truth, and the true directions."""
    directions = rng.standard_normal((poses, 3))
    directions *= 9.81 / np.linalg.norm(directions, axis=1, keepdims=True)
    rows, still = [np.repeat(directions[:1], rest, 0)], [np.ones(rest, bool)]
    for before, after in pairwise(directions):
        blend = np.linspace(0.0, 1.0, move)[:, None]
        rows += [(1 - blend) * before + blend * after, np.repeat(after[None], rest, 0)]
        still += [np.zeros(move, bool), np.ones(rest, bool)]
    truth = np.concatenate(rows)
    noisy = truth + noise * rng.standard_normal(truth.shape)
    return scale * noisy + offset, np.concatenate(still), directions


@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (400.0, 32768.0)])
def test_every_rest_is_found_in_any_unit(scale, offset):
    samples, still, directions = tumble(
        np.random.default_rng(3), scale=scale, offset=offset
    )
    rest = initial_rest(samples)
    assert rest.found
    # power: a threshold below the noise finds nothing, one above the motion all
    assert len(static_intervals(samples, 0.3 * rest.variance)) == 0
    assert len(static_intervals(samples, 1e9 * rest.variance)) == 1
    # its end: the first ramp leaves the floor within a window of sample 300
    assert 200 <= rest.stop <= 300
    intervals = static_intervals(samples, 4.0 * rest.variance, trim=10)
    assert len(intervals) == 6
    flags = np.zeros(len(samples), bool)
    for start, stop in intervals:
        flags[start:stop] = True
    assert not np.any(flags & ~still)
    # a mean of 180 or more samples: 0.02 / sqrt(180) per axis, 6 sigma of 18 values
    means = (interval_means(samples, intervals) - offset) / scale
    assert np.abs(means - directions).max() < 6 * 0.02 / np.sqrt(180)
    assert interval_counts(intervals).min() >= 180


def test_trimming_and_the_minimum_length():
    spread = np.full(50, 9.0)
    spread[5:15] = 1.0
    spread[20:45] = 1.0
    np.testing.assert_array_equal(
        intervals_below(spread, 2.0, minimum=10), [[5, 15], [20, 45]]
    )
    np.testing.assert_array_equal(intervals_below(spread, 2.0, minimum=11), [[20, 45]])
    np.testing.assert_array_equal(
        intervals_below(spread, 2.0, minimum=6, trim=2), [[7, 13], [22, 43]]
    )
    # eq. (D1) is strict, and a NaN is never static
    limits = intervals_below(np.array([1.0, 2.0, np.nan, 1.0]), 2.0, minimum=1)
    np.testing.assert_array_equal(limits, [[0, 1], [3, 4]])
    none = intervals_below(spread, 2.0, minimum=26)
    assert none.shape == (0, 2)
    assert interval_means(np.zeros((50, 3)), none).shape == (0, 3)


def test_logs_without_a_usable_rest_are_refused():
    rng = np.random.default_rng(4)
    swept = np.cumsum(rng.standard_normal((3000, 3)), axis=0)  # moves all the time
    with pytest.raises(RefusedError, match="no 1000 samples in a row"):
        initial_rest(swept, minimum=1000)
    stuck = np.full((500, 3), 7.0)
    with pytest.raises(RefusedError, match="does not vary"):
        initial_rest(stuck, count=500)
    with pytest.raises(RefusedError, match="no initial rest found"):
        initial_rest(stuck)


def test_an_initial_rest_has_two_samples_at_least():
    """A window of 3 finds runs of one sample, whose variance would be 0 / 0."""
    rng = np.random.default_rng(22)
    for _ in range(20):
        raw = 9.8 + rng.normal(0.0, [0.01, 5.0, 1e-6], (200, 3))
        try:
            rest = initial_rest(raw, None, 3, 1)
        except RefusedError:
            continue
        assert rest.stop - rest.start >= 2
        assert rest.variance > 0.0
