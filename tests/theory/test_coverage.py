"""Coverage about a bias: by quadrature of its definition, and over its range."""

import numpy as np
import pytest
from scipy import integrate, stats

from simval.theory.coverage import bias_square, ellipsoid_coverage, interval_coverage

LEVEL = 0.95
NONE = np.zeros(1)


def over_noise(held, freedom):
    """Mean of a probability over the noise that the residuals find, of 1."""
    if freedom is None:
        return held(1.0)
    law = stats.chi(freedom, scale=freedom**-0.5)
    return integrate.quad(lambda s: law.pdf(s) * held(s), 0.0, 6.0, limit=200)[0]


@pytest.mark.parametrize("freedom", [None, 3, 31])
@pytest.mark.parametrize("bias", [0.0, 0.4, 2.5])
def test_a_coverage_is_that_of_its_definition(bias, freedom):
    """Given the noise that is found, an interval is plain and an ellipsoid a ball."""
    t = stats.norm.isf(0.025) if freedom is None else stats.t(freedom).isf(0.025)

    def interval(s):
        return stats.norm.cdf(t * s - bias) - stats.norm.cdf(-t * s - bias)

    value, off = interval_coverage(LEVEL, np.array([-bias]), NONE, 0.0, freedom)
    # quadrature and the noncentral t are good to 1e-8
    assert value[0] == pytest.approx(over_noise(interval, freedom), abs=1e-7)
    assert off[0] == 0.0
    p = 4
    f = (
        stats.chi2(p).isf(0.05)
        if freedom is None
        else p * stats.f(p, freedom).isf(0.05)
    )
    # a mixture of central laws, by the law of rare events
    counts = np.arange(200)
    weights = stats.poisson(bias**2 / 2.0).pmf(counts)

    def ellipsoid(s):
        return float(weights @ stats.chi2(p + 2 * counts).cdf(f * s * s))

    value, off = ellipsoid_coverage(LEVEL, p, bias**2, 0.0, 0.0, freedom)
    assert value == pytest.approx(over_noise(ellipsoid, freedom), abs=1e-7)
    assert off == 0.0


@pytest.mark.parametrize("freedom", [None, 5])
def test_what_a_coverage_may_be_off_by_holds_in_the_whole_range(freedom):
    rng = np.random.default_rng(1)
    bias, left, relative = np.array([0.0, 0.3, 2.0]), np.array([0.1, 0.5, 0.2]), 0.04
    value, off = interval_coverage(LEVEL, bias, left, relative, freedom)
    whole, may = ellipsoid_coverage(LEVEL, 6, 2.0, 0.5, relative, freedom)
    seen, all_seen = np.zeros(3), 0.0
    for _ in range(300):
        ways = rng.uniform(-1.0, 1.0, 5)
        ways = np.sign(ways) if rng.random() < 0.3 else ways  # at the ends
        d, other = 1.0 + relative * ways[0], bias + left * ways[1:4]
        # a deviation that is stated d-fold: the level that this many of them mean
        t = stats.norm.isf(0.025) if freedom is None else stats.t(freedom).isf(0.025)
        at = 1.0 - 2.0 * (stats.norm if freedom is None else stats.t(freedom)).sf(t * d)
        near, _ = interval_coverage(at, other, np.zeros(3), 0.0, freedom)
        seen = np.maximum(seen, np.abs(near - value))
        law = stats.chi2(6) if freedom is None else stats.f(6, freedom)
        at = law.cdf(law.isf(0.05) * d * d)
        near, _ = ellipsoid_coverage(at, 6, 2.0 + 0.5 * ways[4], 0.0, 0.0, freedom)
        all_seen = max(all_seen, abs(near - whole))
    assert np.all(seen <= off)
    assert all_seen <= may
    # and it is no more than is needed
    assert np.all(seen > 0.8 * off)
    assert all_seen > 0.8 * may


def test_the_square_of_a_bias_is_within_what_is_stated():
    rng = np.random.default_rng(3)
    factor = rng.standard_normal((5, 5))
    C = factor @ factor.T * np.outer(*[10.0 ** np.arange(-6.0, 4.0, 2.0)] * 2)
    sd = np.sqrt(np.diagonal(C))
    bias, left = 0.5 * sd * rng.standard_normal(5), 0.1 * sd
    square, off = bias_square(bias, left, C)
    assert square == pytest.approx(bias @ np.linalg.solve(C, bias), rel=1e-6)
    corners = bias + left * (2.0 * rng.integers(0, 2, (500, 5)) - 1.0)
    other = np.array([b @ np.linalg.solve(C, b) for b in corners])
    assert np.abs(other - square).max() <= off * (1.0 + 1e-6)
    assert np.abs(other - square).max() > 0.3 * off
