"""Variance reduction: unbiased, honest about its error, and worth its name."""

import numpy as np
import pytest
from rounding import EPS
from scipy import stats

from simval.errors import InputError
from simval.montecarlo import METHODS, moments_of, simulate_reduced, taylor
from simval.streams import Streams, cell_key

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


def found(method, samples=2**17, seed=3):
    streams = Streams(seed, cell_key("reduction"))
    setting = {"dimension": 3, "method": method, "samples": samples}
    return moments_of(simulate_reduced(errors, streams, **setting))


@pytest.mark.parametrize("method", METHODS)
def test_moments_are_unbiased_within_their_standard_errors(method):
    moments = found(method)
    bias, covariance = known()
    # 5 comparisons, one false alarm in 1e4; Student's t for the 32 scramblings
    dof = 31 if method == "sobol" else 500
    limit = stats.t.isf(1e-4 / (2 * 5), dof)
    upper = np.triu_indices(2)
    # what is left after antithetic pairs can be rounding only, with no error to see
    floor = 1e-13
    z_bias = np.abs(moments.bias - bias) / (moments.bias_error + floor)
    z_cov = np.abs(moments.covariance - covariance) / (moments.covariance_error + floor)
    assert z_bias.max() < limit
    assert z_cov[upper].max() < limit
    # Power: a covariance off by 5 % is rejected.
    wrong = np.abs(moments.covariance - 1.05 * covariance)
    assert (wrong / moments.covariance_error).max() > limit


@pytest.mark.ci
def test_standard_errors_are_those_of_repeated_runs():
    for method in ("plain", "both", "sobol"):
        runs = [found(method, 2**13, seed) for seed in range(60)]
        spread = np.std([m.covariance[0, 0] for m in runs], ddof=1)
        stated = np.sqrt(np.mean([m.covariance_error[0, 0] ** 2 for m in runs]))
        # the spread of 60 runs is known to 1/sqrt(118) = 9 %, so 4 of them
        assert 0.63 < spread / stated < 1.37, method


def test_every_reduction_reduces_what_it_is_for():
    plain = found("plain")
    # In pairs only the even part is left, of variance 2 b.b = 0.1, in n/2 pairs.
    even = np.sqrt(2.0 * BEND[0] @ BEND[0] / (plain.samples / 2))
    assert found("antithetic").samples == plain.samples / 2
    # 512 batches know the standard error to 1/sqrt(1022) = 3 %, 4 of them
    assert found("antithetic").bias_error[0] == pytest.approx(even, rel=0.13)
    assert found("control").covariance_error[0, 0] < 0.7 * plain.covariance_error[0, 0]
    both = found("both")
    assert both.bias_error[0] < 1e-9  # the odd cubic and the known polynomial are all
    assert found("sobol").covariance_error[0, 0] < 0.3 * plain.covariance_error[0, 0]


@pytest.mark.parametrize("method", METHODS)
def test_the_same_streams_give_the_same_bits_and_others_do_not(method):
    first, again, other = (found(method, 2**12, seed) for seed in (3, 3, 4))
    for name in ("bias", "covariance", "covariance_error"):
        assert np.array_equal(getattr(first, name), getattr(again, name))
    assert not np.array_equal(first.covariance, other.covariance)
    # a pair of evaluations is one sample; Sobol points are rounded up to 32 times 2^k
    assert first.samples == 2**12 / (2 if method in ("antithetic", "both") else 1)


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


def test_a_block_may_be_a_single_batch():
    streams = Streams(1, cell_key("one batch"))
    setting = {"dimension": 3, "method": "plain", "samples": 512}
    assert simulate_reduced(errors, streams, block=256, **setting).batches == 2


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

    streams = Streams(1, cell_key("few"))
    setting = {"dimension": 3, "method": "both", "samples": 4096}
    moments = moments_of(simulate_reduced(nearly_linear, streams, **setting))
    cubic = np.full(2, 1e-5)
    exact = SLOPE @ SLOPE.T + 15.0 * np.outer(cubic, cubic)
    exact += 3.0 * (np.outer(SLOPE[:, 0], cubic) + np.outer(cubic, SLOPE[:, 0]))
    error = moments.covariance_error
    # five standard errors; dividing by n - 1 is off by 1/4096, six times as much
    assert np.abs(moments.covariance - exact).max() < 5.0 * error.max()
    assert exact[0, 0] / 4096 > 5.0 * error.max()


@pytest.mark.parametrize(
    "setting",
    [
        {"samples": 0},
        {"samples": -3},
        {"samples": 1000.5},
        {"block": 0},
        {"block": 100},
    ],
)
@pytest.mark.parametrize("method", METHODS)
def test_numbers_that_cannot_be_used_are_refused(method, setting):
    words = {"dimension": 3, "method": method, "samples": 1000, **setting}
    name, value = next(iter(setting.items()))
    with pytest.raises(InputError, match=f"`{name}` is {value}; it must be"):
        simulate_reduced(errors, Streams(1, (1,)), **words)


def test_an_unknown_method_is_refused():
    with pytest.raises(InputError, match="must be one of plain, antithetic"):
        found("magic")
