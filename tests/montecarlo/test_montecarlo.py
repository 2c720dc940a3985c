"""Streaming moments, their order of sums, and variance reduction."""

from functools import reduce
from threading import Event

import numpy as np
import pytest
from rounding import EPS
from scipy import stats

from simval.errors import InputError
from simval.montecarlo import (
    along,
    mean_square,
    moments_of,
    simulate,
    simulate_reduced,
    taylor,
)
from simval.montecarlo.plain import batch_means, merged, summed, sums_of
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


def test_a_weighted_sum_of_moments_has_the_error_of_its_own_correlations():
    tilt, weight = np.array([0.6, -0.8]), np.array([[0.5, -0.3], [-0.3, 0.2]])
    found = moments_of(run(100_000, 64))
    value, error = along(run(100_000, 64), tilt)
    assert value == pytest.approx(tilt @ found.bias, rel=1e-12)
    assert error == pytest.approx(
        np.sqrt(tilt @ MIX @ MIX.T @ tilt / 100_000), rel=0.09
    )
    value, error = along(run(100_000, 64), weight)
    assert value == pytest.approx(np.sum(weight * found.covariance), rel=1e-12)
    # against the scatter of 200 runs, which is known to 5 %: four times that
    many = [along(run(2048, 16, seed), weight) for seed in range(200)]
    values, errors = np.array(many).T
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(values.std(ddof=1), rel=0.2)
    # power: entries as if independent would be off by more
    apart = np.hypot.reduce((weight * found.covariance_error).ravel())
    assert abs(apart / along(run(100_000, 64), weight)[1] - 1.0) > 0.2


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
    with pytest.raises(InputError, match="non-finite"):
        found(2**12, of=lambda x: np.where(x[:2] > 3.0, np.nan, x[:2]))


BLOCKS, BATCH = 70, 4  # five groups of 16 blocks, the last one short


def means(number):
    """Batch means of a block, of sizes for which the order of sums shows."""
    rng = np.random.default_rng(number)
    return batch_means(10.0 ** (number % 7) * rng.standard_normal((3, 16)), BATCH)


def of_groups(size, order=lambda groups: groups):
    groups = [range(k, min(k + size, BLOCKS)) for k in range(0, BLOCKS, size)]
    parts = [np.concatenate([means(k) for k in group]) for group in groups]
    return reduce(merged, order([sums_of(part, BATCH) for part in parts]))


def same(a, b):
    equal = np.array_equal(a.mean, b.mean) and np.array_equal(a.scatter, b.scatter)
    return equal and (a.batches, a.batch) == (b.batches, b.batch)


def test_sums_are_of_sixteen_blocks_merged_from_the_first_on():
    found = summed(means, BLOCKS, BATCH, 1)
    assert same(found, of_groups(16))
    # power: another order and other groups are told apart by their bits
    assert not same(found, of_groups(16, lambda parts: parts[::-1]))
    assert not same(
        found, of_groups(16, lambda parts: [parts[1], parts[0], *parts[2:]])
    )
    assert not same(found, of_groups(15))
    assert not same(found, of_groups(17))
    # and they are the sums: mean and scatter of all batches at once
    every = np.concatenate([means(number) for number in range(BLOCKS)])
    off = every - every.mean(axis=0)
    # a few hundred sums of numbers up to the greatest
    size = np.abs(every).max(axis=0)
    assert np.all(np.abs(found.mean - every.mean(axis=0)) <= 1e-13 * size)
    np.testing.assert_allclose(
        found.scatter, off.T @ off, rtol=0, atol=1e-12 * np.outer(size, size).max()
    )


