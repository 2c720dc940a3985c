"""Streaming moments against direct formulas, known distributions and shuffled work."""

from concurrent.futures import ThreadPoolExecutor
from time import sleep

import numpy as np
import pytest
from rounding import EPS
from scipy import stats

from simval.errors import InputError
from simval.montecarlo import (
    mean_square,
    moments_of,
    simulate,
)
from simval.montecarlo.plain import _in_order, batch_means, merged, sums_of
from simval.streams import Streams, cell_key

MIX = np.array([[1.0, 0.0], [0.6, 0.8]])
SHIFT = np.array([0.3, -0.2])


def sampler(rng, count):
    """Correlated, skewed errors with known moments: shifted exponentials."""
    raw = rng.standard_exponential((2, count)) - 1.0  # mean 0, variance 1
    return MIX @ raw + SHIFT[:, None]


def sums(errors, batch):
    return sums_of(batch_means(errors, batch), batch)


def run(samples, batch=1, seed=5, block=1024):
    streams = Streams(seed, cell_key("test"))
    return simulate(sampler, streams, samples=samples, block=block, batch=batch)


def test_sums_equal_the_direct_formulas():
    errors = sampler(np.random.default_rng(1), 512)
    found = moments_of(sums(errors, 1))
    # numpy's own mean and covariance: the same sums in another order, 1e-13 relative
    np.testing.assert_allclose(found.bias, errors.mean(axis=1), rtol=1e-13)
    np.testing.assert_allclose(found.covariance, np.cov(errors), rtol=1e-12)
    expected = errors.std(axis=1, ddof=1) / np.sqrt(512)
    np.testing.assert_allclose(found.bias_error, expected, rtol=1e-12)


@pytest.mark.parametrize("batch", [1, 64, 256])
def test_moments_and_their_errors_match_the_known_distribution(batch):
    n = 200_000
    found = moments_of(run(n, batch))
    limit = stats.norm.isf(1e-4 / (2 * 5))  # 5 comparisons, one false alarm in 1e4
    upper = np.triu_indices(2)
    truth = MIX @ MIX.T
    z_bias = (found.bias - SHIFT) / found.bias_error
    z_cov = ((found.covariance - truth) / found.covariance_error)[upper]
    assert np.abs(z_bias).max() < limit
    assert np.abs(z_cov).max() < limit
    # The standard error itself: variance of x^2 for an exponential is 9 - 1 = 8
    # about the mean; 782 batches know it to 1/sqrt(2*781) = 2.5 %, 5 sd = 13 %.
    assert found.covariance_error[0, 0] == pytest.approx(np.sqrt(8 / n), rel=0.13)
    # Power: a covariance off by 5 % is rejected by the same data.
    assert np.abs((found.covariance - 1.05 * truth) / found.covariance_error).max() > (
        limit
    )


def test_mean_square_is_the_nees():
    weight = np.linalg.inv(MIX @ MIX.T + np.outer(SHIFT, SHIFT))
    value, error = mean_square(run(100_000, 64), weight)
    assert abs(value - 2.0) < stats.norm.isf(0.5e-4) * error
    errors = np.concatenate(
        [sampler(Streams(5, cell_key("test")).block(i), 1024) for i in range(98)],
        axis=1,
    )
    squares = np.einsum("in,ij,jn->n", errors, weight, errors)
    # a mean of some ten thousand squares in blocks or at once
    assert value == pytest.approx(squares.mean(), rel=100 * EPS, abs=0)
    # batches of 64 against single samples: 1567 batches know it to 1.8 %
    assert error == pytest.approx(squares.std() / np.sqrt(squares.size), rel=0.09)


def test_blocks_merge_to_the_whole_in_order_and_by_pieces():
    streams = Streams(3, cell_key("merge"))
    blocks = [sampler(streams.block(i), 256) for i in range(8)]
    pieces = [sums(block, 16) for block in blocks]
    left = pieces[0]
    for piece in pieces[1:]:
        left = merged(left, piece)
    whole = sums(np.concatenate(blocks, axis=1), 16)
    # another order of the same additions: 128 batches, 1e-13 relative to the spread
    np.testing.assert_allclose(left.mean, whole.mean, rtol=1e-13)
    np.testing.assert_allclose(left.scatter, whole.scatter, rtol=1e-11, atol=1e-15)


def test_the_same_streams_give_the_same_bits_and_others_do_not():
    first, again, other = run(5000), run(5000), run(5000, seed=6)
    assert np.array_equal(first.mean, again.mean)
    assert np.array_equal(first.scatter, again.scatter)
    assert not np.array_equal(first.mean, other.mean)


@pytest.mark.parametrize("threads", [2, 3])
def test_threads_do_not_change_the_bits(threads):
    streams = Streams(5, cell_key("test"))
    setting = {"samples": 90_000, "block": 1024, "batch": 64}
    one = simulate(sampler, streams, **setting)
    many = simulate(sampler, streams, threads=threads, **setting)
    assert np.array_equal(one.mean, many.mean)
    assert np.array_equal(one.scatter, many.scatter)


def test_results_leave_the_pool_in_the_order_of_the_groups():
    """Fewer may wait than there are groups, and the first to start ends last."""
    groups = [range(k, k + 1) for k in range(12)]
    started = []

    def work(group):
        started.append(group)
        sleep(2e-3 * (group.start % 3 == 0))
        return group

    with ThreadPoolExecutor(3) as pool:
        found = []
        for group in _in_order(pool, work, groups, ahead=4):
            found.append(group)
            assert len(started) <= len(found) + 4  # no more than that wait
    assert found == groups


def test_bad_requests_are_refused_in_words():
    with pytest.raises(InputError, match="batch must divide block"):
        run(1000, batch=3)
    with pytest.raises(InputError, match="no standard error"):
        moments_of(sums(np.ones((2, 8)), 8))

    def broken(rng, count):
        errors = sampler(rng, count)
        errors[0, 7] = np.nan
        errors[:, [2, 9]] = np.inf
        return errors

    with pytest.raises(InputError, match="3 of 16 trials in block 0"):
        simulate(broken, Streams(1, (1,)), samples=16, block=16, batch=1)
    for name in ("samples", "block", "batch", "threads"):
        words = {"samples": 16, "block": 16, "batch": 1, "threads": 1, name: 0}
        with pytest.raises(InputError, match=f"`{name}` is 0"):
            simulate(sampler, Streams(1, (1,)), **words)


def test_two_batches_have_a_standard_error():
    errors = sampler(np.random.default_rng(4), 2)
    # sd of two values over the root of two: half their difference
    expected = np.abs(errors[:, 0] - errors[:, 1]) / 2
    found = moments_of(sums(errors, 1)).bias_error
    np.testing.assert_allclose(found, expected, rtol=1e-14)