@pytest.mark.parametrize("last", [0, 1, 3])
@pytest.mark.parametrize("threads", [2, 5])
def test_a_group_that_ends_last_keeps_its_place(threads, last):
    """One group waits until all the others are done that may run without it."""
    expected, gate, done = summed(means, BLOCKS, BATCH, 1), Event(), []

    def held(number):
        if number == 16 * last:
            gate.wait(10.0)
        done.append(number)
        if len({k for k in done if k // 16 != last}) == BLOCKS - of_group(last):
            gate.set()
        return means(number)

    found = summed(held, BLOCKS, BATCH, threads)
    assert gate.is_set()
    assert done[-1] // 16 == last  # it was indeed the last one
    assert same(found, expected)


def of_group(number):
    return min(16, BLOCKS - 16 * number)


def test_each_block_has_the_stream_of_its_number():
    streams = Streams(3, cell_key("order"))
    drawn = []

    def drawing(rng, count):
        drawn.append(rng.standard_normal((2, count)))
        return drawn[-1]

    simulate(drawing, streams, samples=5 * 8, block=8, batch=2)
    for number, block in enumerate(drawn):
        np.testing.assert_array_equal(
            block, streams.block(number).standard_normal((2, 8))
        )
    assert len(drawn) == 5


SLOPE = np.array([[0.3, -0.1, 0.2], [0.0, 0.5, 0.1]])
BEND = np.array([[0.2, 0.0, 0.1], [0.0, -0.3, 0.0]])


def errors(x):
    """Cubic errors of three normals with moments known in closed form.

    e_i = a_i.x + b_i.(x^2 - 1) + c_i x_0^3, all in powers of single normals, so that
    `known` follows from E x^2 = 1, E x^4 = 3, E x^6 = 15 and nothing else.
    """
    cubic = np.array([[0.05], [-0.04]]) * x[0] ** 3
    return SLOPE @ x + BEND @ (x**2 - 1.0) + cubic


def known():
    cubic = np.array([0.05, -0.04])
    covariance = SLOPE @ SLOPE.T + 2.0 * BEND @ BEND.T
    covariance += 3.0 * (np.outer(SLOPE[:, 0], cubic) + np.outer(cubic, SLOPE[:, 0]))
    return np.zeros(2), covariance + 15.0 * np.outer(cubic, cubic)


def found(samples=2**17, seed=3, of=errors):
    streams = Streams(seed, cell_key("reduction"))
    return moments_of(simulate_reduced(of, streams, dimension=3, samples=samples))


def far_from_zero(x):
    """Errors with a value at zero noise and every second derivative."""
    return errors(x) + np.array([[0.2], [-0.1]]) + 0.1 * x[0] * x[2]


def test_moments_are_unbiased_within_their_standard_errors_and_sharp():
    moments = found()
    bias, covariance = known()
    # in pairs odd terms cancel, and the even ones are those of the polynomial
    assert np.abs(moments.bias - bias).max() < 1e-9
    assert moments.bias_error.max() < 1e-9
    # 3 comparisons, one false alarm in 1e4
    limit = stats.norm.isf(1e-4 / (2 * 3))
    score = np.abs(moments.covariance - covariance) / moments.covariance_error
    assert score.max() < limit
    # Power: a covariance off by 5 % is rejected
    wrong = np.abs(moments.covariance - 1.05 * covariance)
    assert (wrong / moments.covariance_error).max() > limit
    plain = moments_of(
        simulate(
            lambda rng, count: errors(rng.standard_normal((3, count))),
            Streams(3, cell_key("plain")), samples=2**17, block=4096, batch=256,
        )
    )  # fmt: skip
    assert moments.covariance_error[0, 0] < 0.7 * plain.covariance_error[0, 0]
    off = found(of=far_from_zero)
    assert off.bias == pytest.approx([0.2, -0.1], abs=1e-9)
    extra = covariance + 0.01 * np.ones((2, 2))  # the variance of x z is 1
    score = np.abs(off.covariance - extra) / off.covariance_error
    assert score.max() < limit


@pytest.mark.ci
def test_standard_errors_are_those_of_repeated_runs():
    runs = [found(2**13, seed) for seed in range(60)]
    spread = np.std([m.covariance[0, 0] for m in runs], ddof=1)
    stated = np.sqrt(np.mean([m.covariance_error[0, 0] ** 2 for m in runs]))
    # the spread of 60 runs is known to 1/sqrt(118) = 9 %, so 4 of them
    assert 0.63 < spread / stated < 1.37


def test_the_same_streams_give_the_same_reduced_bits():
    first, again, other = (found(2**12, seed) for seed in (3, 3, 4))
    for name in ("bias", "covariance", "covariance_error"):
        assert np.array_equal(getattr(first, name), getattr(again, name))
    assert not np.array_equal(first.covariance, other.covariance)
    assert first.samples == 2**12 / 2  # a pair is one


def test_taylor_polynomial_is_that_of_the_errors():
    polynomial = taylor(errors, 3)
    # central differences leave STEP^2 / 6 of the third derivative (6 c) in the slope
    expected = SLOPE + np.array([[0.05, 0, 0], [-0.04, 0, 0]]) * 0.03**2
    np.testing.assert_allclose(polynomial.slope, expected, rtol=0, atol=1e-12)
    for i in range(2):
        np.testing.assert_allclose(
            polynomial.bend[i], 2.0 * np.diag(BEND[i]), rtol=0, atol=1e-11
        )


def test_a_mixed_second_derivative_is_found_too():
    polynomial = taylor(lambda x: (x[0] * x[2] + 0.5 * x[1] ** 2)[None], 3)
    expected = [[[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]]
    # differences of a polynomial in whole numbers: exact
    np.testing.assert_allclose(polynomial.bend, expected, rtol=0, atol=4 * EPS)


def test_known_features_match_quadrature():
    polynomial = taylor(errors, 3)
    nodes, weights = np.polynomial.hermite_e.hermegauss(4)  # exact to degree 7
    grid = np.array(np.meshgrid(nodes, nodes, nodes)).reshape(3, -1)
    mass = np.prod(np.meshgrid(weights, weights, weights), axis=0).reshape(-1)
    mass /= mass.sum()
    value = polynomial(grid)
    second = (value * mass) @ value.T
    expected = np.concatenate([value @ mass, second[np.triu_indices(2)]])
    # sums of some tens of products below 1
    np.testing.assert_allclose(polynomial.features(), expected, rtol=0, atol=40 * EPS)


def test_covariance_is_unbiased_where_the_mean_is_known_better_than_its_samples():
    # Few evaluations under the control variate: dividing by n - 1, as for plain
    # samples, would be wrong by 1/n, which is far beyond this standard error.
    def nearly_linear(x):
        return SLOPE @ x + 1e-5 * x[0] ** 3

    moments = found(4096, 1, nearly_linear)
    cubic = np.full(2, 1e-5)
    exact = SLOPE @ SLOPE.T + 15.0 * np.outer(cubic, cubic)
    exact += 3.0 * (np.outer(SLOPE[:, 0], cubic) + np.outer(cubic, SLOPE[:, 0]))
    error = moments.covariance_error
    # five standard errors; dividing by n - 1 is off by 1/4096, six times as much
    assert np.abs(moments.covariance - exact).max() < 5.0 * error.max()
    assert exact[0, 0] / 4096 > 5.0 * error.max()
